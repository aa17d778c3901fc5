"""The files that a scene of the user's own is made of."""

from __future__ import annotations

import os
import tomllib
from pathlib import Path

__all__ = ["scene_files"]


def scene_files(name: str) -> list[Path]:
    """The file of a scene that can be loaded, then its base's, and so on; none for a scene by name.

    Raises:
        OSError: one of them is gone meanwhile.
    """
    path = Path(name)
    if path.suffix == ".py":
        return [path]
    if path.suffix != ".toml":
        return []
    base = str(tomllib.loads(path.read_text(encoding="utf-8"))["base"])
    deeper = base.endswith((".py", ".toml"))
    return [path, *(scene_files(os.fspath(path.parent / base)) if deeper else [])]
