"""Records of a sweep: one of each run and one of the request, and the dataset of all runs."""

import json
import math
import os
import platform
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pandas as pd
import xarray as xr
from pydantic import Field

from swe_sphere.errors import ConfigError
from swe_sphere.files.durable import write_whole
from swe_sphere.files.fingerprints import processor, versions
from swe_sphere.io.integrals import DRIFTS, Norms
from swe_sphere.settings.values import flag_of, read_toml
from swe_sphere.simulation.config import RunConfig, SharedConfig
from swe_sphere.studies.record_store import STATUSES, Record, Store, as_netcdf, read_record
from swe_sphere.studies.sweep.runs import DIAGNOSTIC, Role, Study, users_methods

HEADER, RUNS, DATASET = "sweep.json", "runs", "sweep.nc"
"""Names of the file with the request, of the folder of the runs, of the dataset."""

_ROWS = read_toml(Path(__file__).with_name("rows.toml"))
KINDS, FIELDS, NORMS = _ROWS["kinds"], _ROWS["fields"], _ROWS["norms"]
COMPARED = ("grid", "target")
"""Roles of runs that represent a setting; the other runs find limits and references."""
REPEATABLE = 0.03
"""Runs are repeated until their two shortest times differ by at most this fraction."""
CLOCKS = ("cpu_seconds", "wall_seconds")
"""Clocks by which runs on a CPU, and on other devices, are compared."""
MESH, COUNTS, WORDS = _ROWS["mesh"], _ROWS["counts"], _ROWS["words"]
"""Names of the columns of a row: settings of the mesh, counts, and words."""
OTHERS = (*sorted(SharedConfig.model_fields.keys() - MESH), "tolerance")
"""Options of a run without a column; those that differ from the default are in `settings`."""
UNITS = {name: unit for unit, names in _ROWS["units"].items() for name in names}
"""Numbers of a row with their units; further numbers of a run have no unit."""


class Errors(Record):
    """Norms of the error of a field at a report day; relative, null where there is none."""

    kind: Literal["time", "total", "slow"]
    field: Literal["h", "v", "vorticity"]
    day: float
    l1: float | None
    l2: float | None
    linf: float | None

    @classmethod
    def of(cls, kind: str, by_day: Mapping[float, Norms], share: float = 1.0) -> list["Errors"]:
        """Return the errors of all fields and days, multiplied by `share`."""
        return [
            cls(kind=kind, field=name, day=day, **{norm: share * x for norm, x in of.items()})  # type: ignore[arg-type]
            for day, errors in by_day.items()
            for name, of in errors.items()
        ]


class RunRecord(Record):
    """One repeat of a run."""

    key: str
    repeat: int
    role: Role
    config: RunConfig
    """Complete: scene, mesh, stepper, options, step dt [s]; days of the plan, also for trials."""
    status: Annotated[str, Field(pattern=f"^({'|'.join(STATUSES)})$")]
    reason: str
    numbers: Mapping[str, float | None]
    """Costs, limits of the mesh, drifts and diagnostics by name."""
    errors: list[Errors]
    time_limit: float | None
    sources: dict[str, str]
    """Fingerprints of all sources of the run except its settings, by name."""
    jobs: int = 1
    """Number of parallel processes; with several, the times of the run are omitted."""

    @property
    def seconds(self) -> float:
        """CPU time of its steps, on a GPU wall time [s]; NaN if other runs ran in parallel."""
        seconds = self.numbers.get(CLOCKS[self.config.device != "cpu"])
        return math.nan if seconds is None else seconds


class Header(Record):
    """The last request of a folder."""

    scene: str
    title: str
    plan: dict[str, Any]
    sources: dict[str, str]
    machine: str
    cores: int | None
    versions: dict[str, str]
    created: str


def read_header(folder: Path) -> Header | None:
    """Return the last request in a folder; None if there is none."""
    path = folder / HEADER
    return read_record(path, Header) if path.exists() else None


def runs_of(folder: Path, suffix: str = "") -> Store[RunRecord]:
    """Return the runs in a folder of a sweep; suffix: appended to the names of new files."""
    return Store(folder / RUNS, RunRecord, suffix)


def current(runs: Iterable[RunRecord], sources: Mapping[str, str]) -> list[RunRecord]:
    """Return the runs whose sources have not changed."""
    return [run for run in runs if not _changed(run.sources, sources)]


def _changed(of: Mapping[str, str], sources: Mapping[str, str]) -> list[str]:
    """Return the names of sources that have changed; those of only one side are ignored.

    A run without a diagnostic that is registered now has changed, too.
    """
    ours = {name: sources[name] for name in sources if not name.startswith(DIAGNOSTIC)}
    ours |= of
    return [name for name in sources if ours.get(name) != sources[name]]


def note_plan(folder: Path, runs: list[RunRecord], study: Study) -> str:
    """Store the request; return a note on the existing runs.

    The note states how many runs are ignored, because a source has changed since the last sweep; it
    is empty otherwise. Raises ConfigError if the folder is of another scene or not of a sweep.
    """
    sources = study.sources | users_methods(study.plan.steppers, study.plan.preconditioner)
    last, scene = read_header(folder), study.scene
    if last is not None and last.scene != scene.name:
        raise ConfigError(
            f"{folder} holds a sweep of {last.scene}, not of {scene.name}: choose another folder"
        )
    if last is None and not runs and (folder / DATASET).exists():
        raise ConfigError(
            f"out: {folder / DATASET} is not of a sweep, and would be replaced: move it away"
        )
    now = Header(
        scene=scene.name, title=scene.title, sources=sources,
        plan=study.plan.model_dump(mode="json", exclude_defaults=True) | {"days": study.days},
        machine=f"{processor()}, {platform.system()}", cores=os.cpu_count(), versions=versions(),
        created=datetime.now(UTC).isoformat(timespec="seconds"),
    )  # fmt: skip
    if last is None or last.model_copy(update={"created": now.created}) != now:
        write_whole(folder / HEADER, now.as_text())
    changed = _changed(last.sources, sources) if last else []
    stale = len(runs) - len(current(runs, sources))
    if not changed or not stale:
        return ""
    return (
        f"{folder}: {stale} of {len(runs)} runs there are ignored, and repeated if needed:"
        f" {' and '.join(changed)} changed since"
    )


def build_dataset(header: Header, records: list[RunRecord]) -> xr.Dataset:
    """Return the dataset of a sweep; rows in the order in which they were run.

    It contains only runs of the sweep's last sources: others are not comparable. dims: run, kind,
    field, norm, report_day [days], repeat. There must be a run.
    """
    records = current(records, header.sources)
    last = {(record.key, record.repeat): record for record in records}
    index = pd.MultiIndex.from_tuples(last, names=["key", "repeat"])
    table = pd.DataFrame([_row(record, header.scene) for record in last.values()], index)
    runs = table.xs(0, level="repeat")
    data: dict[str, Any] = {name: ("run", runs[name].to_numpy(object)) for name in WORDS}
    for name in (*UNITS, *(name for name in runs if name not in {*UNITS, *WORDS, *CLOCKS})):
        units = "1" if name in DRIFTS else UNITS.get(name)
        data[name] = ("run", runs[name].to_numpy(float), {"units": units} if units else {})
    # a repeat that was cut short has no time of the whole run
    kept = (table.index.get_level_values("repeat") == 0) | (table["status"] == "completed")
    for name in CLOCKS:
        repeats = table[name].where(kept).unstack("repeat").loc[runs.index].to_numpy(float)
        data[name.removesuffix("_seconds")] = (("run", "repeat"), repeats, {"units": "s"})
        times = np.pad(np.sort(repeats, axis=1), ((0, 0), (0, 1)), constant_values=np.nan)
        data[name] = ("run", times[:, 0], {"units": "s"})  # NaN comes last
        if name == CLOCKS[bool((runs["device"] != "cpu").any())]:
            about = {"units": "1", "long_name": f"of {name}: (second shortest - shortest)/shortest"}
            with np.errstate(divide="ignore", invalid="ignore"):
                data["spread"] = ("run", times[:, 1] / times[:, 0] - 1.0, about)
    data["error"] = _errors([last[key, 0] for key in runs.index])
    attributes = {k: json.dumps(x) if isinstance(x, dict) else x for k, x in header}
    attributes["title"] = f"time steps and cost: {header.title}"
    asked = [run for run in records if run.config.days == header.plan.get("days", run.config.days)]
    attributes["converged_dt"], attributes["converged_check"] = _converged(asked)
    return xr.Dataset(data, attrs=attributes)


def write_dataset(folder: Path) -> xr.Dataset:
    """Build the dataset of a folder's records and write it to sweep.nc, completely or not at all.

    Raises ConfigError without a sound record of a run, and RunFailed if the disk fails.
    """
    header, records = read_header(folder), runs_of(folder).records
    if header is None and records:
        raise ConfigError(
            f"{folder}: there is no {HEADER} that states the request: give the command of the sweep"
            " again, without report-only"
        )
    if header is None or not current(records, header.sources):
        raise ConfigError(f"{folder}: there are no runs in this sweep yet")
    dataset = build_dataset(header, records)
    write_whole(folder / DATASET, as_netcdf(dataset))
    return dataset


def _row(run: RunRecord, scene: str) -> dict[str, Any]:
    """Return a line of the table of records."""
    config, fields = run.config, RunConfig.model_fields
    others = [name for name in OTHERS if getattr(config, name) != fields[name].default]
    settings = [*config.settings, *(f"{flag_of(name)}={getattr(config, name)}" for name in others)]
    return {
        **dict.fromkeys((*UNITS, *CLOCKS)), **run.numbers,
        **{name: getattr(config, name) for name in ("stepper", "dt", *MESH)},
        **{name: getattr(run, name) for name in ("role", "status", "reason", "jobs")},
        "scene": scene, "preconditioner": config.preconditioner or "",
        "settings": " ".join(map(str, settings)), "days_planned": config.days,
    }  # fmt: skip


def _errors(runs: list[RunRecord]) -> xr.DataArray:
    """Return all errors as an array; NaN where there is none."""
    days = sorted({error.day for run in runs for error in run.errors})
    values = np.full((len(runs), len(KINDS), len(FIELDS), len(NORMS), len(days)), np.nan)
    for n, run in enumerate(runs):
        for error in run.errors:
            kind, field = KINDS.index(error.kind), FIELDS.index(error.field)
            norms = [getattr(error, norm) for norm in NORMS]
            values[n, kind, field, :, days.index(error.day)] = norms
    labels = {"kind": [*KINDS], "field": [*FIELDS], "norm": [*NORMS],
              "report_day": ("report_day", days, {"units": "d"})}  # fmt: skip
    about = {"units": "1", "comment": "slow errors of vorticity are of potential vorticity"}
    return xr.DataArray(values, labels, ["run", *labels], attrs=about)


def _converged(records: list[RunRecord]) -> tuple[float, float]:
    """Return the step of the time-converged run, and its own error in time (l2 of h at the end).

    With several meshes, both are those of the mesh with the largest error.
    """
    finest: dict[tuple[object, ...], tuple[float, float]] = {}
    for run in records:
        for error in run.errors if run.role == "converged" else ():
            which = (error.kind, error.field, error.day)
            if which == ("time", "h", run.config.days) and error.l2 is not None:
                here = (float(run.config.dt), error.l2)
                mesh = tuple(getattr(run.config, name) for name in MESH)
                finest[mesh] = min(finest.get(mesh, here), here)
    return max(finest.values(), key=lambda pair: pair[1], default=(math.nan, math.nan))
