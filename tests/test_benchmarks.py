"""`python -m benchmarks`: its parts, and the pages of results that it writes from stored tables."""

import importlib
import json
import runpy
import subprocess
import sys
from pathlib import Path

import pages
import pytest
import sections
import typer
from sections import Section, measure

ROOT = Path(__file__).parents[1]
BENCHMARKS = runpy.run_path(str(ROOT / "benchmarks" / "__main__.py"))
PARTS = BENCHMARKS["PARTS"]
PACKAGES = ("-m swe_sphere", "-m mutants")


@pytest.mark.parametrize("name", sorted(PARTS))
def test_a_part_runs_scripts_or_commands_for_a_page(name):
    part = PARTS[name]
    for script in part.scripts:
        assert script.startswith(PACKAGES) or (ROOT / script.split()[0]).exists()
    assert (ROOT / "docs" / f"{part.page}.md").exists()


def test_every_stored_table_is_measured_by_a_part_and_stamped():
    tables = {table for part in PARTS.values() for table in part.tables}
    for file in (ROOT / "benchmarks" / "results").glob("*.json"):
        assert file.stem in tables
        for section in json.loads(file.read_text()).values():
            assert section["commit"] and section["date"] and "machine" in section
            assert all(len(row) == len(section["columns"]) for row in section["rows"])


def test_an_unknown_part_is_refused_with_the_names_of_all():
    ended = subprocess.run(
        [sys.executable, "-m", "benchmarks", "nonsense"],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert ended.returncode == 2
    assert "nonsense" in ended.stderr and "performance" in ended.stderr


@pytest.mark.parametrize("path", sorted(pages.render()), ids=lambda path: path.stem)
def test_a_page_of_results_is_made_of_the_stored_tables(path):
    """`python -m benchmarks --pages` writes them again."""
    assert path.read_text(encoding="utf-8") == pages.render()[path]


SCRIPTS = {
    "steps": "steps", "imex_steps": "imex_steps", "step_sizes": "step_sizes",
    "implicit": "implicit", "off_axis": "off_axis", "transport": "transport",
    "tracer_steps": "tracer_steps", "memory": "memory", "kernel_bound": "performance",
}  # fmt: skip


@pytest.mark.parametrize("script", SCRIPTS)
def test_a_script_measures_the_sections_that_are_stored(script, capsys):
    importlib.import_module(script).main(list_sections=True)
    assert {*sections.load(SCRIPTS[script])} <= {*capsys.readouterr().out.split()}


def test_sections_are_stored_one_by_one_and_measured_once(tmp_path, monkeypatch):
    monkeypatch.setattr(sections, "DATA", tmp_path)
    made = []

    def section(name):
        made.append(name)
        if made == ["first", "second"]:
            raise KeyboardInterrupt
        return Section(name, "", ["a", "b"], [["1", "2"], ["3", "4"]])

    parts = {name: lambda name=name: section(name) for name in ("first", "second")}
    with pytest.raises(KeyboardInterrupt):
        measure("test", parts)
    measure("test", parts)
    measure("test", parts)
    assert made == ["first", "second", "second"]
    assert [*sections.load("test")] == ["first", "second"]
    assert pages.stamp("test", "first").endswith(f"{sections.machine()}.")
    measure("test", parts, ["first"])
    assert made[3:] == ["first"]
    with pytest.raises(typer.Exit):
        measure("test", parts, ["third"])


@pytest.mark.thorough
def test_numbers_of_cases_are_stored_as_a_table_and_make_their_page(tmp_path, monkeypatch):
    """Through the files of `swe-sphere verify` and `stress`."""
    from swe_sphere.cli.main import main

    monkeypatch.setattr(pages, "DATA", tmp_path)
    monkeypatch.setitem(BENCHMARKS["store_cases"].__globals__, "DATA", tmp_path)
    for command, folder in (
        ("verify --scenes stepper-rk4", "verification"),
        ("stress --groups rest --steppers rk4", "stability"),
    ):
        with pytest.raises(SystemExit):
            main([*command.split(), "--out", str(tmp_path)])
        made = (tmp_path / f"{folder}.md").read_text()
        BENCHMARKS["store_cases"](folder, tmp_path / f"{folder}.json", 1.0)
        again = pages.cases(folder)
        assert again.partition("## How")[0] == made.partition("## How")[0]
        assert not (tmp_path / f"{folder}.json").exists()
