"""Single faults that must be noticed; `python -m mutants` plants them all."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from mutants import EDITS, MUTANTS, RESULT_EDITS, STEP_EDITS, Edit, Swap
from mutants.kinds import copy_sources, verdict_of, verdict_of_tests
from mutants.swaps import ASSEMBLY, METRIC, QUADRATURE, SCENES, STEPPERS

TABLE = Path(__file__).parents[1] / "benchmarks" / "results" / "mutants.json"


def label(mutant: Swap | Edit) -> str:
    return mutant.name


def sources(copy: Path) -> dict[Path, bytes]:
    """All that is in a copy: byte code too, if any were written."""
    return {file: file.read_bytes() for file in copy.rglob("*") if file.is_file()}


@pytest.fixture(autouse=True)
def byte_code_of_installed_packages(monkeypatch) -> None:
    """Processes in a copy write none, and would compile all they import in each."""
    monkeypatch.delenv("PYTHONPYCACHEPREFIX", raising=False)


@pytest.mark.parametrize("mutant", [*METRIC, *QUADRATURE, *SCENES, *ASSEMBLY, *STEPPERS], ids=label)
@pytest.mark.thorough
def test_fault_is_noticed(mutant: Swap) -> None:
    assert mutant.caught()


@pytest.mark.thorough
def test_nothing_is_noticed_without_a_fault() -> None:
    none = Swap("none", METRIC[0].where, METRIC[0].cases, lambda found: found)
    assert none.caught() is None


@pytest.mark.parametrize("edit", [*EDITS, *STEP_EDITS, *RESULT_EDITS], ids=label)
def test_text_to_replace_is_there(edit: Edit) -> None:
    """Once; who rewrites the line must say anew what a fault in it would be."""
    assert edit.anchored()
    assert edit.old != edit.new


@pytest.mark.thorough
def test_edited_copy_is_the_one_that_runs(tmp_path) -> None:
    """And is left as it was: its verdict is known already."""
    copy = copy_sources(tmp_path)
    asked = ("start-williamson2",)
    before = sources(copy)
    assert verdict_of(copy, asked) is None
    gravity = Edit("gravity", "swe_sphere/planet.py", asked, "9.80616", "9.80716")
    assert "mean_depth" in gravity.caught(copy)
    assert sources(copy) == before


@pytest.mark.thorough
def test_tests_notice_a_fault_in_a_copy(tmp_path) -> None:
    copy = copy_sources(tmp_path)
    fault = next(edit for edit in STEP_EDITS if "same for all np" in edit.name)
    assert verdict_of_tests(copy, fault.cases) is None
    assert fault.cases[0] in fault.caught(copy)
    with pytest.raises(RuntimeError, match="did not run"):
        verdict_of_tests(copy, ("test_of_nothing.py",))


def test_table_has_these_mutants() -> None:
    """At least 30 of them, of which at least 95 % are noticed."""
    told = json.loads(TABLE.read_text())["faults"]["rows"]
    assert [(name, where) for name, where, _ in told] == [(m.name, f"`{m.where}`") for m in MUTANTS]
    noticed = sum("**nothing**" not in by for *_, by in told)
    assert len(told) >= 30
    assert noticed >= 0.95 * len(told)
