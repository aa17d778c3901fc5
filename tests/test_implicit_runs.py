"""Runs with implicit steppers: options, costs, automatic step, restart, failure."""

import json
import re
from dataclasses import replace

import netCDF4
import numpy as np
import pytest

from swe_sphere.errors import ConfigError, RunFailed
from swe_sphere.io.runfile import RunFile
from swe_sphere.mesh import Mesh
from swe_sphere.simulation.config import make_config
from swe_sphere.simulation.planning import automatic_step
from swe_sphere.simulation.simulation import Simulation, run_scene
from swe_sphere.steppers import RECOMMENDED, STEPPERS
from swe_sphere.testcases import get_scene

SMALL = {"ne": 2, "np": 4, "days": 1.0, "stepper": "tr-bdf2", "dt": 7200.0}


def small(**values):
    return run_scene(make_config({"scene": "williamson6", **SMALL, **values}))


def test_the_recommended_scheme_goes_by_two_names(tmp_path):
    summary = small(stepper="fully-implicit", out=tmp_path / "a.nc")
    assert (summary["stepper"], summary["scheme"]) == ("fully-implicit", RECOMMENDED)
    assert summary["energy"] == small(stepper=RECOMMENDED)["energy"]
    attributes = RunFile(tmp_path / "a.nc").attributes
    assert json.loads(attributes["identity"])["stepper"] == RECOMMENDED
    assert (attributes["stepper"], attributes["scheme"]) == ("fully-implicit", RECOMMENDED)
    assert json.loads(attributes["stepper_options"])["preconditioner"] == "helmholtz"


def test_costs_of_the_solver_are_told(tmp_path):
    numbers = json.loads(small(out=tmp_path / "a.nc").as_json())
    assert numbers["newton_iterations"] >= 2 * numbers["steps"] == 24
    assert numbers["krylov_iterations"] == numbers["tangent_evaluations"] > 24
    assert numbers["preconditioner_applications"] == numbers["krylov_iterations"]
    assert numbers["setups"] >= 1 and 0.0 < numbers["setup_seconds"] < numbers["wall_seconds"]
    assert numbers["rejected_steps"] == 0
    with netCDF4.Dataset(tmp_path / "a.nc") as file:
        assert json.loads(file.summary)["krylov_iterations"] == numbers["krylov_iterations"]


def test_options_reach_the_solver():
    plain, strict, bare = small(), small(tolerance=1e-6), small(preconditioner="none")
    assert strict["krylov_iterations"] > 1.3 * plain["krylov_iterations"]
    assert bare["krylov_iterations"] > 2 * plain["krylov_iterations"]
    assert (bare["setups"], bare["preconditioner"]) == (0, "none")
    by_setting = small(settings=["stepper.tolerance=1e-6"])
    assert by_setting["tolerance"] == strict["tolerance"] == 1e-6
    assert by_setting["krylov_iterations"] == strict["krylov_iterations"]


def test_a_semi_implicit_run_has_a_limit_and_options_of_its_own():
    explicit = small(stepper="leapfrog", dt="auto", ne=4)
    split = small(stepper="semi-implicit", dt="auto", ne=4, settings=["stepper.tolerance=1e-3"])
    assert split["stable_dt"] > 1.5 * explicit["stable_dt"]
    assert "of the stability limit" in split["dt_rule"]
    assert split["tolerance"] == 1e-3 and split["krylov_iterations"] > 0
    with pytest.raises(ConfigError, match=r"it has tolerance, strength, share$"):
        small(stepper="semi-implicit", preconditioner="none")


def test_factors_that_memory_cannot_hold_are_refused_before_any_file(tmp_path, monkeypatch):
    monkeypatch.setattr("swe_sphere.solvers.preconditioners.preconditioner.LARGEST_MEMORY", 1e5)
    with pytest.raises(ConfigError, match="helmholtz instead of helmholtz-direct"):
        small(preconditioner="helmholtz-direct", out=tmp_path / "a.nc")
    assert not any(tmp_path.iterdir())


def test_explicit_runs_tell_that_they_solve_nothing():
    summary = small(stepper="rk4", dt="auto", days=0.1)
    assert summary["scheme"] == "rk4" and "preconditioner" not in summary
    assert summary["krylov_iterations"] == summary["setups"] == summary["rejected_steps"] == 0


def test_an_automatic_step_follows_the_wind():
    def automatic(name, part):
        scene = replace(
            get_scene("williamson2"), initial=lambda lon, lat: (300.0 * part, -400.0 * part, 3e3),
            exact=None,
        )  # fmt: skip
        sim = Simulation(scene, ne=8, np=4, stepper=name)
        return automatic_step(sim, 10.0)[0] / sim.mesh.spacing()[0]

    for name, courant, longest in (("bdf2", 2.0, 3600.0), ("epi4", 0.25, 10800.0)):
        fast, slow, none = (automatic(name, part) for part in (1.0, 1e-3, 0.0))
        assert fast == pytest.approx(courant / 500.0)
        assert slow == none == longest / Mesh.build(8, 4).spacing()[0]
    summary = small(dt="auto")
    assert summary["stable_dt"] is None and summary["dt"] == 3600.0
    assert "Courant number 2" in summary["dt_rule"]


def test_a_restart_knows_the_scheme_by_both_names(tmp_path):
    small(stepper="fully-implicit", days=0.5, tolerance=0.01, out=tmp_path / "a.nc")
    config = {"scene": "williamson6", "restart": tmp_path / "a.nc", "stepper": RECOMMENDED}
    summary = run_scene(make_config(config | {"days": 1.0}))
    assert (summary.completed, summary["tolerance"]) == (True, 0.01)


def test_a_solve_that_fails_ends_the_run_and_keeps_its_frames(tmp_path, monkeypatch):
    """The third step fails, in however many parts it is taken."""
    attempt = STEPPERS["tr-bdf2"].solve_step

    def failing(self, t, dt, out):
        if t < 2 * 7200.0:
            return attempt(self, t, dt, out)
        out.fill_(np.nan)
        return self.solver.solve(dt, t, self.state, out)

    monkeypatch.setattr(STEPPERS["tr-bdf2"], "solve_step", failing)
    summary = small(out=tmp_path / "a.nc", every=2.0)
    assert (summary.completed, summary.exit_status) == (False, RunFailed.exit_status)
    assert re.search(r"tr-bdf2: the step from 14400 s cannot be solved .* --dt", summary.reason)
    assert "\n" not in summary.reason
    assert RunFile(tmp_path / "a.nc").times.tolist() == [0.0, 7200.0, 14400.0]
    assert summary["rejected_steps"] >= 6


@pytest.mark.parametrize(
    ("before", "after"), [("helmholtz", "jacobian-direct"), ("jacobian-direct", "helmholtz")]
)
def test_a_restart_may_choose_another_preconditioner(tmp_path, before, after):
    given = {"ne": 2, "np": 4, "stepper": "tr-bdf2", "dt": 3600.0}
    Simulation("williamson6", preconditioner=before, **given).run(days=0.25, out=tmp_path / "a.nc")
    sim = Simulation.from_checkpoint(tmp_path / "a.nc", preconditioner=after)
    assert sim.run(days=0.5).status == "completed"
    whole = Simulation("williamson6", preconditioner=after, **given)
    whole.run(days=0.5)
    np.testing.assert_allclose(sim.state.h, whole.state.h, rtol=3e-4)


def test_a_step_that_fails_in_its_second_half_leaves_the_memory_of_bdf2(monkeypatch):
    sim = Simulation("williamson6", ne=2, np=4, stepper="bdf2", dt=3600.0, days=1.0)
    sim.begin()
    sim.step()
    sim.step()
    kept, attempt = sim.stepper.state_dict(), type(sim.stepper).attempt

    def failing(stepper, t, dt):
        early = t + dt < 2.75 * 3600.0 and dt < 3600.0
        return attempt(stepper, t, dt) if early else "made to fail"

    monkeypatch.setattr(type(sim.stepper), "attempt", failing)
    with pytest.raises(RunFailed, match="made to fail"):
        sim.step()
    found = sim.stepper.state_dict()
    assert found.keys() == kept.keys()
    for name, value in kept.items():
        np.testing.assert_array_equal(found[name], value, err_msg=name)


@pytest.mark.thorough
@pytest.mark.parametrize(("stepper", "dt", "worst"), [("sdirk3", 60.0, 0.4), ("rk4", 60.0, 0.1)])
def test_short_steps_in_float32_accumulate_few_rounding_errors(stepper, dt, worst):
    """The bounds [m] are those of docs/explanation/time_integration.md with a margin."""
    given = {"ne": 4, "np": 4, "days": 2.0, "dt": dt}
    exact = Simulation("williamson5", stepper="rk4", **given)
    rounded = Simulation("williamson5", stepper=stepper, precision="float32", **given)
    exact.run()
    rounded.run()
    assert np.abs(exact.state.h - rounded.state.h).max() < worst
