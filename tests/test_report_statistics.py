"""What a report concludes from rows, on datasets small enough to check by eye."""

import math
from itertools import combinations

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from sweeps import make_sweep

from swe_sphere.errors import ConfigError
from swe_sphere.steppers import STEPPERS
from swe_sphere.studies.report.answer import answers, noise_sentence, saturation_sentence
from swe_sphere.studies.report.axes import spread
from swe_sphere.studies.report.loss import largest_step, threshold
from swe_sphere.studies.report.palette import curves, look
from swe_sphere.studies.report.rows import Metric, metrics, read_rows
from swe_sphere.studies.report.saturation import plateau
from swe_sphere.studies.report.statistics import (
    candidates,
    cheapest,
    error_levels,
    pareto,
    smallest,
    tiers,
    time_interval,
    told_apart,
)

TOTAL = Metric("total", "h", "l2", 15.0)


def run(stepper, dt, wall, error=None, **others):
    errors = {} if error is None else {("total", "h"): error}
    return {"stepper": stepper, "dt": dt, "wall_seconds": wall, "errors": errors} | others


def rows_of(*runs, **attributes):
    return read_rows(make_sweep(*runs, **attributes))


def numbers(rows):
    return [row.number for row in rows]


RACE = (
    run("rk4", 300.0, 6.0, 1e-4),
    run("rk4", 600.0, 3.0, 2e-4),
    run("bdf2", 3600.0, 2.0, 8e-4),
    run("bdf2", 1800.0, 4.0, 5e-4),
    run("leapfrog", 200.0, 2.5, 4e-4),
    run("rk4", 900.0, 0.5, 1e-9, status="unstable", reason="blew up"),
    run("tr-bdf2", 20.0, 0.1, 1e-9, role="converged"),
    run("sdirk3", 600.0, 1.0),  # has no error
    run("esdirk4", 600.0, math.nan, 1e-5),
)


def test_only_completed_rows_with_a_time_and_an_error_are_compared():
    assert numbers(candidates(rows_of(*RACE), TOTAL)) == [1, 2, 3, 4, 5]


def test_the_front_is_what_nothing_beats_in_both():
    assert numbers(pareto(rows_of(*RACE), TOTAL)) == [3, 5, 2, 1]


def test_a_row_that_costs_more_for_next_to_nothing_is_not_on_the_front():
    rows = rows_of(run("rk4", 600.0, 1.0, 1e-4), run("rk4", 300.0, 2.0, 0.995e-4))
    assert numbers(pareto(rows, TOTAL)) == [1]
    assert numbers(pareto(rows, TOTAL, gain=0.0)) == [1, 2]


def test_the_front_by_another_cost_is_another_one():
    rows = rows_of(
        run("rk4", 600.0, 1.0, 1e-3, cpu_seconds=8.0), run("bdf2", 600.0, 2.0, 2e-3, cpu_seconds=1)
    )
    assert numbers(pareto(rows, TOTAL)) == [1]
    assert numbers(pareto(rows, TOTAL, lambda row: row.equivalents)) == [2, 1]


def test_of_equal_rows_the_first_stays_on_the_front():
    rows = rows_of(run("rk4", 600.0, 1.0, 1e-3), run("bdf2", 600.0, 1.0, 1e-3))
    assert numbers(pareto(rows, TOTAL, gain=0.0)) == [1]


@pytest.mark.parametrize(
    ("level", "expected"),
    [(1e-3, [3, 5, 2]), (4e-4, [5, 2]), (1.5e-4, [1]), (1e-5, []), (math.nan, [])],
)
def test_the_cheapest_row_of_each_stepper_that_reaches_a_level(level, expected):
    assert numbers(cheapest(rows_of(*RACE), TOTAL, level)) == expected


def test_the_smallest_error_and_its_absence():
    assert smallest(rows_of(*RACE), TOTAL).number == 1
    assert smallest([], TOTAL) is None


def test_an_empty_dataset_concludes_nothing():
    rows = read_rows(make_sweep())
    assert rows == []
    assert metrics(rows) == pareto(rows, TOTAL) == tiers(rows) == error_levels(rows, TOTAL) == []
    assert threshold(rows, TOTAL) is None
    assert plateau(rows, TOTAL) is None
    assert answers(rows, TOTAL, "here", 0.1) == []


def test_a_dataset_that_is_not_of_a_sweep_is_refused():
    with pytest.raises(ConfigError, match="no stepper, dt"):
        read_rows(make_sweep(RACE[0]).drop_vars(["stepper", "dt"]))


def test_what_an_older_dataset_lacks_is_not_a_number():
    dataset = make_sweep(RACE[0]).drop_vars(["energy_drift", "reason", "wall", "error"])
    (row,) = read_rows(dataset)
    assert math.isnan(row.energy_drift)
    assert (row.reason, row.walls, row.errors) == ("", (), {})


def test_metrics_are_of_the_last_moment_that_has_an_error():
    dataset = make_sweep(RACE[0], days=(5.0, 15.0))
    assert [m.day for m in metrics(read_rows(dataset))] == [15.0]
    dataset["error"] = dataset.error.where(dataset.report_day < 10.0)
    assert [m.label for m in metrics(read_rows(dataset))] == ["l2(h), total error at day 5"]


# noise


@pytest.mark.parametrize(
    ("walls", "spread", "noise", "low", "high"),
    [
        ((1.9, 2.0, 2.3), 0.2, math.nan, 1.9, 2.3),  # the repeats say it
        ((1.9, 2.0, 2.3), 0.2, 0.2, 1.8, 2.3),  # the machine was noisier below
        ((2.0,), 0.1, math.nan, 1.9, 2.1),
        ((2.0,), 0.0, 0.4, 1.6, 2.4),
        ((2.0,), 0.0, math.nan, 1.9, 2.1),  # nothing known: as if it were 10 %
        ((2.0,), 0.0, 0.0, 2.0, 2.0),
    ],
)
def test_how_far_a_wall_time_is_known(walls, spread, noise, low, high):
    (row,) = rows_of(run("rk4", 1.0, 2.0, walls=walls, wall_spread=spread))
    assert time_interval(row, noise) == pytest.approx((low, high))


def test_rows_are_told_apart_if_their_times_do_not_overlap():
    a, b = rows_of(run("rk4", 1.0, 2.0), run("bdf2", 1.0, 2.2))
    assert told_apart(a, b, 0.05)
    assert told_apart(b, a, 0.05)
    assert not told_apart(a, b, 0.12)


def test_rows_too_close_to_the_fastest_share_its_tier():
    rows = rows_of(
        run("rk4", 1.0, 1.0), run("bdf2", 1.0, 1.08), run("ark2", 1.0, 1.16), run("kg5", 1.0, 9.0)
    )
    assert [numbers(tier) for tier in tiers(rows, 0.1)] == [[1, 2], [3], [4]]
    assert [numbers(tier) for tier in tiers(rows, 0.0)] == [[1], [2], [3], [4]]


# levels and sentences


@pytest.mark.parametrize(
    ("errors", "levels"),
    [
        ({"rk4": 2e-4, "bdf2": 5e-4}, [1e-3, 3e-4, 1e-4]),
        ({"rk4": 2e-4, "bdf2": 5e-2}, [1e-1, 1e-2, 1e-3, 1e-4]),
        ({"rk4": 2e-12, "bdf2": 5e-2}, [1e-1, 1e-2, 1e-3, 1e-4]),
        ({"rk4": 1e-3}, [1e-3, 3e-4]),
        ({"rk4": 0.0}, []),
    ],
)
def test_levels_go_from_what_all_reach_to_what_nobody_does(errors, levels):
    rows = rows_of(*(run(name, 1.0, 1.0, error) for name, error in errors.items()))
    assert error_levels(rows, TOTAL) == levels


def test_the_answer_names_the_fastest_the_next_and_the_rows():
    told = answers(rows_of(*RACE), TOTAL, "williamson5 at ne16 np4", 0.02, [1e-3])
    assert told[0].text == (
        "To reach l2(h) ≤ 1e-3 on williamson5 at ne16 np4: bdf2 at 3600 s, 2.0 s (row 3); "
        "next best leapfrog at 200 s, 2.5 s (row 5); then rk4 at 600 s, 3.0 s (row 2)."
    )
    assert told[0].steppers == 3


def test_the_answer_does_not_rank_what_the_noise_hides():
    (answer, _) = answers(rows_of(*RACE), TOTAL, "here", 0.36, [1e-3])
    assert "bdf2 at 3600 s, 2.0 s (row 3) and leapfrog at 200 s, 2.5 s (row 5)" in answer.text
    assert "too close to rank, as the wall times are uncertain by up to ±18 %" in answer.text
    assert "next best rk4" in answer.text


def test_the_answer_says_when_nobody_reaches_a_level():
    (answer,) = answers(rows_of(*RACE), TOTAL, "here", 0.02, [1e-6])
    assert "no stepper reaches it. The smallest error is 1.0e-4: rk4 at 300 s" in answer.text
    assert answer.steppers == 0


def test_levels_with_one_answer_share_a_sentence():
    told = answers(rows_of(run("rk4", 60.0, 1.0, 1e-7)), TOTAL, "here", 0.0, [1e-3, 1e-5])
    assert told[0].text.startswith("To reach l2(h) ≤ 1e-3 or 1e-5 on here: rk4")
    assert told[1].text.startswith("The smallest error of all is 1.0e-7")


def test_nothing_is_said_on_levels_that_are_not_resolved():
    told = answers(rows_of(*RACE), TOTAL, "here", 0.0, [1e-3, 1e-6], resolved=1e-5)
    assert [answer.text.split(" on ")[0] for answer in told[:1]] == ["To reach l2(h) ≤ 1e-3"]
    assert [answer.steppers for answer in told] == [3, 0]
    assert "smallest error of all" in told[1].text


@pytest.mark.parametrize(
    ("runs", "noise", "parts"),
    [
        ([], math.nan, ["No calibration run", "differ by more"]),
        ([run("rk4", 1.0, 1.0)], 0.05, ["timed once", "up to 2.0 %", "varied by 5.0 %"]),
        ([run("rk4", 1.0, 1.0, walls=(1.0, 2.0))], 0.5, ["up to 2 repeats", "too noisy"]),
        ([run("rk4", 1.0, 1.0, wall_spread=0.6)], 0.01, ["up to 60 %", "too noisy"]),
    ],
)
def test_the_report_says_how_noisy_the_machine_was(runs, noise, parts):
    text = noise_sentence(rows_of(*runs), noise)
    assert all(part in text for part in parts), text
    assert ("too noisy" in text) == ("too noisy" in parts)


# saturation

LONG = (1800.0, 3600.0, 7200.0, 14400.0)
FLAT = [run(name, dt, 1.0, e) for name in ("bdf2", "tr-bdf2") for dt, e in
        zip(LONG, (7e-4, 9e-4, 8e-4, 8.5e-4), strict=True)]  # fmt: skip


def test_an_error_that_long_steps_do_not_change_saturates():
    found = plateau(rows_of(*FLAT, run("rk4", 600.0, 1.0, 1e-4)), TOTAL)
    assert (found.shortest.dt, found.longest.dt, found.everywhere) == (1800.0, 14400.0, False)
    text = saturation_sentence(
        rows_of(*FLAT, run("rk4", 600.0, 1.0, 1e-4)), TOTAL, "here", slow=True
    )
    assert "between 7.0e-4 (row 1) and 9.0e-4 (row 2), while rk4 at 600 s" in text
    assert "slow-flow error" in text


def test_one_bad_stepper_does_not_hide_a_plateau():
    bad = [run("implicit-euler", dt, 1.0, dt * 1e-6) for dt in LONG]
    assert plateau(rows_of(*FLAT, *bad, run("rk4", 600.0, 1.0, 1e-4)), TOTAL) is not None


def test_a_plateau_that_short_steps_share_is_the_error_of_the_mesh():
    rows = rows_of(*FLAT, run("rk4", 600.0, 1.0, 6e-4))
    assert plateau(rows, TOTAL).everywhere
    assert "the error of the mesh" in saturation_sentence(rows, TOTAL, "here", slow=False)


@pytest.mark.parametrize(
    "runs",
    [
        FLAT,  # no short step to compare with
        [run("bdf2", dt, 1.0, dt**2 * 1e-9) for dt in (600.0, *LONG)],  # grows
        [run("bdf2", 1800.0, 1.0, 1e-3), run("rk4", 600.0, 1.0, 1e-4)],  # one long step
    ],
)
def test_there_is_no_plateau(runs):
    assert plateau(rows_of(*runs), TOTAL) is None
    assert saturation_sentence(rows_of(*runs), TOTAL, "here", slow=True) == ""


# without loss of accuracy


def test_nothing_is_lost_up_to_the_error_of_leapfrog_at_its_largest_step():
    limit = threshold(rows_of(*RACE, run("leapfrog", 100.0, 5.0, 3e-4)), TOTAL)
    assert (limit.value, limit.best.number, limit.baseline.dt) == (4e-4, 1, 200.0)


def test_nothing_is_lost_within_a_tenth_of_the_smallest_error():
    limit = threshold(rows_of(*RACE), TOTAL, baseline="ssprk3")
    assert (limit.value, limit.baseline) == (pytest.approx(1.1e-4), None)


def test_nothing_is_lost_within_the_error_of_the_mesh():
    """A lucky step that is better than the run converged in time does not spoil the others."""
    exact = [run("rk4", dt, 9.0, e, role="converged") for dt, e in ((10.0, 6e-4), (20.0, 9e-4))]
    limit = threshold(rows_of(*RACE[:5], *exact), TOTAL)
    assert (limit.value, limit.converged.dt) == (pytest.approx(6.6e-4), 10.0)


STEPS = (
    run("bdf2", 600.0, 9.0, 1e-4),
    run("bdf2", 1200.0, 5.0, 2e-4),
    run("bdf2", 2400.0, 3.0, 9e-4),
    run("bdf2", 4800.0, 2.0, 1e-4),  # by luck
)


@pytest.mark.parametrize(
    ("limit", "dt"), [(1e-3, 4800.0), (3e-4, 1200.0), (1e-4, 600.0), (1e-5, None)]
)
def test_the_largest_step_comes_before_the_first_that_loses(limit, dt):
    found = largest_step(rows_of(*STEPS), TOTAL, limit)
    assert (found and found.dt) == dt


@pytest.mark.parametrize(
    ("status", "dt"),
    [("unstable", 1200.0), ("solver-failed", 1200.0), ("timed-out", 4800.0), ("refused", 4800.0)],
)
def test_a_step_that_fails_ends_the_search_one_cut_short_does_not(status, dt):
    failed = run("bdf2", 1500.0, 1.0, status=status)
    assert largest_step(rows_of(*STEPS, failed), TOTAL, 1e-3).dt == dt


# curves


VISIONS = (
    np.eye(3),
    [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216],
     [-0.003882, -0.048116, 1.051998]],
    [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413],
     [-0.011820, 0.042940, 0.968881]],
)  # fmt: skip
"""Ordinary vision, protanopia and deuteranopia, of linear RGB (Machado et al. 2009)."""


def lab(colour: str, vision) -> np.ndarray:
    """CIE L*a*b* of a colour as it is seen."""
    rgb = np.array(to_rgb(colour))
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    to_xyz = [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
    xyz = to_xyz @ np.clip(vision @ linear, 0.0, 1.0) / [0.9505, 1.0, 1.089]
    x, y, z = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16.0 / 116.0)
    return np.array([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)])


def test_every_stepper_has_a_colour_and_a_marker_of_its_own():
    looks = [look(name) for name in STEPPERS]
    assert len({found.marker for found in looks}) == len(looks)
    for vision in VISIONS:
        seen = [lab(found.colour, np.array(vision)) for found in looks]
        assert min(np.linalg.norm(a - b) for a, b in combinations(seen, 2)) > 12.0
    assert look("mine") == look("mine")


def test_curves_are_named_by_what_tells_them_apart():
    rows = rows_of(
        run("bdf2", 2.0, 1.0, preconditioner="helmholtz"),
        run("bdf2", 1.0, 1.0, preconditioner="helmholtz"),
        run("bdf2", 3.0, 1.0, preconditioner=""),  # never began
        run("rk4", 1.0, 1.0, precision="float32"),
        run("rk4", 1.0, 1.0),
    )
    found = {curve.label: [row.dt for row in curve.rows] for curve in curves(rows)}
    assert found == {"bdf2": [1.0, 2.0, 3.0], "rk4, float32": [1.0], "rk4, float64": [1.0]}
    assert len({(curve.look, curve.line) for curve in curves(rows)}) == 3


@pytest.mark.parametrize("heights", [[], [0.5], [0.5, 0.5, 0.5], [0.0, 0.99, 1.0, 1.0], [-3, 7]])
def test_names_in_the_margin_do_not_overlap(heights):
    moved = spread(heights, 0.1)
    assert np.all(np.diff(moved) >= 0.1 - 1e-12)
    assert all(-1e-12 <= height <= 1.0 for height in moved)


def test_names_that_have_room_stay():
    assert spread([0.2, 0.5, 0.9], 0.1) == [0.2, 0.5, 0.9]
