"""Progress of a sweep, for callers."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from swe_sphere.studies.sweep.record import RunRecord
    from swe_sphere.studies.sweep.runs import RunSpec


class SweepWatcher:
    """Told how a sweep is going; this one does not care."""

    def expect(self, runs: int) -> None:
        """So many runs more are to come."""

    def begin(self, spec: RunSpec) -> None:
        """A run is about to be made."""

    def tick(self, step: int) -> None:
        """So many of its steps are done; told about ten times a second."""

    def done(self, spec: RunSpec, record: RunRecord) -> None:
        """There is a record of a run, a new one or one from before."""

    def beside(self, record: RunRecord) -> None:
        """Another process has made a run."""

    def note(self, text: str) -> None:
        """Something the user should know, in one line."""
