"""Time to an error beside other models: the error, the tables, and models that are not there."""

import math
import os
import sys
from importlib.util import find_spec

import numpy as np
import peer_process
import pytest
import time_to_error
from peer_process import Measured, Peer, Setting, alias_free, surface_error

from swe_sphere.io.integrals import norms
from swe_sphere.io.reference_solution import SHIPPED, OnGrid, Reference
from swe_sphere.simulation.simulation import Simulation

HERE = sys.executable


def wave(lon, lat):
    """A surface [m] of degree 8, of which no two quarters of the sphere are the same."""
    ridge = np.sin(lat) * (np.cos(lat) * np.cos(lon - 0.4)) ** 7
    return 5500.0 + 300.0 * ridge - 90.0 * np.sin(lat)


def of_williamson5(sim: Simulation) -> float:
    """Relative l2 error of the surface at day 15."""
    on = OnGrid(Reference(SHIPPED / "williamson5_day15.nc"), sim.mesh)
    return on.errors(sim.snapshot.all_fields, "surface")["h"]["l2"]


@pytest.fixture
def core() -> set[int]:
    return {max(os.sched_getaffinity(0))}


def test_error_of_a_surface_on_a_gaussian_grid_is_that_at_the_references_points() -> None:
    of = Setting("williamson5", 15.0, "any", "T10", "any", 600.0)
    reference = Reference(SHIPPED / "williamson5_day15.nc")
    direct = norms(reference.area, wave(*reference.points), reference.values("surface"))["l2"]
    found = surface_error(of, wave(*alias_free(10).points))
    assert found == pytest.approx(direct, rel=1e-12) and direct > 1e-2


@pytest.mark.parametrize(("truncation", "latitudes"), [(42, 64), (63, 96), (85, 128), (106, 160)])
def test_grids_are_the_usual_ones_without_aliases(truncation: int, latitudes: int) -> None:
    assert alias_free(truncation).points[0].shape == (latitudes, 2 * latitudes)


def test_settings_fill_the_days_and_have_known_models() -> None:
    for scene in time_to_error.tables():
        for of in time_to_error.settings(scene):
            assert of.days * 86400.0 / of.steps <= of.dt
            assert (peer_process.HERE / f"with_{of.model.replace('-', '_')}.py").exists()
            reference = SHIPPED / f"{of.scene}_day{of.days:g}.nc"
            assert reference.exists() or scene == "all-cores"  # which compares times only


def test_tables_tell_the_least_and_the_median_and_who_is_first() -> None:
    of = Setting("williamson5", 15.0, "shtns", "T42", "rk4", 720.0)
    line = time_to_error.row(Measured(of, 9e-5, [3.0, 1.0, 1.5], [4.0, 2.0, 9.0]))
    assert line[:6] == ["shtns", "T42", "rk4", "720", "float64", "1800"]
    assert line[6:] == ["9.00e-05", "1", "1.5", "2", "3"]
    assert "blew up" in time_to_error.row(Measured(of, math.nan, [1.0], [1.0]))
    assert "no room" in time_to_error.row(Measured(of, failure="no room"))
    slow = time_to_error.row(Measured(of, 1e-5, [7.0], [7.0]))
    rows = [slow, line, time_to_error.row(Measured(of, math.nan, [0.1], [0.1]))]
    assert time_to_error.quickest(rows, 1e-4) == {"shtns": line}
    assert time_to_error.quickest(rows, 4e-5) == {"shtns": slow}
    assert time_to_error.quickest(rows, 1e-6) == {}


def test_models_that_are_not_there_are_left_out_with_a_word(tmp_path, core, capsys) -> None:
    pythons = {"shtns": str(tmp_path / "nowhere"), "": str(tmp_path / "nor-there")}
    peers, missing = time_to_error.start(["shtns", "dedalus"], pythons, core, tmp_path)
    assert not peers and missing == ["shtns", "dedalus"]
    assert "shtns is left out" in capsys.readouterr().err
    assert time_to_error.interpreter("swe-sphere", pythons) == sys.executable


@pytest.mark.skipif(find_spec("dedalus") is not None, reason="Dedalus is there")
def test_library_that_is_not_there_is_named(tmp_path, core) -> None:
    with pytest.raises(OSError, match="No module named 'dedalus'"):
        Peer("dedalus", HERE, core, tmp_path)


@pytest.mark.thorough
def test_this_model_runs_in_a_process_and_a_wrong_setting_does_not_end_it(tmp_path, core) -> None:
    fair = Measured(Setting("williamson5", 15.0, "swe-sphere", "ne2 np4", "rk4", 3600.0))
    wrong = Measured(Setting("williamson5", 15.0, "swe-sphere", "ne2 np4", "rk5", 3600.0))
    with Peer("swe-sphere", HERE, core, tmp_path) as peer:
        for measured in (wrong, fair, fair):
            peer.run(measured)
    assert "rk5" in wrong.failure and not wrong.cpu
    assert len(fair.cpu) == 2 and 0.0 < fair.cpu[0] < 60.0
    sim = Simulation("williamson5", ne=2, np=4, stepper="rk4", dt=3600.0)
    sim.run(days=15.0, progress=False)
    assert fair.error == pytest.approx(of_williamson5(sim), rel=1e-6)


@pytest.mark.skipif(find_spec("shtns") is None, reason="SHTns is not there")
def test_model_on_shtns_comes_near_the_reference_with_both_kinds_of_steps(tmp_path, core) -> None:
    kinds = ("rk4", 1800.0, 1.5e-3), ("semi-implicit", 1200.0, 2e-3)
    with Peer("shtns", HERE, core, tmp_path) as peer:
        for stepper, dt, bound in kinds:
            measured = Measured(Setting("williamson5", 15.0, "shtns", "T21", stepper, dt))
            peer.run(measured)
            assert measured.error < bound


def test_recommended_mesh_of_williamson5_reaches_its_error() -> None:
    sim = Simulation("williamson5")
    sim.run(days=15.0, progress=False)
    assert of_williamson5(sim) < 1e-4
