"""How many of our functions stand between a step and the launches that it makes."""

from __future__ import annotations

import traceback
from pathlib import Path

import pytest
import warp as wp

import swe_sphere
from swe_sphere.equations.model import Model
from swe_sphere.steppers import get_stepper
from swe_sphere.testcases import get_scene

PACKAGE = str(Path(swe_sphere.__file__).parent)
STEPS = 5
"""Enough for all recordings that a step launches."""


def paths(small_mesh, name: str, monkeypatch, **attributes) -> list[list[str]]:
    """Functions of the package from `step` to each launch of a recording, in the last step."""
    found, launch = [], wp.capture_launch

    def watched(*arguments):
        frames = [f for f in traceback.extract_stack() if f.filename.startswith(PACKAGE)]
        found.append([f"{Path(f.filename).stem}.{f.name}" for f in frames])
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


@pytest.mark.parametrize("repeats", [0, None], ids=["recorded", "unrecorded"])
def test_explicit_steps_reach_their_launches_in_five_frames(small_mesh, repeats, monkeypatch):
    found = paths(small_mesh, "rk4", monkeypatch, repeats_from=repeats)
    assert found and all(path[0] == "stepper.step" and len(path) <= 5 for path in found)


@pytest.mark.parametrize("name", ["bdf2", "tr-bdf2", "esdirk4", "gauss-legendre"])
def test_implicit_steps_reach_their_preconditioner_in_twelve_frames(small_mesh, name, monkeypatch):
    inside = [
        path for path in paths(small_mesh, name, monkeypatch) if "block_elimination.apply" in path
    ]
    most = 12 if name != "gauss-legendre" else 14  # which has a preconditioner for each stage
    assert inside and all(path[0] == "stepper.step" and len(path) <= most for path in inside)
