"""From the records to one dataset, a row for every run: sweep.nc."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from swe_sphere.durable import write_whole
from swe_sphere.errors import ConfigError
from swe_sphere.studies.modelled_time import Prices, lowest, modelled_seconds
from swe_sphere.studies.store import as_netcdf
from swe_sphere.studies.sweep.record import (
    FIELDS,
    HEADER,
    KINDS,
    MESH,
    NORMS,
    Header,
    RunRecord,
    current,
    read_header,
    runs_of,
)
from swe_sphere.studies.sweep.runner import COUNTS

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["DATASET", "UNITS", "WORDS", "build_dataset", "read_dataset", "write_dataset"]

DATASET = "sweep.nc"

WORDS = (
    "scene", "stepper", "preconditioner", "precision", "device", "settings", "role", "status",
    "reason",
)  # fmt: skip
"""Words of a row."""
UNITS = {
    **dict.fromkeys(("ne", "np", "stretch", "steps", *COUNTS), "1"),
    **dict.fromkeys(("mass_drift", "energy_drift", "enstrophy_drift"), "1"),
    **dict.fromkeys(("dt", "gravity_limit", "advective_limit"), "s"),
    **dict.fromkeys(("compile_seconds", "setup_seconds", "total_seconds"), "s"),
    **dict.fromkeys(("days", "days_planned"), "d"),
    "peak_memory": "byte",
}
"""Numbers of a row and their units; others that a run has come without."""
TIMES = ("wall", "cpu")
"""Clocks that all repeats are read on."""

Runs = list[list[RunRecord]]
"""The repeats of each run."""


def build_dataset(header: Header, records: list[RunRecord]) -> xr.Dataset:
    """The dataset of a sweep; rows in the order in which they were first run.

    Only runs of the sources that the sweep had last are in it: others cannot be compared with them.
    dims: run, kind, field, norm, report_day [days], repeat.  There must be a run.
    """
    import xarray as xr

    records = current(records, header.sources)
    runs = _by_key(records)
    rows = [_row(repeats[0], header.scene) for repeats in runs]
    more = sorted({name for row in rows for name in row} - {*UNITS, *WORDS})
    units = UNITS | {name: "" for name in more if name.removesuffix("_seconds") not in TIMES}
    data: dict[str, Any] = {name: ("run", _words(rows, name)) for name in WORDS}
    for name, unit in units.items():
        attributes = {"units": unit} if unit else {}
        data[name] = ("run", _numbers(row.get(name) for row in rows), attributes)
    rhs = {mesh: float(np.median(times)) for mesh, times in _rhs_seconds(records).items()}
    times = _numbers(rhs.get(repeats[0].mesh) for repeats in runs)
    data |= {"rhs_seconds": ("run", times, {"units": "s"})} | _times(runs)
    data["modelled_seconds"] = ("run", _modelled(runs, records), {"units": "s"})
    days, errors = _errors(runs)
    data["error"] = (("run", "kind", "field", "norm", "report_day"), errors, {"units": "1"})
    coordinates = {"kind": list(KINDS), "field": list(FIELDS), "norm": list(NORMS),
                   "report_day": ("report_day", days, {"units": "d"})}  # fmt: skip
    return xr.Dataset(data, coordinates, _attributes(header, records))


def write_dataset(folder: Path) -> xr.Dataset:
    """Build the dataset of a folder's records and write it to sweep.nc, whole or not at all.

    Raises:
        ConfigError: there is no run in the folder, or a record is damaged.
        RunFailed: the disk does not take the file.
    """
    header, records = read_header(folder), runs_of(folder).records
    if header is None and records:
        raise ConfigError(
            f"{folder}: there is no {HEADER} that says what was asked for: give the command of the"
            " sweep again, without report-only"
        )
    if header is None or not current(records, header.sources):
        raise ConfigError(f"{folder}: there are no runs in this sweep yet")
    dataset = build_dataset(header, records)
    write_whole(folder / DATASET, as_netcdf(dataset))
    return dataset


def read_dataset(path: Path) -> xr.Dataset:
    """The dataset of a sweep.nc, in memory; ConfigError if there is none."""
    import xarray as xr

    try:
        return xr.load_dataset(path, engine="netcdf4")
    except FileNotFoundError:
        raise ConfigError(f"there is no file {path}") from None
    except OSError as error:
        raise ConfigError(f"cannot read {path}: {error}") from None


def _by_key(records: list[RunRecord]) -> Runs:
    """Repeats of one run together; of a run that was made anew the last one holds."""
    latest: dict[str, dict[int, RunRecord]] = {}
    for record in records:
        latest.setdefault(record.key, {})[record.repeat] = record
    return [[of[n] for n in sorted(of)] for of in latest.values()]


def _row(run: RunRecord, scene: str) -> dict[str, Any]:
    config = run.config
    return {
        **run.numbers,
        **{name: getattr(config, name) for name in ("stepper", "dt", *MESH)},
        "scene": scene,
        "preconditioner": config.preconditioner or "",
        "settings": " ".join(config.settings),
        "days_planned": config.days,
        **{name: getattr(run, name) for name in ("role", "status", "reason")},
    }


def _words(rows: list[dict[str, Any]], name: str) -> NDArray[np.object_]:
    return np.array([row[name] for row in rows], dtype=object)


def _numbers(values: Iterable[float | None]) -> NDArray[np.float64]:
    """The values, NaN where there is none."""
    return np.array([np.nan if value is None else value for value in values], dtype=float)


def _rhs_seconds(records: list[RunRecord]) -> dict[tuple[object, ...], list[float]]:
    """Times of a right-hand side by mesh [s]."""
    found: dict[tuple[object, ...], list[float]] = {}
    for record in records:
        if record.rhs_seconds is not None:
            found.setdefault(record.mesh, []).append(record.rhs_seconds)
    return found


def _modelled(runs: Runs, records: list[RunRecord]) -> NDArray[np.float64]:
    """What the work of each run costs at the lowest prices that any of them has found."""
    found: dict[tuple[object, ...], list[Prices]] = {}
    for record in records:
        found.setdefault(record.integrator, []).append(record.prices)
    prices = {integrator: lowest(several) for integrator, several in found.items()}
    seconds = [modelled_seconds(of[0].work, prices[of[0].integrator]) for of in runs]
    return np.array(seconds)


def _noise(records: list[RunRecord]) -> float:
    """Spread of the time of right-hand sides over the sweep: 10th to 90th percentile / median."""
    shares = [np.array(times) / np.median(times) for times in _rhs_seconds(records).values()]
    if not shares:
        return float("nan")
    low, high = np.percentile(np.concatenate(shares), [10.0, 90.0])
    return float(high - low)


def _times(runs: Runs) -> dict[str, Any]:
    """Times of the repeats, their median and their spread; of failed runs what they took."""
    most = max(len(repeats) for repeats in runs)
    table: dict[str, NDArray[np.float64]] = {}
    for clock in TIMES:
        values = table[clock] = np.full((len(runs), most), np.nan)
        for row, repeats in zip(values, runs, strict=True):
            row[: len(repeats)] = _numbers(r.numbers.get(f"{clock}_seconds") for r in repeats)
    wall, cpu = (_by_row(np.median, table[clock]) for clock in TIMES)
    spread = _by_row(np.ptp, table["wall"]) / np.maximum(wall, np.finfo(float).tiny)
    seconds = {"units": "s"}
    return {
        "wall": (("run", "repeat"), table["wall"], seconds),
        "cpu": (("run", "repeat"), table["cpu"], seconds),
        "wall_seconds": ("run", wall, seconds),
        "cpu_seconds": ("run", cpu, seconds),
        "wall_spread": ("run", spread, {"units": "1", "long_name": "(max - min) / median"}),
    }


def _by_row(of: Callable[..., Any], table: NDArray[np.float64]) -> NDArray[np.float64]:
    """A number of the finite values of each row, NaN where there is none."""
    kept = (row[np.isfinite(row)] for row in table)
    return np.array([of(values) if values.size else np.nan for values in kept])


def _errors(runs: Runs) -> tuple[list[float], NDArray[np.float64]]:
    """Report days, and errors (run, kind, field, norm, report_day)."""
    entries = [repeats[0].errors for repeats in runs]
    days = sorted({entry.day for errors in entries for entry in errors})
    table = np.full((len(runs), len(KINDS), len(FIELDS), len(NORMS), len(days)), np.nan)
    for run, errors in enumerate(entries):
        for entry in errors:
            place = KINDS.index(entry.kind), FIELDS.index(entry.field)
            values = _numbers(getattr(entry, norm) for norm in NORMS)
            table[run, *place, :, days.index(entry.day)] = values
    return days, table


def _attributes(header: Header, records: list[RunRecord]) -> dict[str, Any]:
    dt, check = _converged(records)
    values = dict(header)
    return {
        **{name: values[name] for name in ("scene", "machine", "cores", "created", "command")},
        **{name: json.dumps(values[name]) for name in ("plan", "sources", "versions")},
        "title": f"time steps and cost: {header.title}",
        "noise": _noise(records),
        "converged_dt": dt,
        "converged_check": check,
    }


def _converged(records: list[RunRecord]) -> tuple[float, float]:
    """Step of the time-converged run, and its own error in time (l2 of h at the end).

    Where there are several meshes: of the one with the largest error.
    """
    finest: dict[tuple[object, ...], tuple[float, float]] = {}
    for run in records:
        for error in run.errors if run.role == "converged" else ():
            which = (error.kind, error.field, error.day)
            if which == ("time", "h", run.config.days) and error.l2 is not None:
                here = (float(run.config.dt), error.l2)
                finest[run.mesh] = min(finest.get(run.mesh, here), here)
    return max(finest.values(), key=lambda pair: pair[1], default=(float("nan"), float("nan")))
