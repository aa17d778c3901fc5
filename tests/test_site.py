"""The pages in docs make a site, without a warning: no link, reference or page is lost."""

import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import swe_sphere
from swe_sphere.testcases import SCENES

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """Built of a copy, as pages of scenes are written among the sources."""
    folder = tmp_path_factory.mktemp("site")
    shutil.copytree(
        ROOT / "docs", folder / "docs", ignore=shutil.ignore_patterns("scenes", "_build")
    )
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "docs", "html"]
    built = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=300)
    assert built.returncode == 0, built.stderr
    return folder / "html"


@pytest.mark.thorough
def test_every_scene_has_a_page_with_its_source_and_its_formula(site):
    for name in SCENES:
        page = (site / "reference" / "scenes" / f"{name}.html").read_text()
        assert "Source:" in page and f"swe-sphere run {name}" in page, name
    page = (site / "reference" / "scenes" / "williamson2.html").read_text()
    assert "sin² θ" in page and "tilt of the axis of flow" in page and "1.4e-11" in page
    page = (site / "reference" / "scenes" / "galewsky.html").read_text()
    assert "so that all that grows is the imprint of the grid." in page


@pytest.mark.thorough
def test_the_front_door_is_described(site):
    page = (site / "reference" / "api.html").read_text()
    for name in set(swe_sphere.__all__) - {"__version__"}:
        assert re.search(rf'id="swe_sphere\.(\w+\.)*{name}"', page), name


@pytest.mark.thorough
def test_pages_need_no_network(site):
    assert "mathjax" in (site / "explanation" / "equations.html").read_text()
    for page in site.rglob("*.html"):
        for tag in re.findall(
            r"<(?:script|img)[^>]* src=[^>]*>|<link[^>]*stylesheet[^>]*>", page.read_text()
        ):
            source = re.search(r'(?:src|href)="([^"?]*)', tag)[1]
            assert source.startswith("data:") or (page.parent / source).exists(), (page, tag)


def test_the_version_is_the_same_everywhere():
    version = swe_sphere.__version__
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert project["version"] == version
    assert f"\nversion: {version}\n" in (ROOT / "CITATION.cff").read_text()
    assert f"\n## {version}" in (ROOT / "CHANGELOG.md").read_text()
