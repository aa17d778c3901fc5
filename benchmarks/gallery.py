"""Write docs/reference/gallery.md and draw a small picture of every scene.

    python benchmarks/gallery.py [SCENE ...]

Runs each scene (all of them, or those named) on a coarse mesh, for some minutes in all, and draws
it.  The commands of the page draw the same pictures.
"""

from __future__ import annotations

import shlex
import subprocess
import sys
import tempfile
from pathlib import Path

from swe_sphere.testcases import SCENES, get_scene

DOCS = Path(__file__).resolve().parents[1] / "docs" / "reference"
DOTS = 72
RUNS = {
    "williamson1": ("--ne 8 --np 6 --days 3", "--winds arrows"),
    "williamson2": ("--ne 4 --np 6 --days 5 --alpha 0.785", "--winds arrows"),
    "williamson3": ("--ne 8 --np 6 --days 5", "--winds streamlines"),
    "williamson4": ("--ne 8 --np 6 --days 2", "--projection north-polar"),
    "williamson5": ("--ne 8 --np 6 --days 10", "--projection robinson --centre 180"),
    "williamson6": ("--ne 8 --np 6 --days 7", "--projection north-polar"),
    "williamson7": ("--ne 8 --np 6 --days 2", "--projection robinson"),
    "galewsky": (
        "--ne 12 --np 6 --days 6 --set viscosity.nu=1e5",
        "--field vorticity --projection north-polar --region -180,180,15,90",
    ),
    "lauter": ("--ne 6 --np 6 --days 2", "--winds streamlines"),
    "moving-vortices": (
        "--ne 10 --np 6 --days 12",
        "--projection orthographic --centre 270 --no-contours",
    ),
    "deformational": ("--ne 12 --np 4 --days 6", ""),
    "lake-at-rest": ("--ne 6 --np 6 --days 1", "--field b --mesh"),
    "mcdonald-bates": ("--ne 8 --np 6 --days 5", "--projection north-polar"),
    "modons": ("--ne 8 --np 4 --days 5", "--field vorticity --projection lat-lon"),
    "matsuno": ("--ne 4 --np 6 --days 2", "--projection lat-lon --winds arrows"),
    "turbulence": (
        "--ne 16 --np 6 --days 10 --set hyperviscosity.nu=default",
        "--field vorticity --projection orthographic --centre 0,30",
    ),
    "splash": ("--ne 6 --np 6 --days 0.4", "--projection robinson --no-contours"),
    "gravity-bumps": ("--ne 6 --np 6 --days 0.25", "--no-contours"),
    "dam-break": ("--ne 12 --np 4 --days 0.1", "--projection robinson --no-contours"),
    "tide": ("--ne 4 --np 6 --days 0.25", "--projection robinson --winds arrows"),
    "slow-ocean": ("--ne 6 --np 6 --days 2", "--projection robinson --winds arrows"),
    "relaxed-jet": (
        "--ne 12 --np 4 --days 20",
        "--field vorticity --projection north-polar --region -180,180,0,90",
    ),
}
"""How each scene is run, and how it is drawn."""

HEAD = """# Gallery

This page shows every scene on a coarse mesh, with the commands that make its picture (reduced in
size here). [Pictures](../howto/pictures.md) explains the flags of `plot`. Made by `python
benchmarks/gallery.py`.
"""


def main(*names: str) -> None:
    """Run and draw the scenes named, or all, and write the page."""
    with tempfile.TemporaryDirectory() as folder:
        for name in names or RUNS:
            draw(name, Path(folder) / f"{name}.nc")
    parts = [HEAD, *(section(name) for name in SCENES)]
    (DOCS / "gallery.md").write_text("\n".join(parts))


def draw(name: str, file: Path) -> None:
    """The picture of a scene."""
    from swe_sphere.pictures import plot as drawing

    how, look = RUNS[name]
    command = [sys.executable, "-m", "swe_sphere"]
    subprocess.run(
        [*command, "run", name, *shlex.split(how), "--out", str(file), "--quiet"], check=True
    )
    drawing.DOTS_PER_INCH = DOTS
    from swe_sphere.cli.main import program

    (DOCS / "gallery").mkdir(exist_ok=True)
    out = DOCS / "gallery" / f"{name}.png"
    program(["plot"])(["plot", str(file), *shlex.split(look), "--no-panel", "--out", str(out)],
        standalone_mode=False)  # fmt: skip


def section(name: str) -> str:
    """What the page says of a scene."""
    how, look = RUNS[name]
    scene = get_scene(name)
    return (
        f"## {name}\n\n{scene.title[0].upper()}{scene.title[1:]}. {scene.reference}.\n\n"
        f"![{name}](gallery/{name}.png)\n\n"
        f"```sh\nswe-sphere run {name} {how} --out {name}.nc\n"
        f"swe-sphere plot {name}.nc {look + ' ' * bool(look)}--no-panel\n```\n"
    )


if __name__ == "__main__":
    main(*sys.argv[1:])
