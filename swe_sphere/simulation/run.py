"""A run from its configuration to its summary."""

from __future__ import annotations

import tempfile
import time
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from swe_sphere.errors import RunFailed, SweError
from swe_sphere.simulation.config import RunConfig
from swe_sphere.simulation.execution import Execution
from swe_sphere.simulation.output import appends
from swe_sphere.simulation.prepare import Prepared, prepare
from swe_sphere.simulation.recorder import most_samples
from swe_sphere.simulation.summary import Summary
from swe_sphere.simulation.watcher import Watcher

if TYPE_CHECKING:
    from swe_sphere.io.netcdf import FrameWriter

__all__ = ["run"]

FAR = 1.05
"""A step longer than the stability limit by this factor is warned of."""


def run(config: RunConfig, watcher: Watcher | None = None) -> Summary:
    """Run a scene; how it went is in the summary, also where it stopped early.

    Raises:
        ConfigError: it cannot be run as asked for.
    """
    started = time.perf_counter()
    watcher = watcher or Watcher()
    prepared = prepare(config)
    for text in prepared.warnings:
        watcher.warn(text)
    _warn_of_step(prepared, watcher)
    with ExitStack() as stack:
        out = config.out
        if out is None and config.plot is not None:
            out = Path(stack.enter_context(tempfile.TemporaryDirectory())) / "run.nc"
        summary = _executed(prepared, watcher, out)
        if out is not None and config.plot is not None:
            summary = _plotted(summary, out, config.plot)
    total = {"total_seconds": time.perf_counter() - started}
    return replace(summary, numbers={**summary.numbers, **total})


def _executed(prepared: Prepared, watcher: Watcher, out: Path | None) -> Summary:
    """Step with or without a file."""
    if out is None:
        return Execution(prepared, None, watcher).run()
    with _writer(prepared, out) as writer:
        return _noted(writer, Execution(prepared, writer, watcher).run())


def _writer(prepared: Prepared, out: Path) -> FrameWriter:
    from swe_sphere.io.netcdf import FrameWriter  # netCDF4 takes its time to import

    model = prepared.model
    tracers = model.scene.tracers or ()
    samples = most_samples(prepared.plan, prepared.stepper.steps)
    now = prepared.plan.time(prepared.stepper.steps)
    return FrameWriter(
        out, model.mesh, prepared.attributes(), model.bottom, tracers, samples,
        append_from=now if appends(prepared.config) else None,
    )  # fmt: skip


def _noted(writer: FrameWriter, summary: Summary) -> Summary:
    """Write into the file how the run ended; where that cannot be done, the run has failed."""
    try:
        if writer.frames:
            writer.finish({k: v for k, v in summary.as_dict().items() if v is not None})
    except RunFailed as error:
        return _spoilt(summary, error)
    return summary


def _spoilt(summary: Summary, error: SweError) -> Summary:
    return replace(
        summary,
        completed=False,
        reason=summary.reason or str(error),
        exit_status=summary.exit_status or error.exit_status,
    )


def _plotted(summary: Summary, file: Path, picture: Path) -> Summary:
    """Draw the last frame; a picture that cannot be drawn does not undo the run."""
    from swe_sphere.io.plot import plot_file  # matplotlib takes its time to import

    try:
        plot_file(file, out=picture)
    except SweError as error:
        status = summary.exit_status or RunFailed.exit_status
        return replace(summary, reason=summary.reason or str(error), exit_status=status)
    return summary


def _warn_of_step(prepared: Prepared, watcher: Watcher) -> None:
    dt, limit = prepared.plan.dt, prepared.stable_dt
    if dt > FAR * limit:
        watcher.warn(
            f"dt = {dt:.6g} s is {dt / limit:.3g} times the stability limit of"
            f" {prepared.config.stepper}, {limit:.4g} s: expect the run to blow up"
        )
