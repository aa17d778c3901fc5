"""The notebook in docs does what it says, from its first cell to its last."""

from pathlib import Path

import nbformat
from nbclient import NotebookClient

NOTEBOOK = Path(__file__).parents[1] / "docs" / "first_steps.ipynb"


def test_the_first_steps_run_as_a_new_user_would(tmp_path):
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    resources = {"metadata": {"path": tmp_path}}
    NotebookClient(notebook, timeout=600, kernel_name="python3", resources=resources).execute()
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    found = [out.get("data", {}) for cell in cells for out in cell.outputs]
    texts = "\n".join(data.get("text/plain", "") for data in found)
    assert "<Summary of galewsky with rk4: completed>" in texts
    assert "<Summary of lauter with heun3: completed>" in texts
    assert sum("image/png" in data for data in found) == 3
    assert (tmp_path / "jet.nc").exists()
