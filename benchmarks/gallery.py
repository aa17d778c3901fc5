"""Draw the small pictures of all scenes in docs/reference/gallery.

    python benchmarks/gallery.py [SCENE ...]

Runs each scene, or those named, on a coarse mesh and draws it, which takes some minutes in all.
The catalogue of scenes shows the commands, which are in docs/reference/gallery/commands.toml.
"""

from __future__ import annotations

import shlex
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

GALLERY = Path(__file__).resolve().parents[1] / "docs" / "reference" / "gallery"
COMMANDS = tomllib.loads((GALLERY / "commands.toml").read_text())
DOTS = 72


def main(*names: str) -> None:
    """Run and draw the scenes named, or all."""
    with tempfile.TemporaryDirectory() as folder:
        for name in names or COMMANDS:
            draw(name, Path(folder) / f"{name}.nc")


def draw(name: str, file: Path) -> None:
    """Run a scene into a file and draw its picture."""
    from swe_sphere.pictures import plot as drawing

    arguments, look = COMMANDS[name]["run"], COMMANDS[name].get("plot", "")
    command = [sys.executable, "-m", "swe_sphere"]
    subprocess.run(
        [*command, "run", name, *shlex.split(arguments), "--out", str(file), "--quiet"], check=True
    )
    drawing.DOTS_PER_INCH = DOTS
    from swe_sphere.cli.main import program

    out = GALLERY / f"{name}.png"
    program(["plot"])(["plot", str(file), *shlex.split(look), "--no-panel", "--out", str(out)],
        standalone_mode=False)  # fmt: skip


if __name__ == "__main__":
    main(*sys.argv[1:])
