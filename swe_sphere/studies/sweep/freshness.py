"""Which records of a journal were made of just the code and the files that there are now."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from swe_sphere.equations.scene import Scene
from swe_sphere.fingerprints import code_fingerprint
from swe_sphere.simulation.scene_files import scene_sources
from swe_sphere.studies.sweep.form import Record
from swe_sphere.studies.sweep.truths import TotalTruth

__all__ = ["fresh", "stale_note", "sweep_sources"]

CODE = "the code of swe_sphere"


def sweep_sources(name: str, scene: Scene, truth: TotalTruth) -> dict[str, str]:
    """Fingerprints of all that the rows of a sweep are made of but its settings, by what it is.

    name: of the scene or its file.
    """
    return {CODE: code_fingerprint(), **scene_sources(name, scene), **truth.sources}


def fresh(records: Iterable[Record], sources: Mapping[str, str]) -> list[Record]:
    """The records that are not made of anything that has changed."""
    return [record for record in records if not _changed(record, sources)]


def stale_note(records: Sequence[Record], sources: Mapping[str, str]) -> str:
    """How many runs are left out as something they are made of has changed since the last sweep.

    Empty where nothing has.
    """
    headers = [record for record in records if record["record"] == "sweep"]
    changed = _changed(headers[-1], sources) if headers else []
    runs = [record for record in records if record["record"] == "run"]
    stale = len(runs) - len(fresh(runs, sources))
    if not changed or not stale:
        return ""
    return (
        f"{stale} of {len(runs)} runs there are left out, and made again where they are asked for:"
        f" {' and '.join(changed)} changed since"
    )


def _changed(record: Record, sources: Mapping[str, str]) -> list[str]:
    """What the record is made of and is not any more what it was.

    A sweep may go on with other files of data: what only one of both names has not changed.
    """
    of = record["sources"]
    return [name for name in sources if of.get(name, sources[name]) != sources[name]]
