"""Diagnostics that return a profile: in every frame of files, with a coordinate of its own."""

import numpy as np
import pytest
import xarray as xr

from swe_sphere import Output, Simulation, diagnostic, open_run
from swe_sphere.planet import HOUR

SMALL = {"ne": 2, "np": 4, "dt": 1800.0, "every": 6.0}
LATITUDES = np.linspace(-90.0, 90.0, 19)


def simulation():
    return Simulation("williamson6", **SMALL)


@pytest.fixture
def zonal_wind():
    @diagnostic(units="m s-1", long_name="zonal mean of the eastward wind")
    def zonal_wind(sim):
        return sim.state.swe.zonal_mean(19).u


@pytest.mark.parametrize("ending", ["nc", "zarr"])
def test_a_profile_is_in_every_frame(zonal_wind, tmp_path, ending):
    out = tmp_path / f"run.{ending}"
    simulation().run(days=0.25, out=out)
    assert Simulation.from_checkpoint(out).run(days=0.5, out=out).completed
    run = open_run(out)
    assert run.zonal_wind.dims == ("time", "zonal_wind_lat")
    assert np.allclose(run.zonal_wind_lat, LATITUDES, rtol=0.0, atol=1e-12)
    about = {"standard_name": "latitude", "units": "degrees_north"}
    assert run.zonal_wind_lat.attrs == about
    assert (run.zonal_wind.attrs["units"], run.zonal_wind.attrs["long_name"]) == (
        "m s-1", "zonal mean of the eastward wind"
    )  # fmt: skip
    expected = run.swe.zonal_mean(19).u
    assert run.sizes["time"] == 3
    assert np.abs(run.zonal_wind.values - expected.values).max() < 1e-12 * np.abs(expected).max()
    with xr.open_dataset(out, engine="zarr" if ending == "zarr" else "netcdf4") as plain:
        assert plain.zonal_wind.sel(zonal_wind_lat=0.0).shape == (3,)


def test_a_profile_is_in_the_state_and_in_files_on_grids(zonal_wind, tmp_path):
    sim = simulation()
    assert sim.state.zonal_wind.dims == ("zonal_wind_lat",)
    wanted = [
        Output(tmp_path / "mean.nc", every=3, fields="zonal_wind"),
        Output(tmp_path / "grid.nc", every=3, grid="latlon:7x12"),
    ]
    sim.run(days=0.25, outputs=wanted)
    mean, grid = (open_run(each.path) for each in wanted)
    assert (mean.time / HOUR).values.tolist() == [0, 3, 6]
    assert np.array_equal(mean.zonal_wind, grid.zonal_wind)
    assert np.array_equal(mean.zonal_wind[-1], sim.state.zonal_wind)


def test_a_profile_without_a_coordinate_counts_its_values():
    @diagnostic
    def levels(sim):
        return xr.DataArray([1.0, 2.0, sim.time], dims="level")

    state = simulation().state
    assert (state.levels.dims, state.levels_level.values.tolist()) == (("levels_level",), [0, 1, 2])


@pytest.mark.parametrize("size", [2, 218])
def test_a_profile_that_changes_its_length_ends_the_run_in_one_line(tmp_path, size):
    @diagnostic
    def levels(sim):
        return xr.DataArray(np.zeros(3 if sim.time < 7200.0 else size), dims="level")

    summary = simulation().run(days=0.25, out=tmp_path / "run.nc")
    reason = "the diagnostic levels was a profile of 3 values at first and is none now"
    assert (summary.status, summary.reason) == ("failed", f"{reason}: return the same kind")


def test_plain_arrays_of_another_length_are_refused(tmp_path):
    @diagnostic
    def levels(sim):
        return np.zeros(3)

    summary = simulation().run(days=0.25, out=tmp_path / "run.nc")
    assert summary.status == "failed"
    assert summary.reason == (
        "the diagnostic levels returned an array of shape (3,): return one number, a field of 218"
        " values, one a node, or a profile, an xarray.DataArray with one dimension"
    )
