"""What a sweep keeps: a record of each run, and of what was asked for, of which code and files."""

from __future__ import annotations

import math
import os
import platform
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from swe_sphere.equations.scene import Scene
from swe_sphere.errors import ConfigError
from swe_sphere.files.durable import write_whole
from swe_sphere.files.fingerprints import processor, versions
from swe_sphere.io.norms import Norms
from swe_sphere.simulation.config import RunConfig
from swe_sphere.studies.ended import ENDS
from swe_sphere.studies.record_store import Record, Store, read_record
from swe_sphere.studies.sweep.runs import Role
from swe_sphere.studies.sweep.sweep_plan import SweepPlan

HEADER, RUNS = "sweep.json", "runs"
"""Names of the file that says what was asked for, and of the folder of the runs."""

KINDS = ("time", "total", "slow")
FIELDS = ("h", "v", "vorticity")
NORMS = ("l1", "l2", "linf")
CLOCKS = ("cpu_seconds", "wall_seconds")
"""Clocks by which runs on a CPU, and on other devices, are compared."""
MESH = ("ne", "np", "stretch", "precision", "device")


class Errors(Record):
    """Norms of the error of a field at a report day; relative, null where there is none."""

    kind: Literal["time", "total", "slow"]
    field: Literal["h", "v", "vorticity"]
    day: float
    l1: float | None
    l2: float | None
    linf: float | None

    @classmethod
    def of(cls, kind: str, by_day: Mapping[float, Norms], share: float = 1.0) -> list[Errors]:
        """Errors of fields by day; share: by which they are multiplied."""
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
    """Complete: scene, mesh, stepper and its options, the step dt [s] and the length [days]."""
    status: Annotated[str, Field(pattern=f"^({'|'.join(ENDS)})$")]
    reason: str
    numbers: Mapping[str, float | None]
    """Costs, limits of the mesh, drifts and diagnostics by name."""
    errors: list[Errors]
    time_limit: float | None
    sources: dict[str, str]
    """Fingerprints of all that the run was made of but its settings, by what it is."""
    jobs: int = 1
    """Processes that may have been at work; where it was not alone its times are left out."""

    @property
    def mesh(self) -> tuple[object, ...]:
        """The discretisation of the run."""
        return tuple(getattr(self.config, name) for name in MESH)

    @property
    def seconds(self) -> float:
        """CPU time of its steps, on a GPU wall time [s]; NaN where other runs were beside it."""
        seconds = self.numbers.get(CLOCKS[self.config.device != "cpu"])
        return math.nan if seconds is None else seconds


class Header(Record):
    """What was asked for last."""

    scene: str
    title: str
    plan: dict[str, Any]
    sources: dict[str, str]
    machine: str
    cores: int | None
    versions: dict[str, str]
    created: str


def read_header(folder: Path) -> Header | None:
    """What was asked for last in a folder; None where nothing was."""
    path = folder / HEADER
    return read_record(path, Header) if path.exists() else None


def runs_of(folder: Path, suffix: str = "") -> Store[RunRecord]:
    """The runs in a folder of a sweep; suffix: of the names of new files."""
    return Store(folder / RUNS, RunRecord, suffix)


def current(runs: Iterable[RunRecord], sources: Mapping[str, str]) -> list[RunRecord]:
    """The runs that are not made of anything that has changed."""
    return [run for run in runs if not _changed(run.sources, sources)]


def _changed(of: Mapping[str, str], sources: Mapping[str, str]) -> list[str]:
    """What of some sources is not any more what it was; what only one of both has is left out."""
    return [name for name in sources if of.get(name, sources[name]) != sources[name]]


def note_plan(
    folder: Path, runs: list[RunRecord], plan: SweepPlan, scene: Scene, sources: dict[str, str]
) -> str:
    """Write down what is asked for; returns what the user should know of the runs there.

    Namely how many are left out, as something they are made of has changed since the last sweep;
    empty where nothing has.  Raises ConfigError where the folder is of another scene.
    """
    last = read_header(folder)
    if last is not None and last.scene != scene.name:
        raise ConfigError(
            f"{folder} holds a sweep of {last.scene}, not of {scene.name}: choose another folder"
        )
    now = Header(
        scene=scene.name, title=scene.title, sources=sources,
        plan=plan.model_dump(mode="json", exclude_defaults=True),
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
        f"{folder}: {stale} of {len(runs)} runs there are left out, and made again where they are"
        f" asked for: {' and '.join(changed)} changed since"
    )
