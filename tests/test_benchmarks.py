"""The parts of `python -m benchmarks` exist and write existing pages."""

import runpy
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PARTS = runpy.run_path(str(ROOT / "benchmarks" / "__main__.py"))["PARTS"]


@pytest.mark.parametrize("name", sorted(PARTS))
def test_a_part_runs_a_script_or_a_command_for_a_page(name):
    part = PARTS[name]
    first, second, *_ = *part.command.split(), ""
    assert (ROOT / first).exists() or (first, second) == ("-m", "swe_sphere")
    assert (ROOT / "docs" / f"{part.page}.md").exists()


def test_an_unknown_part_is_refused_with_the_names_of_all():
    ended = subprocess.run(
        [sys.executable, "-m", "benchmarks", "nonsense"],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert ended.returncode == 2
    assert "nonsense" in ended.stderr and "step_sizes" in ended.stderr
