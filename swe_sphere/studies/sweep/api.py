"""A sweep from Python: settings in, dataset out."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

from swe_sphere.ranks.communicator import refuse_ranks
from swe_sphere.simulation.loop import Interrupted
from swe_sphere.studies.record_store import locked
from swe_sphere.studies.sweep.runner import SweepWatcher
from swe_sphere.studies.sweep.sweep_plan import SweepPlan, make_plan

if TYPE_CHECKING:
    import os

    import xarray as xr

    from swe_sphere.equations.scene import Scene
    from swe_sphere.steppers import Stepper


def sweep(
    scene: str | os.PathLike[str] | Scene,
    steppers: str | type[Stepper] | Sequence[str | os.PathLike[str] | type[Stepper]],
    *,
    out: str | os.PathLike[str] | None = None,
    watcher: SweepWatcher | None = None,
    **options: object,
) -> xr.Dataset:
    """Run steppers over a range of steps on a scene, and return what came of it.

    Args:
        scene: name of a scene, path of a file that defines one, or a `Scene`.
        steppers: names, paths of files, or classes, in a list; names also separated by commas.
        out: folder that keeps the runs, so that a sweep can be stopped and extended; None: none.
        watcher: told how it goes.
        options: those of `SweepPlan`: dt [s], ne, np, days, repeats, ...

    Numbers registered with `diagnostic` become variables of the dataset.

    Returns:
        The dataset of `build_dataset`, a row for each setting.

    Raises:
        ConfigError: the sweep cannot be made as asked for.
        KeyboardInterrupt: on Ctrl-C; what is finished stays in `out`.

    Examples:
        >>> from swe_sphere import sweep
        >>> ds = sweep("williamson2", ["rk4", "tr-bdf2"], ne=2, np=4, days=0.05, dt=[2160, 1080],
        ...            repeats=1)
        >>> grid = ds.isel(run=ds.role.values == "grid")
        >>> grid.stepper.values.tolist()
        ['rk4', 'tr-bdf2', 'rk4', 'tr-bdf2']
        >>> bool((grid.error.sel(kind="time", field="v", norm="l2") < 1e-3).all())
        True
    """
    from swe_sphere.equations.scene import Scene

    refuse_ranks()
    own = scene if isinstance(scene, Scene) else None
    name = str(scene) if own is None else own.name
    plan = make_plan({"scene": name, "steppers": steppers, **options}, own)
    try:
        with tempfile.TemporaryDirectory() if out is None else nullcontext(out) as folder:
            return run_plan(plan, Path(folder), watcher, own)
    except Interrupted as error:
        raise KeyboardInterrupt(str(error)) from None


def run_plan(
    plan: SweepPlan,
    folder: Path,
    watcher: SweepWatcher | None = None,
    own: Scene | None = None,
) -> xr.Dataset:
    """Carry out a plan in a folder and write its dataset there; finished runs are not repeated.

    own: a scene that stands behind the name in the plan.

    Raises:
        ConfigError: the plan cannot be carried out, or not in that folder; or another sweep is at
            work there.
        RunFailed: the disk does not take the results.
        Interrupted: the user asked to stop; the dataset of what is finished has been written.
    """
    from swe_sphere.studies.sweep.dataset import write_dataset
    from swe_sphere.studies.sweep.engine import Sweep

    with locked(folder):
        work = Sweep(plan, folder, watcher or SweepWatcher(), own)
        try:
            work.run()
        except Interrupted:
            if work.has_runs:
                write_dataset(folder)
            raise
        return write_dataset(folder)
