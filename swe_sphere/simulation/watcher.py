"""How a run tells a user interface what it is doing."""

from __future__ import annotations

from swe_sphere.simulation.prepare import Prepared

__all__ = ["Watcher"]


class Watcher:
    """Told how a run is going; this one does not care."""

    def warn(self, text: str) -> None:
        """Something the user should know, in one line."""

    def begin(self, prepared: Prepared) -> None:
        """The first step is about to be taken."""

    def tick(self, step: int) -> None:
        """So many steps from the very start lie behind; told about ten times a second."""

    def end(self) -> None:
        """The last step has been taken."""
