"""Diagnostics that return a profile: in every frame of files, with its coordinate."""

import numpy as np
import pytest
import xarray as xr

from swe_sphere import Output, Simulation, diagnostic, open_run
from swe_sphere.analysis.regrid import regrid_file
from swe_sphere.errors import ConfigError
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


def test_a_profile_is_no_zonal_mean():
    @diagnostic
    def levels(sim):
        return xr.DataArray(np.arange(3.0), dims="level")

    means = simulation().to_xarray().swe.zonal_mean(19)
    assert means.u.attrs["cell_methods"] == "longitude: mean"
    assert means["levels"].ndim == 2 and "cell_methods" not in means["levels"].attrs


def test_a_profile_without_a_coordinate_counts_its_values():
    @diagnostic
    def levels(sim):
        return xr.DataArray([1.0, 2.0, sim.time], dims="level")

    state = simulation().state
    assert (state.levels.dims, state.levels_level.values.tolist()) == (("levels_level",), [0, 1, 2])


CHANGED = "has changed its kind, size or coordinate since its first value"


@pytest.mark.parametrize(
    "later",
    [
        xr.DataArray(np.zeros(2), dims="level"),
        xr.DataArray(np.zeros(3), dims="height"),
        xr.DataArray(np.zeros(3), {"level": [1.0, 2.0, 3.0]}, "level"),
        xr.DataArray(np.zeros(218), dims="node"),
        1.0,
    ],
)
def test_a_profile_that_changes_its_coordinate_ends_the_run_in_one_line(tmp_path, later):
    @diagnostic
    def levels(sim):
        return xr.DataArray(np.zeros(3), dims="level") if sim.time < 7200.0 else later

    summary = simulation().run(days=0.25, out=tmp_path / "run.nc")
    reason = f"the diagnostic levels {CHANGED}: return the same kind"
    assert (summary.status, summary.reason) == ("failed", reason)


@pytest.mark.parametrize(
    ("wrong", "reason"),
    [
        (xr.DataArray(np.zeros(0), dims="k"), "a profile needs values, and finite numbers"),
        (xr.DataArray([1.0], {"k": ["a"]}, "k"), "a profile needs values, and finite numbers"),
        (xr.DataArray([1.0], {"k": [np.nan]}, "k"), "a profile needs values, and finite numbers"),
        (xr.DataArray([1.0], {"k": [np.datetime64("2000")]}, "k"), "a profile needs values, and"),
        (xr.DataArray([1.0j], dims="k"), "it returned complex numbers"),
        (1.0j, "it returned complex numbers"),
        (xr.DataArray([1.0], dims="a b/c"), "the dimension 'a b/c' needs another name"),
        (xr.DataArray([1.0], dims="other"), "the dimension 'other' needs another name"),
        (xr.Dataset({"a": ("k", [1.0])}), "convert"),
    ],
)
def test_what_is_no_profile_is_refused_in_one_line(tmp_path, wrong, reason):
    @diagnostic
    def levels_other(sim):
        return 0.0

    @diagnostic
    def levels(sim):
        return wrong

    summary = simulation().run(days=0.25, out=tmp_path / "run.nc")
    assert summary.status == "failed"
    assert "the diagnostic levels" in summary.reason and reason in summary.reason


@pytest.mark.parametrize("name", ["levels", "x_diagnostic_time", "diagnostic_time_x"])
@pytest.mark.parametrize("dimension", ["diagnostic_time", "time", "lat"])
def test_names_like_those_of_series_leave_files_readable(tmp_path, name, dimension):
    diagnostic(lambda sim: xr.DataArray([1.0, sim.time], dims=dimension), name=name)
    assert simulation().run(days=0.25, out=tmp_path / "run.nc").completed
    run = open_run(tmp_path / "run.nc")
    assert run[name].dims == ("time", f"{name}_{dimension}")
    assert run[name].values.tolist() == [[1.0, t] for t in (0.0, 21600.0)]
    assert run.sizes["diagnostic_time"] == run.l2_h.size if "l2_h" in run else True


def test_a_changed_profile_is_no_damage_of_the_file_that_a_run_resumes(tmp_path):
    out = tmp_path / "run.nc"
    for size, days in ((3, 0.25), (4, 0.5)):
        diagnostic(lambda sim, n=size: xr.DataArray(np.zeros(n), dims="k"), name="levels")
        if size == 3:
            simulation().run(days=days, out=out)
    with pytest.raises(ConfigError, match="its frames hold other fields"):
        Simulation.from_checkpoint(out).run(days=0.5, out=out)
    assert open_run(out).levels.shape == (2, 3)


def test_regridded_files_keep_profiles(zonal_wind, tmp_path):
    simulation().run(days=0.25, out=tmp_path / "run.nc")
    regrid_file(tmp_path / "run.nc", "latlon:7x12", tmp_path / "grid.nc")
    with xr.open_dataset(tmp_path / "grid.nc", decode_times=False) as grid:
        assert np.array_equal(grid.zonal_wind, open_run(tmp_path / "run.nc").zonal_wind)


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
