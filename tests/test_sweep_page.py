"""The sections about sweeps in docs/howto/steppers.md and docs/reference/files.md."""

import re
from pathlib import Path

import pytest

from swe_sphere.cli.main import main

DOCS = Path(__file__).parents[1] / "docs"
PAGE = (DOCS / "howto" / "steppers.md").read_text()
FILES = (DOCS / "reference" / "files.md").read_text()


def test_the_example_runs(capsys, tmp_path, monkeypatch):
    """Its blocks in order, on a smaller mesh."""
    blocks = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    assert len(blocks) == 5
    monkeypatch.chdir(tmp_path)
    script = "".join(blocks).replace("ne=4, np=4, days=1, repeats=3", "ne=2, np=4, days=0.5")
    names = {}
    exec(script.replace("days=0.5", "days=0.5, repeats=1, levels=4"), names)
    assert set(names["seconds"].stepper.values) == {"rk4", "tr-bdf2", "esdirk4"}
    assert (names["limits"].sel(stepper="esdirk4") > names["limits"].sel(stepper="rk4")).item()
    assert "esdirk4" in capsys.readouterr().out
    assert "tr-bdf2" in Path("runs.csv").read_text()
    assert all(Path(f"{name}.pdf").exists() for name in ("cost", "steps", "limits"))


def test_every_variable_of_the_page_is_there():
    from swe_sphere.io.integrals import DRIFTS
    from swe_sphere.studies.sweep.record import UNITS, WORDS

    table = FILES.split("| name | dimensions")[1].partition("\n## ")[0]
    told = set(re.findall(r"`([a-z_]+)`", table))
    known = {*WORDS, *UNITS, *DRIFTS, "error", "wall", "cpu", "spread"}
    known |= {"wall_seconds", "cpu_seconds"}
    statuses = {
        "grid",
        "target",
        "stability",
        "converged",
        "completed",
        "unstable",
        "refused",
        "failed",
    }
    assert told - known - statuses == set()


@pytest.mark.parametrize(
    "line", re.findall(r"^ {4}swe-sphere (sweep .*?)(?: {2}.*)?$", PAGE, re.MULTILINE)
)
def test_the_commands_are_understood(line, tmp_path, monkeypatch):
    """Up to the point where the runs would begin."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.toml").write_text('scene = "lauter"\nsteppers = ["rk4"]\n')
    asked = []
    monkeypatch.setattr("swe_sphere.cli.sweep.run_sweep", lambda *of: asked.append(of) or 1 / 0)
    with pytest.raises(SystemExit):
        main(line.split())
    assert len(asked) == 1
