"""The paths of a step through the package, as docs/explanation/architecture.md lists them."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest
import warp as wp
from test_packaging import LAYERS

import swe_sphere
from swe_sphere.equations.model import Model
from swe_sphere.steppers import get_stepper
from swe_sphere.testcases import get_scene

PACKAGE = str(Path(swe_sphere.__file__).parent)
PAGE = (Path(__file__).parents[1] / "docs" / "explanation" / "architecture.md").read_text()
LISTS = {
    title: re.findall(r"^\d+\. `(\w+): ([\w.]+)`", text, re.MULTILINE)
    for title, text in re.findall(r"^## ([^\n]+)\n(.*?)(?=^## |\Z)", PAGE, re.MULTILINE | re.DOTALL)
}
STEPS = 5
"""Enough for all recordings that a step launches."""


def paths(small_mesh, name: str, monkeypatch, **attributes) -> list[list[tuple[str, str]]]:
    """Functions of the package from `step` to each launch of a recording, in the last step."""
    found, launch = [], wp.capture_launch

    def watched(*arguments):
        frames, frame = [], sys._getframe(1)
        while frame is not None:
            code = frame.f_code
            if code.co_filename.startswith(PACKAGE):
                frames.append((Path(code.co_filename).stem, code.co_qualname))
            frame = frame.f_back
        found.append(frames[::-1])
        return launch(*arguments)

    monkeypatch.setattr(wp, "capture_launch", watched)
    kind = get_stepper(name)
    for attribute, value in attributes.items():
        monkeypatch.setattr(kind, attribute, value)
    model = Model(small_mesh, get_scene("williamson5"))
    stepper = kind(model, 300.0)
    stepper.start(model.initial_state())
    for _ in range(STEPS):
        stepper.step()
    found.clear()
    stepper.step()
    return found


FIRST = ("stepper", "Stepper.step")
PRECONDITIONER = ("block_elimination", "BlockElimination.apply")


@pytest.mark.parametrize("repeats", [0, None], ids=["recorded", "unrecorded"])
def test_explicit_steps_reach_their_launches_in_five_frames(small_mesh, repeats, monkeypatch):
    found = paths(small_mesh, "rk4", monkeypatch, repeats_from=repeats)
    assert found and all(path[0] == FIRST and len(path) <= 5 for path in found)
    assert (LISTS["An explicit step"] in found) == (repeats is None)


@pytest.mark.parametrize("name", ["bdf2", "tr-bdf2", "esdirk4", "gauss-legendre"])
def test_implicit_steps_reach_their_preconditioner_in_twelve_frames(small_mesh, name, monkeypatch):
    inside = [path for path in paths(small_mesh, name, monkeypatch) if PRECONDITIONER in path]
    most = 12 if name != "gauss-legendre" else 14  # which has a preconditioner for each stage
    assert inside and all(path[0] == FIRST and len(path) <= most for path in inside)
    assert (LISTS["An implicit step"] in inside) == (name == "bdf2")


def test_the_page_names_files_that_exist():
    """Also names in the rows of folders, which are inside the folder of their row."""
    root, package = Path(__file__).parents[1], Path(__file__).parents[1] / "swe_sphere"
    for line in PAGE.splitlines():
        folder = re.match(r"\| `(\w+/)`", line)
        for name in re.findall(r"`((?:\w+/)*\w+\.py|(?:\w+/)+)`", line):
            places = [root, package, package / (folder[1] if folder else "")]
            assert any((place / name).exists() for place in places), name


def test_the_rows_of_folders_are_the_order_of_imports():
    rows = re.findall(r"^\| ((?:`\w+/`(?:, )?)+) \|", PAGE, re.MULTILINE)
    order = [name for row in rows for name in re.findall(r"`(\w+)/`", row)]
    assert order[: len(LAYERS)] == [*LAYERS[::-1]]
    assert {*order[len(LAYERS) :]} == {"ranks", "files", "settings"}
