"""What is installed is what is there."""

import subprocess
import sys
import tomllib
from pathlib import Path

import swe_sphere

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())


def test_every_package_is_listed():
    listed = set(PROJECT["tool"]["setuptools"]["packages"])
    inside = {path.parent for path in (ROOT / "swe_sphere").rglob("__init__.py")}
    found = {".".join(path.relative_to(ROOT).parts) for path in inside}
    assert listed == found | {"swe_sphere.kernels", "swe_sphere.testcases"}


def test_the_version_is_the_same_everywhere():
    assert swe_sphere.__version__ == PROJECT["project"]["version"]


def test_python_started_in_the_source_tree_finds_all_of_the_package():
    code = (
        "import swe_sphere.kernels as k, swe_sphere.testcases as t; print(k.__file__, t.__file__)"
    )
    found = subprocess.check_output([sys.executable, "-c", code], text=True, cwd=ROOT).split()
    assert found == [str(ROOT / name / "__init__.py") for name in ("kernels", "testcases")]
