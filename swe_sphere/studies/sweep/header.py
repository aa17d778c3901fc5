"""The first lines of a journal: what was asked for, of which code and files, on which machine."""

from __future__ import annotations

import os
import platform
import sys
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path

from swe_sphere.equations.scene import Scene
from swe_sphere.errors import ConfigError
from swe_sphere.machine import processor, versions
from swe_sphere.studies.sweep.journal import Journal
from swe_sphere.studies.sweep.plan import SweepPlan

__all__ = ["write_header"]


def write_header(
    journal: Journal, plan: SweepPlan, scene: Scene, sources: Mapping[str, str]
) -> None:
    """Note the plan and its sources in the journal, unless they are those noted last.

    Raises:
        ConfigError: the journal is of another scene.
    """
    headers = [record for record in journal.records if record["record"] == "sweep"]
    given, machine = plan.given(), f"{processor()}, {platform.system()}"
    if headers:
        last = headers[-1]
        if last["scene"] != scene.name:
            raise ConfigError(
                f"{journal.path.parent} holds a sweep of {last['scene']}, not of {scene.name}:"
                " choose another folder"
            )
        if (last["plan"], last["machine"], last["sources"]) == (given, machine, sources):
            return
    journal.append({
        "record": "sweep", "scene": scene.name, "title": scene.title, "plan": given,
        "sources": sources, "machine": machine, "cores": os.cpu_count(), "versions": versions(),
        "created": datetime.now(UTC).isoformat(timespec="seconds"), "command": _command(),
    })  # fmt: skip


def _command() -> str:
    """The command line, with the program by name."""
    program = Path(sys.argv[0]).name if sys.argv else ""
    return " ".join([program, *sys.argv[1:]])
