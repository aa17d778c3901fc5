"""Steps on a device: recorded and launched as a whole, those launched one by one; none reads it."""

from dataclasses import replace

import numpy as np
import pytest
import warp as wp

from swe_sphere import Simulation
from swe_sphere.equations.effects import Forcing, Hyperviscosity, Tracers
from swe_sphere.equations.model import Model
from swe_sphere.errors import ConfigError, Unstable
from swe_sphere.kernels import specialise
from swe_sphere.kernels.vectors import axpby
from swe_sphere.operators.launch import Launcher
from swe_sphere.operators.replay import Replay, between
from swe_sphere.simulation.observers import HealthCheck
from swe_sphere.solvers import vector_space
from swe_sphere.steppers import get_stepper
from swe_sphere.steppers.stepper import STEPPERS
from swe_sphere.testcases import get_scene

STEPS = 12
REPEATED = [name for name, cls in STEPPERS.items() if cls.repeats_from is not None]
SPLIT = ("rk4", "leapfrog", "forward-backward", "fb-rk3")


@pytest.fixture(scope="module")
def plain(small_mesh):
    return Model(small_mesh, get_scene("williamson5"))


@pytest.fixture(scope="module")
def diffusive(small_mesh):
    """With diffusion on its own, and tracers with a limiter that acts after every step."""
    scene = get_scene("williamson5").with_effect(Hyperviscosity(1e16))
    effects, bells = (*scene.effects, Tracers(limiter=True)), get_scene("deformational").tracers
    return Model(small_mesh, replace(scene, effects=effects, tracers=bells))


def stepped(model, name, recorded, look=lambda: None):
    """State and right-hand sides after some steps, each of which `look` follows."""
    stepper = get_stepper(name)(model, 200.0)
    model.launch.records = recorded
    stepper.start(model.initial_state())
    evaluations = model.counters["rhs_evaluations"]
    for _ in range(STEPS):
        stepper.step()
        look()
    model.launch.records = True
    return stepper.state.numpy(), model.counters["rhs_evaluations"] - evaluations


def graphs(monkeypatch):
    """The graphs that are launched from now on."""
    launched, launch = [], wp.capture_launch
    monkeypatch.setattr(wp, "capture_launch", lambda graph: (launched.append(graph), launch(graph)))
    return launched


@pytest.mark.parametrize("name", REPEATED)
def test_recorded_steps_are_the_same_bit_by_bit(plain, name, monkeypatch):
    """With the same count of right-hand sides; a recorded step is one graph or more."""
    launched = graphs(monkeypatch)
    state, evaluations = stepped(plain, name, True)
    whole = len(launched)
    expected, others = stepped(plain, name, False)
    apart = len(launched) - whole  # sums over chunks
    assert whole >= apart + STEPS - 4
    np.testing.assert_array_equal(state, expected)
    assert evaluations == others


def test_what_is_no_launch_is_done_between_pieces_of_a_recording(plain):
    """Each time it is launched, and not while it is recorded."""
    x, seen = wp.zeros(1, dtype=wp.float64, device="cpu"), []
    replay, one = Replay(plain.launch), [wp.float64(1.0), wp.ones_like(x), wp.float64(1.0), x, x]

    def twice_with_a_look():
        plain.launch(specialise(axpby, wp.float64), 1, *one)
        between("cpu", lambda: seen.append(float(x.numpy()[0])))
        plain.launch(specialise(axpby, wp.float64), 1, *one)

    for _ in range(4):
        replay("key", twice_with_a_look)
    assert seen == [1.0, 3.0, 5.0, 7.0] and x.numpy()[0] == 8.0


@pytest.mark.parametrize("name", SPLIT)
def test_diffusion_and_limiter_are_recorded_too(diffusive, name, monkeypatch):
    """So that late steps launch no kernel by itself."""
    apart, launch = [], Launcher.__call__

    def counting(*given, **cuts):
        apart.append(1)
        launch(*given, **cuts)

    monkeypatch.setattr(Launcher, "__call__", counting)
    counted = []
    state, evaluations = stepped(diffusive, name, True, lambda: counted.append(len(apart)))
    assert counted[0] and counted[-1] == counted[-2] == counted[-3]
    expected, others = stepped(diffusive, name, False)
    np.testing.assert_array_equal(state, expected)
    assert evaluations == others


@pytest.mark.parametrize("name", [*REPEATED, "epi3", "bdf2"])
def test_no_step_reads_a_state_on_the_host(plain, name, monkeypatch):
    """With the vectors of GPUs; but for the set-up of a preconditioner, which is the host's."""
    monkeypatch.setattr(vector_space, "HostSpace", vector_space.DeviceSpace)
    stepper = get_stepper(name)(plain, 200.0)
    stepper.start(plain.initial_state())
    stepper.step()
    read, numpy = [], wp.array.numpy
    monkeypatch.setattr(wp.array, "numpy", lambda array: (read.append(array.size), numpy(array))[1])
    for _ in range(3):
        stepper.step()
    assert [size for size in read if size >= plain.mesh.size] == []
    stepper.state.numpy()
    assert read[-1] == plain.size


def test_looking_at_the_health_reads_no_state(monkeypatch):
    monkeypatch.setattr(vector_space, "HostSpace", vector_space.DeviceSpace)
    sim = Simulation("williamson5", ne=2, np=4, dt=900.0)
    sim.begin()
    check, numpy = HealthCheck(sim), wp.array.numpy
    monkeypatch.setattr(wp.array, "numpy", lambda array: pytest.fail("read"))
    check.observe(sim.snapshot)
    monkeypatch.setattr(wp.array, "numpy", numpy)
    state = sim.stepper.state.numpy()
    for values, complaint in ((np.nan, "is NaN"), (-1.0, "is not positive"), (1e6, "has grown")):
        sim.stepper.state.assign(np.where(np.arange(state.size) == state.size - 1, values, state))
        with pytest.raises(Unstable, match=complaint):
            check.observe(sim.snapshot)


def test_what_changes_in_time_is_not_recorded(small_mesh):
    scene = get_scene("williamson4")
    assert scene.effect(Forcing.name) and not scene.autonomous


def test_a_class_with_steps_of_its_own_says_whether_they_repeat():
    class Own(get_stepper("rk4")):
        def advance(self):
            super().advance()

    assert Own.repeats_from is None


def test_a_replay_inside_a_recording_is_part_of_it(plain, monkeypatch):
    """Its launches are made, and counted, once for each call of the outer one."""
    x, counters = wp.zeros(1, dtype=wp.float64, device="cpu"), {"blocks": 0}
    launched, one = graphs(monkeypatch), [wp.float64(1.0), wp.ones_like(x), wp.float64(1.0), x, x]
    outer, inner = Replay(plain.launch, counters), Replay(plain.launch)

    def add_one():
        plain.launch(specialise(axpby, wp.float64), 1, *one)

    def block():
        counters["blocks"] += 1
        inner("key", add_one)

    for calls in range(1, 6):
        outer("key", block)
        assert x.numpy()[0] == counters["blocks"] == calls
    assert len(launched) == 4


class Hosted(get_stepper("rk4")):
    """Does work on the host in steps that it declares to repeat."""

    repeats_from = 0

    def advance(self):
        super().advance()
        self.state.assign(self.state.numpy() * 0.9)


class Timed(get_stepper("rk4")):
    """Launches with numbers that change from step to step."""

    repeats_from = 0

    def advance(self):
        super().advance()
        kernel = specialise(axpby, wp.float64)
        x = self.state
        self.model.launch(kernel, x.size, 1e-9 * self.steps, x, 1.0, x, x)


class Whole(get_stepper("rk4")):
    """Repeats, as it declares."""

    repeats_from = 0

    def advance(self):
        super().advance()


@pytest.mark.parametrize("kind", [Hosted, Timed])
def test_steps_that_do_not_repeat_as_declared_are_refused(plain, kind):
    stepper = kind(plain, 200.0)
    stepper.start(plain.initial_state())
    with pytest.raises(ConfigError, match=r"stepper rk4: a recorded step .*repeats_from"):
        for _ in range(STEPS):
            stepper.step()


def test_a_custom_stepper_that_repeats_is_recorded(plain, monkeypatch):
    launched = graphs(monkeypatch)
    found = []
    for kind in (Whole, get_stepper("rk4")):
        stepper = kind(plain, 200.0)
        stepper.start(plain.initial_state())
        before = plain.counters["rhs_evaluations"]
        for _ in range(STEPS):
            stepper.step()
        found.append((stepper.state.numpy(), plain.counters["rhs_evaluations"] - before))
    np.testing.assert_array_equal(found[0][0], found[1][0])
    assert launched and found[0][1] == found[1][1]


def test_why_a_recording_fails_is_told(plain, monkeypatch):
    """Also where it could not be taken up again behind something that is no launch."""
    begun, begin = [], wp.capture_begin

    def twice(*args, **settings):
        begun.append(begin(*args, **settings) if not begun else refuse())

    def refuse():
        raise RuntimeError("no room for a graph")

    replay = Replay(plain.launch)
    replay("key", lambda: between("cpu", lambda: None))
    monkeypatch.setattr(wp, "capture_begin", twice)
    with pytest.raises(RuntimeError, match="no room for a graph"):
        replay("key", lambda: between("cpu", lambda: None))
    monkeypatch.undo()
    seen = []
    between("cpu", lambda: seen.append("at once"))
    assert seen == ["at once"]
