"""The attribute `history` of files: when what was done with which version."""

from __future__ import annotations

from datetime import UTC, datetime

from swe_sphere import __version__


def history(action: str, before: str = "") -> str:
    """A line for what is done now, above those of what was done before (CF-1.11, section 2.6.2)."""
    now = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    line = f"{now} swe-sphere {__version__}: {action}"
    return f"{line}\n{before}" if before else line
