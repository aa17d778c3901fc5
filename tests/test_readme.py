"""What the README says works."""

import re
import textwrap
from pathlib import Path

import pytest

from swe_sphere.cli.main import main
from swe_sphere.experiment import run
from swe_sphere.simulation import load_config, make_config

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()
SCENE, SCRIPT = re.findall(r"```python\n(.*?)```", README, re.DOTALL)


def test_the_scene_runs_and_stays_in_balance(tmp_path):
    (tmp_path / "my_flow.py").write_text(SCENE)
    config = make_config({"scene": str(tmp_path / "my_flow.py"), "days": 0.5, "ne": 4})
    assert run(config)["l2_h"] < 1e-3


def test_the_script_runs(capsys):
    exec(SCRIPT.replace('"days": 5.0', '"days": 0.5'), {})
    assert 0.0 < float(capsys.readouterr().out) < 1e-4


def test_the_configuration_file_is_valid(tmp_path):
    block = README.split("can say all of them:\n")[1].split("* **Mesh")[0]
    (tmp_path / "run.toml").write_text(textwrap.dedent(block))
    config = make_config(load_config(tmp_path / "run.toml"))
    assert (config.ne, config.settings) == (16, ("hyperviscosity.nu=default",))


@pytest.mark.parametrize("page", [ROOT / "README.md", ROOT / "docs" / "README.md"])
def test_links_lead_somewhere(page):
    for link in re.findall(r"\]\((?!http)([^)#]+)", page.read_text()):
        assert (page.parent / link).exists(), f"{page.name}: {link}"


def test_the_index_has_every_page():
    index = (ROOT / "docs" / "README.md").read_text()
    for page in (ROOT / "docs").glob("*.md"):
        assert page.name == "README.md" or f"({page.name})" in index, page.name


@pytest.mark.parametrize(
    "line", re.findall(r"^ {4}swe-sphere (run .*?)(?:  .*)?$", README, re.MULTILINE)
)
def test_the_commands_are_understood(line, tmp_path, monkeypatch):
    """Every `run` of the README, up to the point where it would begin."""
    asked = []
    monkeypatch.setattr("swe_sphere.cli.run._run", lambda config: asked.append(config) or 1 / 0)
    with pytest.raises(SystemExit):
        main(line.split())
    assert len(asked) == 1
