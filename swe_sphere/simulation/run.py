"""A run from its configuration to its summary, with its file and its picture."""

import tempfile
import time
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

from swe_sphere.errors import RunFailed, SweError
from swe_sphere.simulation.callbacks import Callback
from swe_sphere.simulation.config import RunConfig
from swe_sphere.simulation.progress import Watcher
from swe_sphere.simulation.simulation import Simulation
from swe_sphere.simulation.summary import Summary


def run(config: RunConfig, watcher: Watcher | None = None) -> Summary:
    """Run a scene; how it went is in the summary, also where it stopped early.

    Raises:
        ConfigError: it cannot be run as asked for.
    """
    started = time.perf_counter()
    sim = Simulation.from_config(config)
    with ExitStack() as stack:
        out = config.out
        if out is None and config.plot is not None:
            out = Path(stack.enter_context(tempfile.TemporaryDirectory())) / "run.nc"
        summary = sim.run(
            out=out, overwrite=config.overwrite, watcher=watcher or Watcher(),
            callbacks=[] if config.live is None else [_live(config.live, sim)],
        )  # fmt: skip
        if out is not None and config.plot is not None:
            file, picture = out, config.plot
            summary = sim.comm.on_root(lambda: _plotted(summary, file, picture))
    asked = {"out": None if config.out is None else str(config.out)}
    total = {"total_seconds": time.perf_counter() - started}
    return replace(summary, numbers={**summary.numbers, **asked, **total})


def _live(field: str, sim: Simulation) -> Callback:
    from swe_sphere.simulation.live import PICTURES, LivePicture  # for matplotlib's colours

    return Callback(LivePicture(field, sim.comm), times=PICTURES)


def _plotted(summary: Summary, file: Path, picture: Path) -> Summary:
    """Draw the last frame; a picture that cannot be drawn does not undo the run."""
    from swe_sphere.pictures.plot import plot_file  # matplotlib takes its time to import

    try:
        plot_file(file, out=picture)
    except SweError as error:
        status = summary.exit_status or RunFailed.exit_status
        return replace(summary, reason=summary.reason or str(error), exit_status=status)
    return summary
