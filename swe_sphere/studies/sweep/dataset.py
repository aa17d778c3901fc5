"""From the journal to one dataset, a row for every run: sweep.nc."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from swe_sphere.durable import write_whole
from swe_sphere.errors import ConfigError
from swe_sphere.studies.sweep.form import UNITS, WORDS, Record
from swe_sphere.studies.sweep.freshness import fresh
from swe_sphere.studies.sweep.journal import RECORDS, read_journal
from swe_sphere.studies.sweep.judge import ERRORS, KINDS, NORMS

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["DATASET", "build_dataset", "read_dataset", "write_dataset"]

DATASET = "sweep.nc"

BENCH = ("ne", "np", "stretch", "precision", "device")
"""What the time of a right-hand side goes with."""


def build_dataset(records: list[Record]) -> xr.Dataset:
    """The dataset of a journal; rows in the order in which they were first run.

    Only runs of the sources that the sweep had last are in it: others cannot be compared with them.
    dims: run, kind, field, norm, report_day [days], repeat.  Raises ConfigError if there is no run.
    """
    import xarray as xr

    header = _header(records)
    records = fresh(records, header["sources"])
    runs = _by_key(records)
    if not runs:
        raise ConfigError("there are no runs in this sweep yet")
    rows = [group[0]["row"] for group in runs.values()]
    rhs = _rhs_seconds(records)
    data: dict[str, Any] = {name: ("run", _words(rows, name)) for name in WORDS}
    for name, unit in UNITS.items():
        data[name] = ("run", _numbers(row.get(name) for row in rows), {"units": unit})
    data["rhs_seconds"] = ("run", _numbers(rhs.get(_bench(row)) for row in rows), {"units": "s"})
    data |= _times(list(runs.values()))
    days, errors = _errors(list(runs.values()))
    data["error"] = (("run", "kind", "field", "norm", "report_day"), errors, {"units": "1"})
    coordinates = {"kind": list(KINDS), "field": list(ERRORS), "norm": list(NORMS),
                   "report_day": ("report_day", days, {"units": "d"})}  # fmt: skip
    return xr.Dataset(data, coordinates, _attributes(header, records))


def write_dataset(folder: Path) -> xr.Dataset:
    """Build the dataset of a folder's journal and write it to sweep.nc, whole or not at all.

    Raises:
        ConfigError: there is no journal with a run in the folder, or it is damaged.
        RunFailed: the disk does not take the file.
    """
    records = read_journal(folder / RECORDS)
    try:
        dataset = build_dataset(records)
    except ConfigError as error:
        raise ConfigError(f"{folder}: {error}") from None
    write_whole(folder / DATASET, _as_bytes(dataset))
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


def _as_bytes(dataset: xr.Dataset) -> bytes:
    """The netCDF file of a dataset, made in memory: HDF5 does not survive a disk that fills up."""
    from netCDF4 import Dataset
    from xarray.backends import NetCDF4DataStore

    file = Dataset(DATASET, "w", memory=0)
    dataset.dump_to_store(NetCDF4DataStore(file))  # type: ignore[no-untyped-call]
    return bytes(file.close())


def _header(records: list[Record]) -> Record:
    """What was asked for last."""
    headers = [record for record in records if record["record"] == "sweep"]
    if headers:
        return headers[-1]
    if not records:
        raise ConfigError("there are no runs in this sweep yet")
    raise ConfigError(
        f"{RECORDS} does not say what was asked for: give the command of the sweep again, without"
        " report-only"
    )


def _by_key(records: list[Record]) -> dict[str, list[Record]]:
    """Runs of one setting together; of a run that was made anew the last one holds."""
    latest: dict[str, dict[int, Record]] = {}
    for record in records:
        if record["record"] == "run":
            latest.setdefault(record["key"], {})[record["repeat"]] = record
    return {key: [of[n] for n in sorted(of)] for key, of in latest.items()}


def _words(rows: list[Record], name: str) -> NDArray[np.object_]:
    return np.array([row.get(name) or "" for row in rows], dtype=object)


def _numbers(values: Iterable[float | None]) -> NDArray[np.float64]:
    """The values, NaN where there is none."""
    return np.array([np.nan if value is None else value for value in values], dtype=float)


def _bench(row: Record) -> tuple[object, ...]:
    return tuple(row[name] for name in BENCH)


def _rhs_seconds(records: list[Record]) -> dict[tuple[object, ...], float]:
    """Median time of a right-hand side on each mesh [s]."""
    return {bench: float(np.median(times)) for bench, times in _calibrations(records).items()}


def _calibrations(records: list[Record]) -> dict[tuple[object, ...], list[float]]:
    found: dict[tuple[object, ...], list[float]] = {}
    for record in records:
        if record["record"] == "calibration":
            found.setdefault(_bench(record["bench"]), []).append(record["seconds"])
    return found


def _noise(records: list[Record]) -> float:
    """Spread of the time of right-hand sides over the sweep: 10th to 90th percentile / median."""
    shares = [
        np.array(times) / np.median(times) for times in _calibrations(records).values() if times
    ]
    if not shares:
        return float("nan")
    low, high = np.percentile(np.concatenate(shares), [10.0, 90.0])
    return float(high - low)


def _times(runs: list[list[Record]]) -> dict[str, Any]:
    """Times of the repeats, their median and their spread; of failed runs what they took."""
    most = max(len(group) for group in runs)
    table = {}
    for name in ("wall", "cpu"):
        values = np.full((len(runs), most), np.nan)
        for i, group in enumerate(runs):
            values[i, : len(group)] = _numbers(r["row"].get(f"{name}_seconds") for r in group)
        table[name] = values
    told = ~np.isnan(table["wall"]).all(axis=1)
    wall, cpu, spread = (np.full(len(runs), np.nan) for _ in range(3))
    wall[told] = np.nanmedian(table["wall"][told], axis=1)
    cpu[told] = np.nanmedian(table["cpu"][told], axis=1)
    extent = np.nanmax(table["wall"][told], axis=1) - np.nanmin(table["wall"][told], axis=1)
    spread[told] = extent / np.maximum(wall[told], np.finfo(float).tiny)
    seconds = {"units": "s"}
    return {
        "wall": (("run", "repeat"), table["wall"], seconds),
        "cpu": (("run", "repeat"), table["cpu"], seconds),
        "wall_seconds": ("run", wall, seconds),
        "cpu_seconds": ("run", cpu, seconds),
        "wall_spread": ("run", spread, {"units": "1", "long_name": "(max - min) / median"}),
    }


def _errors(runs: list[list[Record]]) -> tuple[list[float], NDArray[np.float64]]:
    """Report days, and errors (run, kind, field, norm, report_day)."""
    entries = [group[0]["errors"] for group in runs]
    days = sorted({entry["day"] for errors in entries for entry in errors})
    table = np.full((len(runs), len(KINDS), len(ERRORS), len(NORMS), len(days)), np.nan)
    for run, errors in enumerate(entries):
        for entry in errors:
            day = days.index(entry["day"])
            for i, field in enumerate(ERRORS):
                norms = entry.get(field, {})
                values = _numbers(norms.get(norm) for norm in NORMS)
                table[run, KINDS.index(entry["kind"]), i, :, day] = values
    return days, table


def _attributes(header: Record, records: list[Record]) -> dict[str, Any]:
    dt, check = _converged(records)
    return {
        "title": f"time steps and cost: {header['title']}",
        "scene": header["scene"],
        "plan": json.dumps(header["plan"]),
        "machine": header["machine"],
        "cores": header["cores"],
        "sources": json.dumps(header["sources"]),
        "versions": json.dumps(header["versions"]),
        "created": header["created"],
        "noise": _noise(records),
        "converged_dt": dt,
        "converged_check": check,
        "command": header["command"],
    }


def _converged(records: list[Record]) -> tuple[float, float]:
    """Step of the time-converged run, and its own error in time (l2 of h at the end).

    Where there are several meshes: of the one with the largest error.
    """
    finest: dict[tuple[object, ...], tuple[float, float]] = {}
    for record in records:
        if record["record"] != "run" or record["row"]["role"] != "converged":
            continue
        row, errors = record["row"], record["errors"]
        ends = [e for e in errors if e["kind"] == "time" and e["day"] == row["days_planned"]]
        known = [l2 for entry in ends if (l2 := entry.get("h", {}).get("l2")) is not None]
        for l2 in known:
            here = (row["dt"], l2)
            finest[_bench(row)] = min(finest.get(_bench(row), here), here)
    return max(finest.values(), key=lambda pair: pair[1], default=(float("nan"), float("nan")))
