"""Advice: what it looks at, the laws it goes by, its choice, and sweeps it was not fitted to."""

import json
import math
import re
import shlex
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from fit_methods import Observation, fitted

from swe_sphere.cli.main import main
from swe_sphere.mesh import Mesh
from swe_sphere.planet import DAY, EARTH
from swe_sphere.steppers import STEPPERS
from swe_sphere.studies.advice.advise import candidates, known_methods
from swe_sphere.studies.advice.method import Method, Setting, slow_frequencies
from swe_sphere.studies.regimes.points import Run, cheapest_step

HERE = Setting(300.0, 3000.0, 0.0, 1e-5, 1e-4, 3.0 * DAY)
CHECKS = json.loads((Path(__file__).parent / "data" / "advice.json").read_text())


def test_a_wave_that_is_carried_around_changes_at_its_own_frequency() -> None:
    """A pattern of wavenumber m in a solid-body wind U turns with m U / a."""
    mesh, speed, m = Mesh.build(4, 6), 30.0, 3
    pattern = 1e-5 * np.cos(mesh.lat) ** m * np.cos(m * mesh.lon)
    fields = {"u": speed * np.cos(mesh.lat), "v": 0.0 * mesh.lat, "h": 1e3 + 0.0 * mesh.lat,
              "f": 0.0 * mesh.lat, "vorticity": pattern}  # fmt: skip
    expected = m * speed / EARTH.radius
    assert slow_frequencies(mesh, fields) == pytest.approx((expected, expected), rel=2e-3)
    still = fields | {"u": 0.0 * mesh.lat}
    assert slow_frequencies(mesh, still) == (0.0, 0.0)


def settings() -> list[Setting]:
    rng = np.random.default_rng(3)
    return [
        Setting(g, g * a, d / g, c, t, 3.0 * DAY)
        for g, a, d, c, t in zip(
            rng.uniform(30.0, 600.0, 40),
            rng.uniform(5.0, 300.0, 40),
            rng.uniform(0.0, 2.0, 40),
            rng.uniform(1e-6, 1e-5, 40),
            rng.uniform(1e-6, 1e-4, 40),
            strict=True,
        )
    ]


TRUE = Method("bdf2", (3.0, 0.4, 0.7, 0.2), (-5.0, 1.6, -0.5, 0.3), 1.0, (1.0, 1.0), (), 0)


def observed(method: Method) -> list[Observation]:
    """Runs with several steps that follow the laws exactly."""
    return [
        Observation(
            each, dt, method.step_cost(each, dt) * each.seconds / dt, method.error(each, dt)
        )
        for each in settings()
        for dt in (1800.0, 7200.0, 28800.0)
    ]


def test_the_constants_of_a_law_are_found_again() -> None:
    found = fitted("bdf2", 2, False, observed(TRUE))
    np.testing.assert_allclose(found.price, TRUE.price, atol=0.05)
    np.testing.assert_allclose(found.accuracy, TRUE.accuracy, atol=0.1)
    assert found.doubt < 1.05 and found.reach[1] == 28800.0
    dear = [replace_error(each, 2.0 ** (-1) ** i) for i, each in enumerate(observed(TRUE))]
    assert fitted("bdf2", 2, False, dear).doubt == pytest.approx(2.0, rel=0.1)


def replace_error(of: Observation, factor: float) -> Observation:
    return of._replace(error=of.error * factor)


def test_runs_that_blow_up_are_left_out_and_explicit_steps_have_one_price() -> None:
    runs = [*observed(TRUE), Observation(HERE, 3600.0, 1.0, 3.7)]
    assert fitted("bdf2", 2, False, runs).runs == sum(run.error < 0.3 for run in runs) < len(runs)
    same = [each._replace(cost=4.0 * each.setting.seconds / each.dt) for each in observed(TRUE)]
    price = fitted("rk4", 4, True, same).price
    assert price == pytest.approx((math.log(4.0), 0.0, 0.0, 0.0), abs=1e-3)


RK4 = Method(
    "rk4", (math.log(4.0), 0.0, 0.0, 0.0), (-12.0, 4.0, -4.0, 0.0), 2.0, (0.3, 900.0), (), 9
)
BDF2 = Method("bdf2", (2.0, 0.4, 0.5, 0.0), (-3.0, 2.0, 0.0, 0.0), 1.5, (12.0, 43200.0), (), 9)


def test_the_cheapest_step_that_keeps_to_the_error_is_chosen() -> None:
    limits = {"rk4": 700.0, "bdf2": math.inf}
    for error in (1e-1, 1e-2, 1e-3, 1e-4):
        found = candidates(HERE, limits, error, (RK4, BDF2))
        assert [one.cost for one in found] == sorted(one.cost for one in found)
        for one in found:
            assert one.error * one.method.doubt <= error
            steps = np.geomspace(5.0, min(limits[one.method.stepper], 36000.0), 4000)
            good = [dt for dt in steps if one.method.error(HERE, dt) * one.method.doubt <= error]
            best = min(one.method.step_cost(HERE, dt) * DAY / dt for dt in good)
            assert best <= one.cost <= 1.1 * best
    by_name = {one.method.stepper: one for one in candidates(HERE, limits, 1e-3, (RK4, BDF2))}
    assert by_name["rk4"].bound == "stability" and by_name["rk4"].dt == 700.0
    assert by_name["bdf2"].bound == "error"
    assert candidates(HERE, limits, 1e-16, (RK4, BDF2)) == []
    assert {one.method.stepper for one in candidates(HERE, {"rk4": 700.0}, 1e-2, (RK4, BDF2))} == {
        "rk4"
    }


def test_a_steady_flow_allows_the_longest_step_that_was_tried() -> None:
    steady = replace(HERE, turning=0.0, change=0.0, advective_limit=1e5)
    (found,) = candidates(steady, {"bdf2": math.inf}, 1e-9, (BDF2,))
    assert (found.dt, found.bound, found.error) == (43200.0, "longest tried", 0.0)


def test_no_step_is_advised_that_goes_beyond_one_that_failed() -> None:
    failures = [(9.0, 0.5), (5.0, 0.8), (20.0, 0.1), (9.5, 0.6)]
    method = fitted("bdf2", 2, False, observed(TRUE), failures)
    assert method.failures == ((5.0, 0.8), (9.0, 0.5), (20.0, 0.1))
    steps = {dt: method.works(HERE, dt) for dt in (2300.0, 2500.0, 2700.0)}  # A = G / 10
    assert steps == {2300.0: True, 2500.0: False, 2700.0: False}
    fragile = replace(BDF2, failures=((5.0, 0.5),))
    (found,) = candidates(HERE, {"bdf2": math.inf}, 0.5, (fragile,))
    assert found.dt < 1500.0 and found.bound == "runs that failed"


def test_what_comes_with_the_package_is_of_steppers_there_are() -> None:
    methods = known_methods()
    assert {STEPPERS[method.stepper].family for method in methods} == {
        "explicit", "imex", "exponential", "implicit"
    }  # fmt: skip
    for method in methods:
        assert method.runs >= 8 and 1.0 <= method.doubt < 4.0
        assert method.error(HERE, 7200.0) > method.error(HERE, 3600.0)


# --- sweeps that the constants were not fitted to

FACTOR, MISSED = 1.5, 2.0
"""Its choice costs at most so many times the cheapest, and errs by so many times what was asked."""


@pytest.mark.parametrize("error", [1e-2, 3e-3, 1e-3])
@pytest.mark.parametrize("sweep", CHECKS, ids=lambda sweep: sweep["name"])
def test_the_choice_is_nearly_the_cheapest_of_a_sweep(sweep, error) -> None:
    setting = Setting(**sweep["setting"])
    runs: dict[str, list[Run]] = {}
    for name, dt, cost, err in sorted(sweep["runs"], key=lambda run: -run[1]):
        runs.setdefault(name, []).append(Run(name, dt, 1.0, err, cost))
    limits = {name: sweep["limits"].get(name, math.inf) for name in runs}
    best = candidates(setting, limits, error, known_methods())[0]
    cost, err = seen(runs[best.method.stepper], best.dt)
    offers = [offer for of in runs.values() if (offer := cheapest_step(of, error)) is not None]
    assert cost <= FACTOR * min(offer.cost for offer in offers)
    assert err <= MISSED * error


def seen(runs: list[Run], dt: float) -> tuple[float, float]:
    """Cost and error of a step in a sweep: between two runs by logarithms, else of the nearest."""
    for longer, shorter in pairwise(runs):
        if shorter.dt <= dt <= longer.dt:
            share = math.log(dt / shorter.dt) / math.log(longer.dt / shorter.dt)
            return (shorter.cost * (longer.cost / shorter.cost) ** share,
                    shorter.error * (longer.error / shorter.error) ** share)  # fmt: skip
    near = runs[0] if dt > runs[0].dt else runs[-1]
    return near.cost * near.dt / dt, near.error


# --- the command


def advise(*arguments: str) -> int:
    with pytest.raises(SystemExit) as end:
        main(["advise", *arguments])
    return int(end.value.code)


def test_the_command_that_is_advised_can_be_given(capsys) -> None:
    assert advise("williamson5", "--error", "3e-3", "--ne", "3", "--days", "0.1000625",
                  "--set", "scene.speed=10") == 0  # fmt: skip
    out = capsys.readouterr().out
    assert "U/c = 0.04" in out and "bound by" in out
    (command,) = re.findall(r"^  (swe-sphere run .*)$", out, re.MULTILINE)
    words = shlex.split(command)
    assert words[words.index("--set") + 1] == "scene.speed=10"
    assert words[words.index("--days") + 1] == "0.1000625"
    with pytest.raises(SystemExit) as end:
        main([*words[1:], "--quiet"])
    assert end.value.code in (None, 0)


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (("williamson1", "--error", "1e-3"), "williamson1: it has no gravity waves"),
        (("lake-at-rest", "--error", "1e-3", "--ne", "2"), "lake-at-rest: it begins at rest"),
        (("williamson5", "--error", "0"), "error: must be greater than 0, not 0.0"),
        (("williamson5", "--error", "nan"), "error: must be a finite number"),
        (("williamson5", "--error", "2"), "error: must be less than 1"),
        (("williamson5", "--error", "1e-14", "--ne", "2", "--days", "1"), "error: no step of any"),
        (("williamson55", "--error", "1e-3"), "unknown scene 'williamson55'; did you mean"),
        (("williamson5",), "error: say how large the slow-flow error may be (--error 1e-3)"),
    ],
)
def test_what_cannot_be_advised_on_is_one_line(arguments, line, capsys) -> None:
    assert advise(*arguments) == 2
    err = capsys.readouterr().err
    assert line in err and err.count("\n") == 1
