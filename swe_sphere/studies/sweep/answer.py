"""What a sweep comes to: the cheapest setting of each stepper for an error."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["Setting", "best_kind", "cheapest", "settings"]


@dataclass(frozen=True)
class Setting:
    """A row of a sweep, in the few numbers that people ask for first."""

    stepper: str
    preconditioner: str
    mesh: str
    dt: float
    """[s]"""
    gravity_limits: float
    """dt in steps of the gravity limit."""
    status: str
    reason: str
    errors: dict[str, float]
    """By kind, at the last report day."""
    wall: float
    """Median over the repeats [s]."""
    spread: float
    """Largest less smallest, over the median."""
    krylov: float
    """Iterations a step."""


def settings(
    dataset: xr.Dataset,
    field: str = "h",
    norm: str = "l2",
    roles: tuple[str, ...] = ("grid", "target"),
) -> list[Setting]:
    """The rows of these roles, stepper by stepper, the longest step first.

    Errors of that field and norm; the slow one is that of vorticity, in the same norm.
    """
    rows = np.flatnonzero(np.isin(dataset["role"].values, roles))
    days = dataset.sizes["report_day"]
    error = dataset["error"].sel(norm=norm)
    if not days:
        values = np.full((dataset.sizes["run"], dataset.sizes["kind"]), np.nan)
    else:
        values = error.sel(field=field).isel(report_day=-1).values.copy()
        slow = [*dataset["kind"].values].index("slow")
        values[:, slow] = error.sel(kind="slow", field="vorticity").isel(report_day=-1).values
    kinds = [str(kind) for kind in dataset["kind"].values]
    found = [_setting(dataset, int(n), dict(zip(kinds, values[n], strict=True))) for n in rows]
    first = {setting.stepper: place for place, setting in reversed([*enumerate(found)])}
    return sorted(found, key=lambda s: (first[s.stepper], s.preconditioner, s.mesh, -s.dt))


def best_kind(found: list[Setting]) -> str:
    """The kind of error to judge by: the total one where it is known, else that in time."""
    known = any(np.isfinite(setting.errors["total"]) for setting in found)
    return "total" if known else "time"


def cheapest(found: list[Setting], target: float, kind: str) -> list[Setting]:
    """Of each stepper the setting that reaches the error in the least time, the fastest first."""
    good: dict[str, Setting] = {}
    for setting in found:
        if setting.status != "completed" or not setting.errors[kind] <= target:
            continue
        best = good.get(setting.stepper)
        if best is None or setting.wall < best.wall:
            good[setting.stepper] = setting
    return sorted(good.values(), key=lambda setting: setting.wall)


def _setting(dataset: xr.Dataset, row: int, errors: dict[str, float]) -> Setting:
    def value(name: str) -> Any:
        return dataset[name].values[row]

    steps = value("steps")
    return Setting(
        stepper=str(value("stepper")),
        preconditioner=str(value("preconditioner")),
        mesh=f"ne{value('ne'):.0f} np{value('np'):.0f} {value('precision')}",
        dt=float(value("dt")),
        gravity_limits=float(value("dt") / value("gravity_limit")),
        status=str(value("status")),
        reason=str(value("reason")),
        errors={kind: float(error) for kind, error in errors.items()},
        wall=float(value("wall_seconds")),
        spread=float(value("wall_spread")),
        krylov=float(value("krylov_iterations") / steps) if steps > 0 else float("nan"),
    )
