"""Modelled times: exact counts of work, and prices that a noisy clock hardly moves."""

import math

import numpy as np
import pytest

from swe_sphere.equations.model import Model
from swe_sphere.mesh import Mesh
from swe_sphere.operators.work import Work, difference
from swe_sphere.solvers.vector_space import VectorSpace
from swe_sphere.steppers import get_stepper
from swe_sphere.studies.costs import Stopwatch, lowest, modelled_seconds
from swe_sphere.testcases import get_scene

# counts


def work_of(name, steps, dt=600.0, records=False):
    """The stepper after so many steps, and what these steps have done."""
    model = Model(Mesh.build(2, 4), get_scene("williamson5"))
    model.launch.records = records
    stepper = get_stepper(name)(model, dt)
    stepper.start(model.initial_state())
    before = model.launch.work.counts()
    right_hand_sides = model.counters["rhs_evaluations"]
    for _ in range(steps):
        stepper.step()
    done = difference(model.launch.work.counts(), before)
    return stepper, done, model.counters["rhs_evaluations"] - right_hand_sides


def calls(done, part):
    return sum(number for name, (number, _) in done.items() if part in name)


def test_every_launch_of_rk4_is_counted():
    _, done, right_hand_sides = work_of("rk4", 5)
    assert right_hand_sides == 20
    assert calls(done, "tendency_kernel") == 20
    assert calls(done, "pointwise_kernel") == 40  # runs of nodes, and those left over
    assert calls(done, "mix") == 5  # levels before the last stage
    assert sum(number for number, _ in done.values()) == 65


def test_counts_are_the_same_each_time_and_in_proportion_to_the_steps():
    assert work_of("tr-bdf2", 3)[1] == work_of("tr-bdf2", 3)[1]
    short, long = work_of("rk4", 2)[1], work_of("rk4", 6)[1]
    assert {name: (3 * a, 3 * b) for name, (a, b) in short.items()} == long


def test_a_recorded_step_is_one_kind_of_work_whatever_its_length():
    """Those before it is recorded count as such too; recording costs by its launches."""
    done = work_of("rk4", 7, records=True)[1]
    assert done.pop("recording") == (1, 13)
    ((kind, count),) = done.items()
    assert kind.startswith("recorded") and count == (7, 0)
    assert work_of("rk4", 3, dt=300.0, records=True)[1] == {kind: (3, 0), "recording": (1, 13)}
    assert kind not in work_of("kg5", 7, records=True)[1]


def test_recorded_products_and_preconditioning_stand_for_their_launches():
    """What was done once with two arrays is counted launch by launch still."""
    apart = work_of("tr-bdf2", 6, dt=3600.0)[1]
    merged = work_of("tr-bdf2", 6, dt=3600.0, records=True)[1]
    pieces = [number for kind, (number, _) in merged.items() if kind.startswith("recorded")]
    for kernels in (["prolong"], ["tendency_kernel", "prolong"]):
        together, left = (sum(calls(done, each) for each in kernels) for done in (apart, merged))
        gone = together - left
        assert gone > 0 and gone in (*pieces, sum(pieces))
    assert merged["recording"][0] <= sum(pieces)
    others = {kind for kind in merged if "kernel" not in kind and not kind.startswith("record")}
    assert {kind: merged[kind] for kind in others} == {kind: apart[kind] for kind in others}


def test_products_solves_and_vector_operations_of_an_implicit_step_are_counted():
    stepper, done, right_hand_sides = work_of("tr-bdf2", 3, dt=3600.0)
    costs = stepper.costs()
    assert calls(done, "prolong") >= costs["preconditioner_applications"] > 0
    assert calls(done, "preconditioner set-up") == costs["setups"] == 1
    products = stepper.model.counters["tangent_evaluations"]
    assert calls(done, "tendency_kernel") == right_hand_sides + products
    assert calls(done, "project") >= costs["krylov_iterations"]
    (rows,) = {rows for name, (_, rows) in done.items() if name.startswith("project")}
    assert rows > calls(done, "project")


def test_a_space_counts_what_it_does():
    work = Work()
    space = VectorSpace(np.ones(8), work=work)
    x, y, stack = space.zeros(), space.zeros(), space.stack(3)
    space.axpy(2.0, x, y)
    space.norm(x)
    space.project(stack, 2, x)
    space.combine(x, stack, [1.0, 2.0, 3.0], y)
    assert work.counts() == {
        "axpby float64 8": (1, 0), "dots float64 8": (1, 1), "project float64 8": (1, 2),
        "combine_rows float64 8": (1, 3),
    }  # fmt: skip


def test_what_a_section_does_inside_counts_as_the_section():
    work = Work()
    inner = work.counted("inner", lambda: "done")
    outer = work.section("outer", lambda: [inner(), inner()])
    inner()
    assert outer() == ["done", "done"]
    assert work.counts() == {"inner": (1, 0), "outer": (1, 0)}


# prices


COSTS = {"kernel": (100e-6, 0.0), "dot": (8e-6, 0.0), "project": (5e-6, 2e-6)}
"""Seconds (a call, a row)."""
BETWEEN = 3e-6


class Machine:
    """Work that takes fake time: up to a factor longer than it has to, in long spells."""

    def __init__(self, seed, scatter):
        self._rng, self._scatter = np.random.default_rng(seed), scatter
        self.time, self._slow, self._spell = 0.0, 1.0, 0
        self.work = Work()
        self._do = {name: self._counted(name) for name in COSTS}

    def _counted(self, name):
        call, row = COSTS[name]
        return self.work.counted(
            name, lambda rows: self.spend(call + row * rows), lambda rows: rows if row else 0
        )

    def spend(self, seconds):
        if self._spell == 0:
            self._slow = 1.0 + self._scatter * self._rng.uniform()
            self._spell = self._rng.integers(1, 80)
        self._spell -= 1
        self.time += seconds * self._slow

    def run(self, steps=40):
        """One run: its wall time [s], and the time it takes where nothing disturbs it."""
        began, right = self.time, 0.0
        for step in range(steps):
            for name, rows in [("kernel", 0), ("project", 1 + step % 9), ("kernel", 0), ("dot", 0)]:
                self.spend(BETWEEN)
                self._do[name](rows)
                right += BETWEEN + COSTS[name][0] + COSTS[name][1] * rows
        return self.time - began, right


def study(seed, scatter=0.3, runs=30):
    """Wall times of runs on a noisy machine, and their modelled and their true time."""
    machine = Machine(seed, scatter)
    watch = Stopwatch(clock=lambda: machine.time)
    machine.work.timer = watch
    walls = []
    for _ in range(runs):
        before = machine.work.counts()
        watch.begin()
        wall, right = machine.run()
        walls.append(wall)
    done = difference(machine.work.counts(), before)
    return walls, modelled_seconds(done, watch.prices()), right


def test_modelled_times_repeat_to_three_percent_where_wall_times_scatter():
    studies = [study(seed) for seed in range(8)]
    modelled = [seconds for _, seconds, _ in studies]
    walls = [walls[0] for walls, _, _ in studies]
    assert np.ptp(modelled) < 0.03 * np.median(modelled)
    assert np.ptp(walls) > 0.06 * np.median(walls)
    for _, seconds, right in studies:
        assert seconds == pytest.approx(right, rel=0.03)


def test_what_goes_on_between_runs_is_not_timed():
    machine = Machine(1, 0.0)
    watch = Stopwatch(clock=lambda: machine.time)
    machine.work.timer = watch
    set_up = machine.work.section("set-up", lambda: machine.spend(0.5))
    for _ in range(3):
        machine.time += 1000.0
        watch.begin()
        set_up()
        machine.run()
    assert watch.prices()["set-up"] == pytest.approx((0.5, 0.0))


def test_rare_work_is_looked_at_wherever_it_comes():
    """Its shortest time is found although no stretch of calls that is looked at begins with it."""
    machine = Machine(1, 0.0)
    watch = Stopwatch(clock=lambda: machine.time)
    machine.work.timer = watch
    seconds = iter([2e-3, 1e-3, 3e-3])
    rare = machine.work.section("rare", lambda: machine.spend(next(seconds)))
    for _ in range(3):
        machine.run(25)
        rare()
    assert watch.prices()["rare"] == pytest.approx((1e-3, 0.0), abs=1e-9)


def test_without_noise_the_modelled_time_is_exact():
    _, seconds, right = study(1, scatter=0.0)
    assert seconds == pytest.approx(right, rel=1e-9)


def test_no_price_is_negative_where_long_calls_were_disturbed_more_than_short_ones():
    clock, work = [0.0], Work()
    watch = Stopwatch(clock=lambda: clock[0])

    def project(rows):
        clock[0] += {3: 2e-6, 4: 9e-6}[rows]

    project = work.counted("project", project, int)
    work.timer = watch
    for rows in (3, 4):
        project(rows)
    assert watch.prices()["project"] == pytest.approx((0.0, 2e-6 / 3))


def test_prices_of_several_times_are_the_lowest_of_each_kind():
    assert lowest([{"a": (2.0, 0.0), "b": (1.0, 0.5)}, {"a": (1.0, 0.5)}]) == {
        "a": (1.0, 0.5), "b": (1.0, 0.5)
    }  # fmt: skip
    assert lowest([]) == {}


def test_rare_work_without_a_price_costs_what_a_call_costs_on_average():
    prices = {"a": (1.0, 0.0), "b": (3.0, 0.0)}
    assert modelled_seconds({"a": (2, 0), "b": (2, 0), "c": (1, 0)}, prices) == pytest.approx(10.0)
    assert math.isnan(modelled_seconds({"c": (1, 0)}, prices))


def test_a_stopwatch_changes_no_result():
    model = Model(Mesh.build(2, 4), get_scene("williamson5"))
    ends = []
    for timer in (None, Stopwatch()):
        model.launch.work.timer = timer
        stepper = get_stepper("bdf2")(model, 1800.0)
        stepper.start(model.initial_state())
        for _ in range(4):
            stepper.step()
        ends.append(stepper.state.numpy().copy())
    assert any(name.startswith("recorded") for name in timer.prices())
    assert np.array_equal(*ends)
    assert min(map(sum, timer.prices().values())) > 0.0
