"""The pages in docs make a site, without a warning: no link, reference or page is lost."""

import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import typer

import swe_sphere
from swe_sphere.cli.main import program
from swe_sphere.testcases import SCENES

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """Built of a copy, as pages of scenes are written among the sources."""
    folder = tmp_path_factory.mktemp("site")
    shutil.copytree(
        ROOT / "docs", folder / "docs", ignore=shutil.ignore_patterns("generated", "_build")
    )
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "docs", "html"]
    built = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=300)
    assert built.returncode == 0, built.stderr
    return folder / "html"


@pytest.mark.thorough
def test_every_scene_has_a_section_with_its_source_and_its_formula(site):
    page = (site / "reference" / "scenes.html").read_text()
    parts = page.split('<section id="')
    sections = {part.partition('"')[0]: part for part in parts}
    for name in SCENES:
        section = sections[name]
        assert "<strong>Source</strong>" in section and f"swe-sphere run {name}" in section, name
    section = sections["williamson2"]
    assert "sin² θ" in section and "tilt of the axis of flow" in section and "1.4e-11" in section
    assert "so that all growth comes from the imprint of the grid." in sections["galewsky"]


@pytest.mark.thorough
def test_every_option_of_every_command_is_in_the_reference(site):
    page = (site / "reference" / "commands.html").read_text()
    for name, command in typer.main.get_command(program()).commands.items():
        assert f'<section id="{name}">' in page
        for option in command.params:
            assert all(flag in page for flag in option.opts), option.name


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
