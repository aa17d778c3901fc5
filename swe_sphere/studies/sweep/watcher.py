"""How a sweep tells a user interface what it is doing."""

from __future__ import annotations

from typing import Any

from swe_sphere.studies.sweep.case import Case

__all__ = ["SweepWatcher"]


class SweepWatcher:
    """Told how a sweep is going; this one does not care."""

    def expect(self, runs: int) -> None:
        """So many runs more are to come."""

    def begin(self, case: Case) -> None:
        """A run is about to be made."""

    def tick(self, step: int) -> None:
        """So many of its steps are done; told about ten times a second."""

    def done(self, case: Case, record: dict[str, Any]) -> None:
        """A run is in the journal, now or from before."""

    def note(self, text: str) -> None:
        """Something the user should know, in one line."""
