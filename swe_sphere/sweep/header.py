"""The first lines of a journal: what was asked for, and of which machine the times are."""

from __future__ import annotations

import os
import platform
import sys
from datetime import UTC, datetime
from pathlib import Path

from swe_sphere.errors import ConfigError
from swe_sphere.machine import processor, versions
from swe_sphere.model.scene import Scene
from swe_sphere.sweep.journal import Journal
from swe_sphere.sweep.plan import SweepPlan

__all__ = ["write_header"]


def write_header(journal: Journal, plan: SweepPlan, scene: Scene) -> None:
    """Note the plan in the journal, unless it is the one noted last.

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
        if last["plan"] == given and last["machine"] == machine:
            return
    journal.append({
        "record": "sweep", "scene": scene.name, "title": scene.title, "plan": given,
        "machine": machine, "cores": os.cpu_count(), "versions": versions(),
        "created": datetime.now(UTC).isoformat(timespec="seconds"), "command": _command(),
    })  # fmt: skip


def _command() -> str:
    """The command line, with the program by name."""
    program = Path(sys.argv[0]).name if sys.argv else ""
    return " ".join([program, *sys.argv[1:]])
