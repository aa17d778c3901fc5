"""What a report concludes from rows, on datasets small enough to check by eye."""

import math
from itertools import combinations

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from sweeps import make_sweep

from swe_sphere.errors import ConfigError
from swe_sphere.steppers import STEPPERS
from swe_sphere.studies.report.figures import CUSTOM, LOOKS, looks
from swe_sphere.studies.report.ranking import (
    Metric,
    candidates,
    cheapest,
    metrics,
    rankings,
    read_runs,
    smallest,
    targets,
    with_cost,
)

TOTAL = Metric("total", "h", "l2", 15.0)


def run(stepper, dt, cpu, error=None, **others):
    errors = {} if error is None else {("total", "h"): error}
    return {"stepper": stepper, "dt": dt, "cpu_seconds": cpu, "errors": errors} | others


def rows_of(*runs, **attributes):
    return read_runs(make_sweep(*runs, **attributes))


def numbers(rows):
    return rows.number.tolist()


RACE = (
    run("rk4", 300.0, 6.0, 1e-4),
    run("rk4", 600.0, 3.0, 2e-4),
    run("bdf2", 3600.0, 2.0, 8e-4),
    run("bdf2", 1800.0, 4.0, 5e-4),
    run("leapfrog", 200.0, 2.5, 4e-4),
    run("rk4", 900.0, 0.5, 1e-9, status="unstable", reason="blew up"),
    run("tr-bdf2", 20.0, 0.1, 1e-9, role="converged"),
    run("sdirk3", 600.0, 1.0),  # has no error
)


def test_only_completed_rows_with_an_error_are_compared_and_ranked_with_a_time():
    rows = rows_of(*RACE, run("esdirk4", 600.0, math.nan, 1e-5))
    assert numbers(candidates(rows, TOTAL)) == [1, 2, 3, 4, 5, 9]
    assert numbers(with_cost(rows, TOTAL)) == [1, 2, 3, 4, 5]


@pytest.mark.parametrize(
    ("target", "expected"), [(1e-3, 3), (4e-4, 5), (1.5e-4, 1), (1e-5, None), (math.nan, None)]
)
def test_the_cheapest_row_that_reaches_a_target(target, expected):
    found = cheapest(rows_of(*RACE), TOTAL, target)
    assert (None if found.empty else found.iloc[0].number) == expected


def test_the_smallest_error_and_its_absence():
    assert smallest(rows_of(*RACE), TOTAL).iloc[0].number == 1
    assert smallest(rows_of(), TOTAL).empty


def test_an_empty_dataset_concludes_nothing():
    rows = read_runs(make_sweep())
    assert rows.empty and with_cost(rows, TOTAL).empty
    assert metrics(rows) == targets([]) == []
    assert rankings(rows, metrics(rows), "here") == []


def test_a_dataset_that_is_not_of_a_sweep_is_refused():
    for name in ("stepper", "energy_drift", "cpu_seconds", "error"):
        with pytest.raises(ConfigError, match=f"it has no {name}$"):
            read_runs(make_sweep(RACE[0]).drop_vars(name))


def test_metrics_are_of_the_last_moment_that_has_an_error():
    dataset = make_sweep(RACE[0], days=(5.0, 15.0))
    assert [m.day for m in metrics(read_runs(dataset))] == [15.0]
    dataset["error"] = dataset.error.where(dataset.report_day < 10.0)
    assert [m.label for m in metrics(read_runs(dataset))] == ["l2(h), total error at day 5"]


# noise


@pytest.mark.parametrize(("spread", "known"), [(0.0, 0.03), (0.2, 0.2), (math.nan, 0.1)])
def test_how_far_a_time_is_known(spread, known):
    """To 3 %, or to what the shortest repeats differ by; timed once, to 10 %."""
    row = rows_of(run("rk4", 1.0, 2.0, spread=spread)).iloc[0]
    assert row.cost == 2.0
    assert (row.least, row.most) == pytest.approx((2.0 / (1.0 + known), 2.0 * (1.0 + known)))


@pytest.mark.parametrize(("spread", "apart"), [(0.03, True), (0.06, False)])
def test_rows_are_told_apart_if_their_times_do_not_overlap(spread, apart):
    each = [run("rk4", 1.0, 2.0, 1e-4), run("bdf2", 1.0, 2.2, 1e-4)]
    for runs in (each, each[::-1]):
        (found,) = ranked(*(of | {"spread": spread} for of in runs), levels=[1e-3])
        assert (len(found.winners(0)) == 1) == apart


def test_columns_are_multiples_of_either_limit_and_counts_per_step():
    limits = {"gravity_limit": 300.0, "advective_limit": 1200.0}
    counts = {"steps": 10, "newton_iterations": 20, "krylov_iterations": 60}
    row = rows_of(run("bdf2", 600.0, 1.0) | limits | counts).iloc[0]
    assert (row.gravity_multiple, row.advective_multiple) == (2.0, 0.5)
    assert (row.newton_a_step, row.krylov_a_step) == (2.0, 6.0)


def test_runs_on_a_gpu_are_ranked_by_wall_time():
    row = rows_of(run("rk4", 1.0, 2.0, device="cuda:0", wall_seconds=5.0)).iloc[0]
    assert (row.cost, row.clock) == (5.0, "wall time")


def test_runs_that_were_not_timed_have_errors_and_no_rank():
    """A line has the longest step for each target; timed runs go first."""
    untimed = [each | {"cpu_seconds": math.nan} for each in RACE]
    (found,) = ranked(*untimed, levels=[1e-3])
    assert found.headline.startswith("Errors only on here")
    assert found.body[0][:2] == ["bdf2", "3600 s, 8.0e-4"] and "★" not in str(found.body)
    (found,) = ranked(*untimed[::-1], levels=[1e-3])
    assert "3600 s, 8.0e-4" in {line[0]: line[1] for line in found.body}["bdf2"]
    (found,) = ranked(*untimed[:3], *RACE[3:], levels=[1e-3])
    assert {line[0]: line[1] for line in found.body}["bdf2"] == "1800 s, 4.0 s, 5.0e-4"


# targets and the table


@pytest.mark.parametrize(
    ("errors", "expected"),
    [
        ({"rk4": 2e-4, "bdf2": 5e-4}, [1e-3, 3e-4]),
        ({"rk4": 2e-5, "bdf2": 5e-4}, [1e-3, 3e-4, 1e-4, 3e-5]),
        ({"rk4": 2e-3, "bdf2": 5e-2}, [1e-1, 3e-2, 1e-2, 3e-3]),
        ({"rk4": 2e-5, "bdf2": 5e-2}, [1e-1, 1e-2, 1e-3, 1e-4]),
        ({"rk4": 2e-12, "bdf2": 5e-2}, [1e-1, 1e-2, 1e-3, 1e-4, 1e-5]),
        ({"rk4": 1e-3}, [1e-3]),
        ({"rk4": 9e-4}, [1e-3]),
        ({"rk4": 0.0}, []),
    ],
)
def test_targets_go_from_what_all_reach_to_what_one_does(errors, expected):
    assert targets(errors.values()) == expected


def test_errors_below_what_is_resolved_are_no_targets():
    assert targets([1e-8, 5e-4], 2e-5) == [1e-3, 3e-4, 1e-4, 3e-5]


def ranked(*runs, levels=(), **attributes):
    rows = rows_of(*runs, **attributes)
    return rankings(rows, metrics(rows), "here", levels=levels)


def test_a_target_that_is_not_resolved_is_kept_and_nobody_reaches_it():
    runs = [run(n, 1.0, 1.0) | {"errors": {("time", "h"): 0.0}} for n in ("rk4", "bdf2")]
    reference = run("rk4", 1.0, 1.0, role="converged") | {"errors": {("time", "h"): 2e-11}}
    (found,) = ranked(*runs, reference, levels=[1e-3, 1e-13])
    assert found.targets == [1e-3, 1e-13]
    assert len(found.winners(0)) == 2 and found.winners(1).empty
    assert found.note == (
        "An error of 1e-13 cannot be measured: the reference run has an error of 2.0e-11 itself."
    )


def test_the_table_has_step_cost_and_error_of_the_cheapest_and_marks_the_best():
    (found,) = ranked(*RACE, levels=[1e-3, 2e-4])
    assert found.heads == ["stepper", "≤ 1e-3", "≤ 2e-4", "smallest error"]
    assert found.body == [
        ["bdf2", "★ 3600 s, 2.0 s, 8.0e-4", "–", "1800 s, 4.0 s, 5.0e-4"],
        ["leapfrog", "200 s, 2.5 s, 4.0e-4", "–", "200 s, 2.5 s, 4.0e-4"],
        ["rk4", "600 s, 3.0 s, 2.0e-4", "★ 600 s, 3.0 s, 2.0e-4", "300 s, 6.0 s, 1.0e-4"],
    ]
    assert found.headline == (
        "Cheapest to l2(h) ≤ 1e-3 (total error, day 15) on here: bdf2, Δt 3600 s, 2.0 s of CPU "
        "time (row 3); next is leapfrog at 1.2× that."
    )


def test_ties_are_marked_as_ties():
    (found,) = ranked(*(each | {"spread": 0.15} for each in RACE), levels=[1e-3])
    assert [line[1][:1] for line in found.body] == ["≈", "≈", "6"]
    assert "bdf2 and leapfrog tie; bdf2: Δt 3600 s, 2.0 s" in found.headline
    assert found.headline.endswith("next is rk4 at 1.5× that.")


def test_a_target_that_only_one_reaches_makes_the_headline_where_there_is_no_other():
    (found,) = ranked(*RACE, levels=[2e-4])
    assert found.headline.endswith("rk4, Δt 600 s, 3.0 s of CPU time (row 2).")
    (found,) = ranked(*RACE, levels=[1e-6])
    assert found.headline == "No run on here reaches an error of 1e-6: the smallest is 1.0e-4."


def test_variants_of_a_stepper_are_lines_of_their_own():
    (found,) = ranked(
        run("bdf2", 1.0, 1.0, 1e-3, preconditioner="helmholtz"),
        run("bdf2", 1.0, 2.0, 1e-3, preconditioner="none"),
    )
    assert [line[0] for line in found.body] == ["bdf2, helmholtz", "bdf2, no preconditioner"]


def test_the_slow_flow_ranks_where_its_error_is_known():
    errors = {("slow", "vorticity"): 1e-3, ("total", "h"): 1e-3, ("time", "h"): 1e-3}
    found = ranked(run("rk4", 600.0, 1.0) | {"errors": errors})
    assert [each.metric.kind for each in found] == ["slow", "total", "time"]


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
    ours = {n for n, kind in STEPPERS.items() if kind.__module__.startswith("swe_sphere.")}
    found = looks(ours)
    shapes = [(look["fillstyle"], look["marker"]) for _, look in found.values()]
    assert found.keys() == ours and len({*shapes}) == len(shapes)
    assert {name: family for name, (family, _) in found.items()} == {
        name: STEPPERS[name].family for name in ours
    }
    assert {*shapes}.isdisjoint((look["fillstyle"], look["marker"]) for look in CUSTOM)
    for vision in VISIONS:
        seen = [lab(look["color"], np.array(vision)) for _, look in found.values()]
        seen += [lab(known[""]["color"], np.array(vision)) for known in LOOKS.values()]
        assert min(np.linalg.norm(a - b) for a, b in combinations(seen, 2)) > 12.0


def test_custom_steppers_have_the_hue_of_their_family_and_differ_by_markers(monkeypatch):
    mine = [f"mine{n}" for n in range(6)]
    monkeypatch.setitem(STEPPERS.data, mine[0], STEPPERS["ark2"])
    found = looks(["tr-bdf2", *mine, "rk4"])
    assert [*found] == ["rk4", mine[0], "tr-bdf2", *mine[1:]]
    assert [family for family, _ in found.values()][1:4] == ["imex", "implicit", "other"]
    shapes = {(look["fillstyle"], look["marker"]) for _, look in found.values()}
    assert len(shapes) == len(found)


def test_curves_are_named_by_what_tells_them_apart():
    rows = rows_of(
        run("bdf2", 2.0, 1.0, preconditioner="helmholtz"),
        run("bdf2", 1.0, 1.0, preconditioner="helmholtz"),
        run("bdf2", 3.0, 1.0, preconditioner=""),  # never began
        run("rk4", 1.0, 1.0, precision="float32"),
        run("rk4", 1.0, 1.0),
    )
    found = {label: sorted(curve["dt"]) for label, curve in rows.groupby("curve")}
    assert found == {"bdf2": [1.0, 2.0, 3.0], "rk4, float32": [1.0], "rk4, float64": [1.0]}
    assert len(rows.groupby(["stepper", "line"])) == 3
