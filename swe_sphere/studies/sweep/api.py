"""A sweep from Python: settings in, dataset out."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from swe_sphere.errors import ConfigError
from swe_sphere.simulation.interrupt import Interrupted
from swe_sphere.studies.sweep.plan import SweepPlan, make_plan
from swe_sphere.studies.sweep.watcher import SweepWatcher

if TYPE_CHECKING:
    import os

    import xarray as xr

__all__ = ["run_plan", "sweep"]


def sweep(
    scene: str,
    steppers: str | Sequence[str],
    *,
    out: str | os.PathLike[str] | None = None,
    watcher: SweepWatcher | None = None,
    **options: object,
) -> xr.Dataset:
    """Run steppers over a range of steps on a scene, and return what came of it.

    Args:
        scene: name of a scene.
        steppers: names, as a list or separated by commas.
        out: folder that keeps the runs, so that a sweep can be stopped and extended; None: none.
        watcher: told how it goes.
        options: those of `SweepPlan`: dt, ne, np, days, repeats, ...

    Returns:
        The dataset of `build_dataset`, a row for each setting.

    Raises:
        ConfigError: the sweep cannot be made as asked for.
        KeyboardInterrupt: on Ctrl-C; what is finished stays in `out`.
    """
    plan = make_plan({"scene": scene, "steppers": steppers, **options})
    try:
        if out is not None:
            return run_plan(plan, Path(out), watcher)
        with tempfile.TemporaryDirectory() as folder:
            return run_plan(plan, Path(folder), watcher)
    except Interrupted as error:
        raise KeyboardInterrupt(str(error)) from None


def run_plan(plan: SweepPlan, folder: Path, watcher: SweepWatcher | None = None) -> xr.Dataset:
    """Carry out a plan in a folder and write its dataset there; finished runs are not repeated.

    Raises:
        ConfigError: the plan cannot be carried out, or not in that folder; or another sweep is at
            work there.
        RunFailed: the disk does not take the results.
        Interrupted: the user asked to stop; the dataset of what is finished has been written.
    """
    from swe_sphere.studies.sweep.campaign import Campaign
    from swe_sphere.studies.sweep.dataset import write_dataset
    from swe_sphere.studies.sweep.journal import RECORDS
    from swe_sphere.studies.sweep.lock import alone

    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"out: {folder} cannot be made: {error.strerror}") from None
    with alone(folder / RECORDS):
        campaign = Campaign(plan, folder, watcher or SweepWatcher())
        try:
            campaign.run()
        except Interrupted:
            if campaign.has_runs:
                write_dataset(folder)
            raise
        return write_dataset(folder)
