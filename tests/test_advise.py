"""Advice: a search within a budget, the table, and a command that runs."""

import re
import shlex

import pytest

from swe_sphere.cli.main import main
from swe_sphere.settings.values import validate
from swe_sphere.studies import advise as advising
from swe_sphere.studies.advise import REPRESENTATIVES, Question
from swe_sphere.studies.sweep import SweepWatcher, sweep


def advise(*arguments: str) -> int:
    with pytest.raises(SystemExit) as end:
        main(["advise", *arguments])
    return int(end.value.code)


def test_the_representatives_are_of_all_families() -> None:
    from swe_sphere.steppers import STEPPERS

    families = {kind.family for kind in STEPPERS.values()}
    assert {STEPPERS[name].family for name in REPRESENTATIVES} == families


def test_the_cheapest_is_found_and_its_command_can_be_given(capsys) -> None:
    given = ("williamson5", "--error", "3e-3", "--ne", "2", "--days", "0.5", "--steppers",
             "rk4,tr-bdf2", "--set", "scene.speed=10")  # fmt: skip
    assert advise(*given) == 0
    out = capsys.readouterr().out
    assert "Measured over 0.5 days." in out and "slow-flow error" in out
    assert re.search(r"^ rk4 .* s.*\n .* s.*\n", out, re.MULTILINE)
    (command,) = re.findall(r"^  (swe-sphere run .*)$", out, re.MULTILINE)
    words = shlex.split(command)
    assert words[words.index("--set") + 1] == "scene.speed=10"
    assert words[words.index("--stepper") + 1] in ("rk4", "tr-bdf2")
    with pytest.raises(SystemExit) as end:
        main([*words[1:], "--quiet"])
    assert end.value.code in (None, 0)


def test_where_the_budget_is_short_shorter_runs_are_measured(monkeypatch) -> None:
    """And a smaller error stands for the one that is wanted."""
    monkeypatch.setattr(advising, "_seconds_a_day", lambda *_: 1.0)
    asked = {"scene": "lauter", "ne": 2, "np": 4, "days": 2.0, "error": 0.1, "steppers": "rk4",
             "budget": 0.6 * advising.RUNS}  # fmt: skip
    advice = advising.advise(validate(Question, asked))
    assert (advice.days, advice.of_days) == (0.5, 2.0)
    assert advice.ranking.targets == [0.025]
    assert advice.config.days == 2.0 and advice.config.stepper == "rk4"
    assert advice.ranking.winners(0).iloc[0][advice.ranking.metric] <= 0.025


def test_a_search_keeps_to_its_budget() -> None:
    notes: list[str] = []
    watcher = SweepWatcher()
    watcher.note = notes.append  # type: ignore[method-assign]
    found = sweep(
        "lauter", ["rk4", "bdf2"], watcher=watcher, ne=2, np=4, days=0.5, target_error=1e-3,
        target_kind="time", budget=1e-6,
    )  # fmt: skip
    assert found.role.values.tolist() == ["converged", "converged"]
    assert len(notes) == 2 and all("no step is accurate enough" in note for note in notes)


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (("williamson5", "--error", "0"), "error: must be greater than 0, got 0.0"),
        (("williamson5", "--error", "nan"), "error: must be a finite number"),
        (("williamson5", "--error", "2"), "error: must be less than 1"),
        (("williamson5", "--error", "1e-3", "--budget", "0"), "budget: must be greater than 0"),
        (("williamson55", "--error", "1e-3"), "unknown scene 'williamson55'; did you mean"),
        (("williamson5",), "error: give the largest error at the end (--error 1e-3)"),
    ],
)
def test_what_cannot_be_advised_on_is_one_line(arguments, line, capsys) -> None:
    assert advise(*arguments) == 2
    err = capsys.readouterr().err
    assert line in err and err.count("\n") == 1


def test_a_reference_that_becomes_unstable_is_blamed(swe):
    status, _, told = swe(
        "advise", "galewsky", "--set", "scene.speed=250", "--error", "1e-3", "--ne", "2",
        "--steppers", "rk4", "--days", "2", "--np", "4",
    )  # fmt: skip
    assert status == 2 and "the reference run fails" in told


def test_an_error_that_nothing_keeps_to_is_told(capsys) -> None:
    """One below that of the reference run, and one that no stepper reaches within the budget."""
    given = ("lauter", "--ne", "2", "--days", "0.1", "--steppers", "rk4", "--error")
    assert advise(*given, "1e-14") == 2
    told = capsys.readouterr().err
    assert re.search(
        r"error: 1e-14 cannot be measured, as the error of the reference run is [\d.]+e-\d+: give",
        told,
    )
    assert advise(*given, "1e-3", "--budget", "1e-6") == 2
    assert "error: no step keeps the error to 0.001 over 0.1 days" in capsys.readouterr().err
