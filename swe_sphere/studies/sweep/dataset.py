"""From the records to one dataset, a row for every run: sweep.nc."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from swe_sphere.errors import ConfigError
from swe_sphere.files.durable import write_whole
from swe_sphere.studies.record_store import as_netcdf
from swe_sphere.studies.sweep.record import (
    CLOCKS,
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

DATASET = "sweep.nc"

WORDS = (
    "scene", "stepper", "preconditioner", "precision", "device", "settings", "role", "status",
    "reason",
)  # fmt: skip
"""Words of a row."""
UNITS = {
    **dict.fromkeys(("ne", "np", "stretch", "steps", "jobs", *COUNTS), "1"),
    **dict.fromkeys(("mass_drift", "energy_drift", "enstrophy_drift"), "1"),
    **dict.fromkeys(("dt", "gravity_limit", "advective_limit"), "s"),
    **dict.fromkeys(("compile_seconds", "setup_seconds", "total_seconds"), "s"),
    **dict.fromkeys(("days", "days_planned"), "d"),
    "peak_memory": "byte",
}
"""Numbers of a row and their units; others that a run has come without."""


def build_dataset(header: Header, records: list[RunRecord]) -> xr.Dataset:
    """The dataset of a sweep; rows in the order in which they were run.

    Only runs of the sources that the sweep had last are in it: others cannot be compared with them.
    dims: run, kind, field, norm, report_day [days], repeat.  There must be a run.
    """
    records = current(records, header.sources)
    last = {(record.key, record.repeat): record for record in records}
    index = pd.MultiIndex.from_tuples(last, names=["key", "repeat"])
    table = pd.DataFrame([_row(record, header.scene) for record in last.values()], index)
    runs = table.xs(0, level="repeat")
    data: dict[str, Any] = {name: ("run", runs[name].to_numpy(object)) for name in WORDS}
    for name in (*UNITS, *(name for name in runs if name not in {*UNITS, *WORDS, *CLOCKS})):
        units = {"units": UNITS[name]} if name in UNITS else {}
        data[name] = ("run", runs[name].to_numpy(float), units)
    # a repeat that was cut short has no time of the whole run
    kept = (table.index.get_level_values("repeat") == 0) | (table["status"] == "completed")
    for name in CLOCKS:
        repeats = table[name].where(kept).unstack("repeat").loc[runs.index].to_numpy(float)
        data[name.removesuffix("_seconds")] = (("run", "repeat"), repeats, {"units": "s"})
        times = np.pad(np.sort(repeats, axis=1), ((0, 0), (0, 1)), constant_values=np.nan)
        data[name] = ("run", times[:, 0], {"units": "s"})  # NaN comes last
        if name == CLOCKS[bool((runs["device"] != "cpu").any())]:
            told = {"units": "1", "long_name": f"of {name}: (second shortest - shortest)/shortest"}
            with np.errstate(divide="ignore", invalid="ignore"):
                data["spread"] = ("run", times[:, 1] / times[:, 0] - 1.0, told)
    data["error"] = _errors([last[key, 0] for key in runs.index])
    attributes = {
        name: json.dumps(value) if isinstance(value, dict) else value for name, value in header
    }
    attributes["title"] = f"time steps and cost: {header.title}"
    attributes["converged_dt"], attributes["converged_check"] = _converged(records)
    return xr.Dataset(data, attrs=attributes)


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


def _row(run: RunRecord, scene: str) -> dict[str, Any]:
    """A line of the table of records."""
    config = run.config
    return {
        **dict.fromkeys((*UNITS, *CLOCKS)), **run.numbers,
        **{name: getattr(config, name) for name in ("stepper", "dt", *MESH)},
        **{name: getattr(run, name) for name in ("role", "status", "reason", "jobs")},
        "scene": scene, "preconditioner": config.preconditioner or "",
        "settings": " ".join(map(str, config.settings)), "days_planned": config.days,
    }  # fmt: skip


def _errors(runs: list[RunRecord]) -> xr.DataArray:
    """All errors, NaN where there is none."""
    days = sorted({error.day for run in runs for error in run.errors})
    values = np.full((len(runs), len(KINDS), len(FIELDS), len(NORMS), len(days)), np.nan)
    for n, run in enumerate(runs):
        for error in run.errors:
            kind, field = KINDS.index(error.kind), FIELDS.index(error.field)
            norms = [getattr(error, norm) for norm in NORMS]
            values[n, kind, field, :, days.index(error.day)] = norms
    labels = {"kind": [*KINDS], "field": [*FIELDS], "norm": [*NORMS],
              "report_day": ("report_day", days, {"units": "d"})}  # fmt: skip
    return xr.DataArray(values, labels, ["run", *labels], attrs={"units": "1"})


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
    return max(finest.values(), key=lambda pair: pair[1], default=(math.nan, math.nan))
