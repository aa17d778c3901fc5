"""The notebooks in docs/tutorials do what they say, from the first cell to the last."""

import re
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

TUTORIALS = Path(__file__).parents[1] / "docs" / "tutorials"


def executed(name, folder, instead=()):
    """What the cells of a notebook show, run in that folder; instead: pairs of old and new text."""
    notebook = published(name)
    for old, new in instead:
        (cell,) = (cell for cell in notebook.cells if old in cell.source)
        cell.source = cell.source.replace(old, new)
    resources = {"metadata": {"path": folder}}
    NotebookClient(notebook, timeout=600, kernel_name="python3", resources=resources).execute()
    return shown(notebook)


def published(name):
    return nbformat.read(TUTORIALS / name, as_version=4)


def shown(notebook):
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    return [out.get("data", {}) for cell in cells for out in cell.outputs]


@pytest.mark.thorough
def test_the_first_steps_run_as_a_new_user_would(tmp_path):
    """A day of the jet and each run timed once; what is published shows all of it."""
    short = [
        ("sim.run(days=6,", "sim.run(days=1,"),
        ("sim.run(days=6.5)", "sim.run(days=1.5)"),
        ("repeats=3", "repeats=1"),
    ]
    for found in (
        shown(published("first_steps.ipynb")),
        executed("first_steps.ipynb", tmp_path, short),
    ):
        texts = "\n".join(data.get("text/plain", "") for data in found)
        assert "<Summary of galewsky with rk4: completed>" in texts
        assert "<Summary of lauter with heun3: completed>" in texts
        assert sum("image/png" in data for data in found) == 3
    assert (tmp_path / "jet.nc").exists()


@pytest.mark.thorough
def test_what_accuracy_costs_is_found(tmp_path):
    found = executed("cost.ipynb", tmp_path)
    runs, answer = (data["text/plain"] for data in found if "text/html" in data)
    assert all(runs.count(name) == 4 for name in ("rk4", "semi-implicit", "tr-bdf2"))
    assert answer.splitlines()[1].split()[1] == "rk4"
    assert sum("image/png" in data for data in found) == 1


@pytest.mark.thorough
def test_own_scene_stepper_and_diagnostic_do_what_they_should(tmp_path):
    found = executed("own.ipynb", tmp_path)
    texts = [data["text/plain"] for data in found if data and "image/png" not in data]
    errors, stepper, orders, longitudes = texts
    for coarse, fine in re.findall(r"\[(\S+), (\S+)\]", errors):
        assert 8.0 < float(coarse) / float(fine) < 32.0
    assert "stepper='kutta3'" in stepper
    assert all(2.6 < float(order) < 3.2 for order in re.findall(r"\d\.\d+", orders))
    there, expected = (float(number) for number in re.findall(r"\d+\.\d+", longitudes))
    assert abs(there - expected) < 0.1


@pytest.mark.exhaustive
def test_output_is_read_and_regridded(tmp_path):
    pytest.importorskip("dask")
    found = executed("output.ipynb", tmp_path)
    texts = [data.get("text/plain", "") for data in found]
    assert "<Summary of williamson5 with rk4: completed>" in texts
    assert sum("image/png" in data for data in found) == 3
    assert (tmp_path / "grid.nc").exists()
