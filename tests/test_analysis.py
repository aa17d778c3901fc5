"""`ds.swe`: other grids, spectra, streamfunctions, integrals and errors, against known fields."""

import re
import shutil
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from netCDF4 import Dataset
from scipy.special import sph_harm_y

from swe_sphere.analysis.accessor import Analysis, open_run
from swe_sphere.analysis.regrid import gaussian, lat_lon, parse_grid, regrid_file
from swe_sphere.errors import ConfigError
from swe_sphere.io.integrals import area_mean, norms
from swe_sphere.io.layout import frame_dataset, frame_fields
from swe_sphere.io.netcdf import FrameWriter
from swe_sphere.io.reference_solution import Reference, compare
from swe_sphere.io.runfile import RunFile
from swe_sphere.mesh import Interpolator, Mesh, cubed_sphere
from swe_sphere.mesh.sphere import position
from swe_sphere.pictures.plot import plot_file
from swe_sphere.planet import EARTH

SPEED = 40.0
DEGREE, ORDER = 5, 3


def wave(lon, lat):
    """A real spherical harmonic of degree 5 and order 3, from scipy."""
    return np.sqrt(2.0) * sph_harm_y(DEGREE, ORDER, 0.5 * np.pi - lat, lon).real


def depth(lon, lat):
    return 5000.0 + 300.0 * np.sin(lat) ** 2 + 100.0 * wave(lon, lat)


def rotation(mesh):
    """Solid-body rotation about the axis."""
    return {
        "u": SPEED * np.cos(mesh.lat), "v": 0.0 * mesh.lat, "h": depth(mesh.lon, mesh.lat),
        "vorticity": 2.0 * SPEED / mesh.radius * np.sin(mesh.lat), "divergence": 0.0 * mesh.lat,
        "b": 100.0 * np.cos(mesh.lon) * np.cos(mesh.lat),
        "f": 2.0 * EARTH.rotation * np.sin(mesh.lat),
    }  # fmt: skip


@pytest.fixture(scope="module")
def mesh():
    return Mesh.build(4, 8, stretch=1.3, centre=(40.0, 23.0), spin=17.0)


@pytest.fixture(scope="module")
def data(mesh):
    return frame_dataset(
        mesh, rotation(mesh), 3600.0, {"planet": {"gravity": 10.0}}, frame_fields()
    )


@pytest.fixture(scope="module")
def run(mesh, tmp_path_factory):
    """A file of three frames, of which the depth grows."""
    path = tmp_path_factory.mktemp("analysis") / "run.nc"
    fields = rotation(mesh)
    with FrameWriter(path, mesh, {"scene": "solid"}, fields["b"], coriolis=fields["f"]) as writer:
        for k in range(3):
            writer.write(600.0 * k, fields | {"h": fields["h"] + k}, {"mass": float(k)})
        writer.finish({"completed": True})
    return path


@pytest.mark.parametrize("grid", [lat_lon(45, 90), lat_lon(30, 60), gaussian(12)])
def test_points_are_the_polynomials_of_the_elements(data, grid):
    found = data.swe.to_grid(grid).isel(time=0)
    lon, lat = grid.points
    np.testing.assert_allclose(found.h, depth(lon, lat), rtol=0.0, atol=2e-4)
    np.testing.assert_allclose(found.u, SPEED * np.cos(lat), rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(found.v, 0.0, rtol=0.0, atol=1e-6)
    assert found.h.attrs == {"long_name": "depth of the fluid", "units": "m"}
    total = 4.0 * np.pi * EARTH.radius**2
    assert found.cell_area.sum().item() == pytest.approx(total, rel=1e-12)
    assert (found.lat_bnds[1:, 0].values == found.lat_bnds[:-1, 1].values).all()
    assert ((found.lat >= found.lat_bnds[:, 0]) & (found.lat <= found.lat_bnds[:, 1])).all()


def test_matrices_that_are_too_large_to_keep_are_built_again(mesh, monkeypatch):
    built = []

    def counted(*arguments, locate=cubed_sphere.locate):
        built.append(arguments)
        return locate(*arguments)

    monkeypatch.setattr(cubed_sphere, "locate", counted)
    monkeypatch.setattr("swe_sphere.mesh.interpolate.TILE", 100)
    field = wave(mesh.lon, mesh.lat)
    kept = Interpolator(mesh, *gaussian(8).points)
    expected = kept(field)
    tiles = len(built)
    np.testing.assert_array_equal(kept(field), expected)
    assert len(built) == tiles == 6
    monkeypatch.setattr("swe_sphere.mesh.interpolate.MOST_ENTRIES", 0)
    anew = Interpolator(mesh, *gaussian(8).points)
    for _ in range(2):
        np.testing.assert_array_equal(anew(field), expected)
    assert len(built) == 3 * tiles


def test_a_solid_rotation_has_its_spectrum(data):
    """All its energy, the mean of (u² + v²) / 2 = U² / 3, is at wavenumber 1."""
    found = data.swe.spectrum(degree=12).isel(time=0)
    expected = np.zeros(13)
    expected[1] = SPEED**2 / 3.0
    np.testing.assert_allclose(found.rotational_energy, expected, rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(found.divergent_energy, 0.0, rtol=0.0, atol=1e-12)
    enstrophy = 0.5 * (2.0 * SPEED / EARTH.radius) ** 2 / 3.0
    assert found.enstrophy[1].item() == pytest.approx(enstrophy, rel=1e-6)


def gradient(mesh, lon, lat):
    """Slopes of the wave along east and north [m-1], by central differences of scipy's values."""
    d = 1e-5
    north = (wave(lon, lat + d) - wave(lon, lat - d)) / (2.0 * d)
    east = (wave(lon + d, lat) - wave(lon - d, lat)) / (2.0 * d * np.cos(lat))
    return east / mesh.radius, north / mesh.radius


def test_a_harmonic_of_the_streamfunction_and_one_of_the_potential(mesh):
    """V = k × ∇ψ + ∇χ of one harmonic: energy n (n + 1) / a² times half its mean square each."""
    east, north = gradient(mesh, mesh.lon, np.clip(mesh.lat, -1.5706, 1.5706))
    psi, chi = 3e7, 1e7
    fields = rotation(mesh) | {"u": -psi * north + chi * east, "v": psi * east + chi * north}
    made = frame_dataset(mesh, fields, 0.0, {}, frame_fields()).swe
    found = made.spectrum(degree=12).isel(time=0)
    mean = DEGREE * (DEGREE + 1) / mesh.radius**2 / (4.0 * np.pi) / 2.0
    for name, size in (("rotational_energy", psi), ("divergent_energy", chi)):
        assert found[name][DEGREE].item() == pytest.approx(size**2 * mean, rel=1e-4)
        assert found[name].sum().item() == pytest.approx(size**2 * mean, rel=1e-4)
    function = made.streamfunction().isel(time=0)
    exact = psi * wave(mesh.lon, mesh.lat)
    np.testing.assert_allclose(function, exact, rtol=0.0, atol=1e-4 * np.abs(exact).max())


def test_streamfunction_of_a_solid_rotation(data, mesh):
    found = data.swe.streamfunction()
    assert found.dims == ("time", "node") and found.attrs["units"] == "m2 s-1"
    exact = -SPEED * mesh.radius * np.sin(mesh.lat)
    np.testing.assert_allclose(found[0], exact, rtol=0.0, atol=1e-7 * SPEED * mesh.radius)


def test_zonal_means_know_no_waves(data):
    found = data.swe.zonal_mean(37).isel(time=0)
    lat = np.radians(found.lat)
    np.testing.assert_allclose(found.u, SPEED * np.cos(lat), rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(found.h, 5000.0 + 300.0 * np.sin(lat) ** 2, rtol=0.0, atol=1e-4)
    assert found.h.attrs["cell_methods"] == "longitude: mean"


def test_potential_vorticity_and_integrals(data, mesh):
    fields = rotation(mesh)
    absolute = 2.0 * (SPEED / mesh.radius + EARTH.rotation) * np.sin(mesh.lat)
    found = data.swe.potential_vorticity()
    np.testing.assert_allclose(found[0], absolute / fields["h"], rtol=1e-12, atol=1e-25)
    numbers = data.swe.integrals()
    assert numbers.time.values.tolist() == [3600.0]
    h, b = fields["h"], fields["b"]
    energy = area_mean(mesh.area, 0.5 * h * fields["u"] ** 2 + 5.0 * ((h + b) ** 2 - b**2))
    assert numbers.energy.item() == pytest.approx(energy, rel=1e-12)
    enstrophy = area_mean(mesh.area, absolute**2 / (2.0 * h))
    assert numbers.potential_enstrophy.item() == pytest.approx(enstrophy, rel=1e-12)
    assert numbers.mass.attrs["units"] == "m"


def test_errors_against_a_run_on_another_mesh(data, mesh):
    other = Mesh.build(3, 6)
    theirs = frame_dataset(other, rotation(other), 3600.0, {}, frame_fields())
    assert float(data.swe.error_norms(theirs).linf_wind.item()) < 1e-6
    theirs["h"] *= 1.01
    found = data.swe.error_norms(theirs, ["h", "h"])
    assert [*found] == ["l1_h", "l2_h", "linf_h"]
    assert found.l2_h.item() == pytest.approx(0.01 / 1.01, rel=1e-4)
    assert (data.swe.error_norms(data).to_array() == 0.0).all()
    with pytest.raises(ConfigError, match="no common time"):
        data.swe.error_norms(data.assign_coords(time=[0.0]))
    with pytest.raises(ConfigError, match=r"a dataset from open_run, got 'run\.nc'"):
        data.swe.error_norms("run.nc")


def test_errors_between_runs_are_weighted_with_areas(data, mesh):
    """On a stretched mesh, whose nodes crowd where the runs differ."""
    theirs = data.copy()
    theirs["h"] = data.h * (1.0 + 0.01 * (mesh.lat > 0.5))
    found = data.swe.error_norms(theirs, "h")
    for norm, value in norms(mesh.area, data.h.values[0], theirs.h.values[0]).items():
        assert found[f"{norm}_h"].item() == pytest.approx(value, rel=1e-12)


def test_times_that_xarray_has_decoded_are_seconds_again(run):
    with xr.open_dataset(run) as decoded:
        assert np.issubdtype(decoded.time.dtype, np.datetime64)
        assert decoded.swe.frames.times.tolist() == [0.0, 600.0, 1200.0]
    data = open_run(run)
    spans = data.assign_coords(time=(1e9 * data.time).astype("timedelta64[ns]"))
    assert spans.swe.frames.times.tolist() == [0.0, 600.0, 1200.0]


@pytest.mark.parametrize("first", [0, 1])
def test_times_that_xarray_saved_in_other_units_are_seconds(run, tmp_path, first):
    """Without the encoding of the file xarray chooses units and counts from the first time."""
    data = open_run(run)
    with xr.open_dataset(run) as decoded:
        hours = decoded.isel(time=slice(first, None)).load()
        moved = {name: hours[name] + np.timedelta64(0, "h") for name in ("time", "diagnostic_time")}
        moved["time"] = hours.time[0] + 6 * (hours.time - hours.time[0])
        hours.assign_coords(moved).to_netcdf(tmp_path / "hours.nc")
    with xr.open_dataset(tmp_path / "hours.nc", decode_times=False) as raw:
        assert not raw.time.units.startswith("seconds")
    expected = [[0.0, 3600.0, 7200.0], [600.0, 4200.0]][first]
    saved = open_run(tmp_path / "hours.nc")
    assert saved.time.values.tolist() == saved.swe.frames.times.tolist() == expected
    assert saved.time.attrs["units"] == data.time.attrs["units"]
    xr.testing.assert_equal(saved.mass, data.mass)
    found = RunFile(tmp_path / "hours.nc")
    assert found.times.tolist() == expected
    assert found.series()[0].tolist() == [0.0, 600.0, 1200.0]
    assert compare(tmp_path / "hours.nc", run)["time"] == [0.0, 600.0][first]
    regrid_file(tmp_path / "hours.nc", "latlon:4x4", tmp_path / "grid.nc")
    assert Reference(tmp_path / "grid.nc").times.tolist() == expected


@pytest.mark.parametrize(
    ("units", "factor"),
    [
        ("seconds", 1.0), ("s", 1.0), ("hours", 3600.0), ("days", 86400.0),
        ("hours since 2000-1-1 00:00", 3600.0), ("minutes since 1999-12-31T23:59", 60.0),
        ("nanoseconds since 2000-01-01 00:00:00", 1e-9),
    ],
)  # fmt: skip
def test_units_of_times(data, units, factor):
    late = 60.0 if "1999" in units else 0.0
    given = data.assign_coords(time=("time", [(3600.0 + late) / factor], {"units": units}))
    assert given.swe.frames.times.tolist() == pytest.approx([3600.0], rel=1e-15)


@pytest.mark.parametrize(
    "units", ["fortnights", "1", "months since 2000-01-01", "hours since x", 3]
)
def test_units_that_are_none_of_times_are_refused(data, run, tmp_path, units):
    with pytest.raises(ConfigError, match=r"the dataset: times must be in seconds, .*, got '") as e:
        _ = data.assign_coords(time=("time", [1.0], {"units": units})).swe.frames
    assert "\n" not in str(e.value)
    shutil.copy(run, tmp_path)
    with Dataset(tmp_path / "run.nc", "a") as file:
        file["time"].units = units
    for reader in (RunFile, open_run):
        with pytest.raises(ConfigError, match=r"run.nc: times must be in seconds"):
            reader(tmp_path / "run.nc")


@pytest.mark.parametrize("calendar", ["standard", "noleap", "360_day"])
def test_dates_of_cftime_are_seconds(run, calendar):
    cftime = pytest.importorskip("cftime")
    dates = cftime.num2date([0.0, 600.0, 1200.5], "seconds since 2000-01-01", calendar)
    times = open_run(run).assign_coords(time=dates).swe.frames.times
    assert times.tolist() == [0.0, 600.0, 1200.5]


def test_packed_numbers_are_unpacked(run, tmp_path):
    data, path = open_run(run), tmp_path / "packed.nc"
    how = {"dtype": "int16", "scale_factor": 0.1, "add_offset": 5000.0, "_FillValue": -32768}
    data.to_netcdf(path, encoding={"h": how})
    with xr.open_dataset(path, mask_and_scale=False) as raw:
        assert raw.h.dtype == np.int16
    packed = open_run(path)
    for found in (packed.h.values[-1], RunFile(path).values("h"), packed.swe.frames.values("h")):
        np.testing.assert_allclose(found, data.h.values[-1], rtol=0.0, atol=0.051)
    assert compare(path, run)["linf"] < 2e-5
    assert packed.face_nodes.dtype == data.face_nodes.dtype == np.int32
    with Dataset(path, "a") as file:
        file.set_auto_maskandscale(False)
        file["h"][2, 5] = -32768
    with pytest.raises(ConfigError, match="1 values of h are missing"):
        RunFile(path).values("h")


def test_nodes_in_another_order_are_refused(run, tmp_path):
    data = open_run(run)
    placed = data.sortby("lat")
    for make in (lambda ds: ds.to_latlon(9, 16), lambda ds: ds.error_norms(data),
                 lambda ds: data.swe.error_norms(placed), lambda ds: ds.frames):  # fmt: skip
        with pytest.raises(ConfigError, match=r"cannot use this dataset: its nodes .* order"):
            make(placed.swe)
    placed.to_netcdf(tmp_path / "sorted.nc")
    for pair in ((run, tmp_path / "sorted.nc"), (tmp_path / "sorted.nc", run)):
        with pytest.raises(ConfigError, match=r"sorted.nc: its nodes .* another order"):
            compare(*pair)
    with pytest.raises(ConfigError, match="shape"):
        _ = data.drop_vars("lat").assign_coords(lat=("row", [0.0, 1.0])).swe.mesh
    # other longitudes of the same places, in single precision, and datasets without longitudes
    west = data.assign_coords(lon=((data.lon + 180.0) % 360.0 - 180.0).astype("float32"))
    for same in (west, data.drop_vars("lon")):
        np.testing.assert_array_equal(same.swe.mesh.xyz, data.swe.mesh.xyz)


def test_fields_that_are_added_in_place_are_found(run):
    data = open_run(run)
    before = data.swe.frames
    data["pv"] = data.swe.potential_vorticity()
    assert "pv" not in before.about and "pv" in data.swe.frames.about
    np.testing.assert_array_equal(data.swe.frames.values("pv"), data.pv.values[-1])
    data["b"] = data.b + 1.0
    np.testing.assert_array_equal(data.swe.frames.bottom, data.b)


def test_constants_may_have_times(run, tmp_path):
    """They have them after `xr.concat` of all variables, and after means in time."""
    data, path = open_run(run), tmp_path / "joined.nc"
    parts = [data.isel(time=[k]) for k in range(3)]
    xr.concat(parts, "time", data_vars="all", coords="minimal", compat="override").to_netcdf(path)
    with xr.open_dataset(path) as joined:
        assert joined.b.dims == joined.f.dims == ("time", "node")
    here, there = RunFile(path), RunFile(run)
    assert here.bottom.shape == (here.mesh.size,)
    for name in ("h", "b", "f", "surface", "potential_vorticity_anomaly"):
        np.testing.assert_array_equal(here.values(name, 600.0), there.values(name, 600.0))
    assert compare(path, run, "surface")["linf"] == 0.0
    assert regrid_file(path, "latlon:4x4", tmp_path / "grid.nc").exists()
    np.testing.assert_array_equal(open_run(path).swe.frames.bottom, data.b)


@pytest.mark.parametrize("chunks", ["x", {"time": "x"}, 1.5])
def test_chunks_that_are_none_are_refused_in_one_line(run, chunks):
    pytest.importorskip("dask")
    with pytest.raises(ConfigError, match=r"cannot read .*run.nc in chunks") as error:
        open_run(run, chunks=chunks)
    assert "\n" not in str(error.value)


def test_dask_chooses_chunks(run):
    pytest.importorskip("dask")
    found = open_run(run, chunks="auto")
    assert found.h.chunks is not None
    xr.testing.assert_equal(found.compute(), open_run(run))


def test_fields_in_chunks_of_nodes_are_interpolated(run):
    whole, parts = open_run(run), open_run(run, chunks={"node": 50})
    found = parts.swe.to_latlon(9, 16)
    np.testing.assert_array_equal(found.h, whole.swe.to_latlon(9, 16).h)
    xr.testing.assert_equal(parts.swe.spectrum().compute(), whole.swe.spectrum())


def test_rounded_coordinates_are_those_of_the_mesh(run, tmp_path):
    packed = {"dtype": "int16", "scale_factor": 360.0 / 65000.0, "_FillValue": -32768}
    data = xr.open_dataset(run, decode_times=False)
    data["lon"] = (data.lon + 180.0) % 360.0 - 180.0
    data.to_netcdf(tmp_path / "a.nc", encoding={"lat": packed, "lon": packed})
    assert open_run(tmp_path / "a.nc").swe.to_latlon(9, 16).h.notnull().all()


@pytest.mark.parametrize("grid", [lat_lon(30, 60), gaussian(12)])
def test_points_of_a_grid_lie_within_the_bounds_of_their_cells(data, grid):
    found = data.swe.to_grid(grid)
    west, east = found.lon_bnds.values.T
    np.testing.assert_allclose(0.5 * (west + east), found.lon, atol=1e-10)
    south, north = found.lat_bnds.values.T
    assert (south < found.lat).all() and (found.lat < north).all()
    for below, above in ((west, east), (south, north)):
        np.testing.assert_allclose(below[1:], above[:-1], atol=1e-10)


ODD = {"planet": {"gravity": 10.0}, "done": True, "limit": None, "cuts": ["a"], "ends": (1.0, 2)}


def test_everything_can_be_saved(mesh, run, tmp_path):
    state = frame_dataset(mesh, rotation(mesh), 3600.0, ODD, frame_fields())
    for data in (state, open_run(run)):
        for each in (data, data.isel(time=0), data.swe.to_latlon(19, 36), data.swe.spectrum(4)):
            each.to_netcdf(tmp_path / "saved.nc")
            with xr.open_dataset(tmp_path / "saved.nc", decode_times=False) as saved:
                xr.testing.assert_equal(saved, each)
                assert saved.attrs.keys() == each.attrs.keys()
    open_run(run).to_netcdf(tmp_path / "saved.nc")
    again = open_run(tmp_path / "saved.nc")
    assert again.swe.mesh.size == mesh.size and again.attrs["completed"]


def test_a_state_in_memory_is_described_as_one_in_a_file(mesh, run):
    state, file = frame_dataset(mesh, rotation(mesh), 3600.0, ODD, frame_fields()), open_run(run)
    for name in state.variables:
        about = state[name].attrs
        assert about.items() <= file[name].attrs.items() and about["units"], name
        assert not about.keys() & {"mesh", "grid_mapping"}
    for name in ("lat", "lon", "time"):
        assert "standard_name" in state[name].attrs
    assert bool(state.attrs["done"]) and state.attrs["planet"] == '{"gravity": 10.0}'


def test_names_of_the_summary_hide_none_of_the_file(mesh, tmp_path):
    """Those of the user's own numbers, which stand in the summary, may be any."""
    with FrameWriter(tmp_path / "run.nc", mesh, {"scene": "x", "days": 3.0}) as writer:
        writer.write(0.0, rotation(mesh))
        writer.finish({"radius": 1.0, "spin": 90.0, "scene": "y", "days": 2.0, "jet": 5.0})
    data = open_run(writer.path)
    np.testing.assert_array_equal(data.swe.mesh.xyz, mesh.xyz)
    assert data.swe.mesh.radius == mesh.radius
    assert [data.attrs[name] for name in ("scene", "days", "jet")] == ["x", 2.0, 5.0]


def test_frames_are_computed_when_they_are_asked_for(run):
    pytest.importorskip("dask")
    lazy, eager = open_run(run, chunks={"time": 1}).swe, open_run(run).swe
    for make in (
        lambda ds: ds.to_latlon(19, 36).u, lambda ds: ds.streamfunction(),
        lambda ds: ds.potential_vorticity(), lambda ds: ds.spectrum(6).enstrophy,
    ):  # fmt: skip
        later = make(lazy)
        assert later.chunks is not None
        assert later.shape[0] == 3
        xr.testing.assert_equal(later.compute(), make(eager))


def test_any_order_of_dimensions_and_any_kind_of_whole_numbers_will_do(run):
    data = open_run(run)
    found = data.transpose().swe.to_latlon(19.0, np.int64(36))
    xr.testing.assert_allclose(found, data.swe.to_latlon(19, 36))
    assert found.attrs["grid"] == "latlon:19x36" and {"h", "u", "v"} <= set(found)
    xr.testing.assert_equal(data.swe.spectrum(degree=8.0), data.swe.spectrum(8))
    xr.testing.assert_allclose(data.transpose().swe.integrals(), data.swe.integrals())
    for make in (lambda ds: ds.to_latlon(19.5), lambda ds: ds.to_gaussian("x"),
                 lambda ds: ds.spectrum(2.5)):  # fmt: skip
        with pytest.raises(ConfigError, match="must be a whole number, got"):
            make(data.swe)


def test_names_of_fields_are_one_or_any_collection_of_them(run):
    data = open_run(run)
    assert sorted(data.swe.error_norms(data, "vorticity")) == [
        "l1_vorticity", "l2_vorticity", "linf_vorticity"
    ]  # fmt: skip
    found = data.swe.error_norms(data, (name for name in ["h", "wind"]))
    assert found.sizes["time"] == 3 and found.linf_wind.shape == (3,)
    with pytest.raises(ConfigError, match="the field 5 is missing"):
        data.swe.error_norms(data, fields=5)


def test_no_frame_and_several_members_are_refused_in_one_line(run):
    data = open_run(run)
    none, two = data.isel(time=[]), xr.concat([data, data], "member", data_vars="all")
    for each, reason in ((none, "holds no frame"), (two, "choose one of member")):
        for make in (lambda ds: ds.integrals(), lambda ds: ds.plot("h"),
                     lambda ds: ds.error_norms(data)):  # fmt: skip
            with pytest.raises(ConfigError, match=reason):
                make(each.swe)
    assert two.isel(member=0).swe.integrals().mass.shape == (3,)
    for make in (lambda ds: ds.spectrum(3), lambda ds: ds.to_latlon(5, 8), lambda ds: ds.animate(),
                 lambda ds: ds.to_gaussian(4), lambda ds: ds.streamfunction(),
                 lambda ds: ds.zonal_mean(5), lambda _: data.swe.error_norms(none)):  # fmt: skip
        with pytest.raises(ConfigError, match="this dataset holds no frames"):
            make(none.swe)
    assert none.swe.potential_vorticity().shape == (0, data.sizes["node"])


def test_a_store_may_have_any_name(run, tmp_path):
    pytest.importorskip("zarr")
    open_run(run).to_zarr(tmp_path / "store", zarr_format=2)
    xr.testing.assert_equal(open_run(tmp_path / "store"), open_run(run))
    assert regrid_file(tmp_path / "store", "latlon:4x4", tmp_path / "grid.nc").exists()


@pytest.mark.parametrize(
    "grid",
    [
        pytest.param("latlon:4x4", marks=pytest.mark.thorough),
        "latlon:2x4",
        pytest.param("latlon:3x4", marks=pytest.mark.thorough),
        "gaussian:1",
    ],
)
def test_the_smallest_grids_are_drawn(run, tmp_path, grid):
    path = regrid_file(run, grid, tmp_path / "grid.nc", fields=["h"])
    assert plot_file(path, "h", out=tmp_path / "h.png").stat().st_size > 10_000
    here = Reference(path)
    np.testing.assert_allclose(here.at("h", *here.points), here.values("h"), rtol=1e-12)


def test_some_fields_on_a_grid_are_opened(run, tmp_path):
    path = regrid_file(run, "latlon:19x36", tmp_path / "grid.nc", fields=["h"])
    data = open_run(path)
    assert data.h.dims == ("time", "lat", "lon") and "b" not in data
    with pytest.raises(ConfigError, match="on a grid, or not of a run"):
        data.swe.spectrum()
    with pytest.raises(ConfigError, match="is already on a grid: give the file of a run"):
        regrid_file(path, "latlon:31x60", tmp_path / "again.nc")


def test_what_is_not_of_a_run(data, mesh):
    with pytest.raises(ConfigError, match="not of a run"):
        Analysis(data.swe.to_latlon(19, 36)).spectrum()
    with pytest.raises(ConfigError, match="part of the nodes"):
        _ = data.isel(node=slice(10)).swe.mesh
    with pytest.raises(ConfigError, match="does not hold f"):
        data.drop_vars("f").swe.potential_vorticity()
    for name in ("vorticity", "b", "f"):
        with pytest.raises(ConfigError, match=f"does not hold {name}"):
            data.drop_vars(name).swe.integrals()
    with pytest.raises(ConfigError, match="wavenumber 1"):
        data.swe.spectrum(0)


@pytest.mark.parametrize(
    "name",
    [
        "latlon:1x4", "latlon:181", "gaussian:0", "latlon:99999x99999", "r360x180", "",
        f"latlon:{'9' * 5000}x4", f"gaussian:{'9' * 5000}",
    ],
)  # fmt: skip
def test_grids_that_are_none(name):
    with pytest.raises(ConfigError, match="grid"):
        parse_grid(name)


def test_a_file_is_regridded_frame_by_frame(run, tmp_path):
    out = regrid_file(run, "latlon:19x36", tmp_path / "grid.nc")
    with xr.open_dataset(out, decode_times=False) as found:
        expected = open_run(run).swe.to_latlon(19, 36)
        for name in ("h", "u", "v", "vorticity", "b", "f", "cell_area", "lat_bnds"):
            np.testing.assert_allclose(found[name], expected[name], rtol=1e-13, atol=1e-20)
        assert found.time.values.tolist() == [0.0, 600.0, 1200.0]
        assert found.mass.values.tolist() == [0.0, 1.0, 2.0]
        assert found.h.encoding["zlib"]
        first, second = found.attrs["history"].splitlines()
        assert "regrid run.nc --grid latlon:19x36" in first and "run solid" in second
    assert [path.name for path in tmp_path.iterdir()] == ["grid.nc"]


def test_a_frame_with_missing_values_is_not_regridded(run, tmp_path):
    with Dataset(shutil.copy(run, tmp_path / "run.nc"), "a") as data:
        data["h"][2, 5] = np.nan
    with pytest.raises(ConfigError, match="1 values of h are missing or not finite"):
        regrid_file(tmp_path / "run.nc", "latlon:19x36", tmp_path / "grid.nc")
    assert not (tmp_path / "grid.nc").exists()


def test_a_file_becomes_a_zarr_store(run, tmp_path):
    pytest.importorskip("zarr")
    out = regrid_file(run, "gaussian:5", tmp_path / "grid.zarr", fields=["h", "u"])
    found = xr.open_zarr(out, decode_times=False, consolidated=False)
    expected = open_run(run).swe.to_gaussian(5)
    assert set(found.data_vars) == {"u", "v", "h", "mass", "lat_bnds", "lon_bnds"}
    np.testing.assert_allclose(found.u, expected.u, rtol=1e-14)
    np.testing.assert_allclose(found.h, expected.h, rtol=1e-14)
    assert found.h.shape == (3, 10, 20)


@pytest.mark.parametrize("ending", ["nc", "ZARR"])
def test_fields_without_times_are_one_frame(run, tmp_path, ending):
    if ending == "ZARR":
        pytest.importorskip("zarr")
    out = regrid_file(run, "latlon:9x8", tmp_path / f"grid.{ending}", fields=["b", "f"])
    assert Reference(out).values("b") == pytest.approx(
        open_run(run).swe.to_latlon(9, 8).b.data.ravel()
    )


def test_a_component_of_the_wind_alone_is_not_interpolated(mesh, tmp_path):
    path, out = tmp_path / "run.nc", tmp_path / "grid.NC"
    for only in ("uh", "v"):
        path.unlink(missing_ok=True)
        with FrameWriter(path, mesh, {}, only=tuple(only)) as writer:
            writer.write(0.0, rotation(mesh))
        for fields in ([only[0]], []):
            with pytest.raises(ConfigError, match="u and v are interpolated together"):
                regrid_file(path, "latlon:9x8", out, fields, overwrite=True)
        with pytest.raises(ConfigError, match="does not hold"):
            open_run(path).swe.to_latlon(9, 8)
        there = "h" if "h" in only else "b"
        with xr.open_dataset(
            regrid_file(path, "latlon:9x8", out, [there], overwrite=True)
        ) as found:
            assert there in found


def test_memory_does_not_grow_with_the_number_of_frames(tmp_path):
    mesh, peaks = Mesh.build(2, 4), []
    fields = rotation(mesh)
    for frames in (2, 12):
        path = tmp_path / f"{frames}.nc"
        with FrameWriter(path, mesh, {}) as writer:
            for k in range(frames):
                writer.write(60.0 * k, fields)
        regrid_file(path, "latlon:60x120", tmp_path / "warm.nc", overwrite=True)
        tracemalloc.start()
        regrid_file(path, "latlon:60x120", tmp_path / "grid.nc", overwrite=True)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.3 * peaks[0]


def test_files_that_are_not_regridded(run, tmp_path):
    grid = regrid_file(run, "latlon:4x4", tmp_path / "grid.nc")
    before = grid.read_bytes()
    for path, out, fields, reason in (
        (grid, "b.nc", (), "already on a grid"),
        (run, "grid.nc", (), "exists: choose another name"),
        (run, "b.nc", ("temperature",), "unknown field"),
        (run, "b.txt", (), "ending in .nc or .zarr"),
        (run, "missing/b.nc", (), "there is no folder"),
        (tmp_path / "none.nc", "b.nc", (), "there is no file"),
    ):
        with pytest.raises(ConfigError, match=reason) as error:
            regrid_file(path, "latlon:4x4", tmp_path / out, fields=fields)
        assert "\n" not in str(error.value)
    link = tmp_path / "link.nc"
    link.symlink_to(run)
    for out in (run, link):
        with pytest.raises(ConfigError, match="is the input file"):
            regrid_file(run, "latlon:4x4", out, overwrite=True)
    assert grid.read_bytes() == before and RunFile(run).times.size == 3


@pytest.mark.parametrize("ending", ["nc", "zarr"])
def test_a_grid_that_is_there_stays_until_there_is_another(run, tmp_path, monkeypatch, ending):
    out = tmp_path / f"grid.{ending}"
    regrid_file(run, "latlon:4x4", out)
    rename = Path.replace

    def killed(path, target):
        if target == out:
            raise KeyboardInterrupt
        return rename(path, target)

    monkeypatch.setattr(Path, "replace", killed)
    with pytest.raises(KeyboardInterrupt):
        regrid_file(run, "latlon:6x8", out, overwrite=True)
    (kept,) = tmp_path.iterdir()
    assert Reference(kept).lat.size == 4
    monkeypatch.undo()
    regrid_file(run, "latlon:6x8", out, overwrite=True)
    assert Reference(out).lat.size == 6 and [*tmp_path.iterdir()] == [out]


def test_a_regridded_run_is_read_at_each_of_its_times(run, tmp_path):
    path = regrid_file(run, "latlon:31x60", tmp_path / "grid.nc")
    grid, points = Reference(path), RunFile(run)
    np.testing.assert_allclose(grid.values("h") - grid.values("h", 600.0), 1.0, atol=1e-9)
    lon, lat = np.array([0.3, 4.0]), np.array([0.2, -1.2])
    for time in (0.0, 1200.0):
        for field, bound in (("h", 2.0), ("u", 1e-2)):
            here = points.at(field, lon, lat, time)
            np.testing.assert_allclose(grid.at(field, lon, lat, time), here, atol=bound)
    assert compare(path, run)["time"] == 1200.0
    anomaly = "potential_vorticity_anomaly"
    for pair in ((path, run), (run, path)):
        assert compare(*pair, anomaly)["linf"] < 1e-2
    assert plot_file(path, anomaly, out=tmp_path / "anomaly.png").stat().st_size > 10_000
    assert plot_file(path, "h", 600.0, tmp_path / "h.png").stat().st_size > 10_000
    with pytest.raises(ConfigError, match=r"no frame at day 0\.1: the last ones are at day 0"):
        plot_file(path, "h", 8640.0)
    with pytest.raises(ConfigError, match="is already on a grid: give the file of a run"):
        regrid_file(path, "latlon:31x60", tmp_path / "again.nc")


def test_the_page_of_the_analysis_runs(tmp_path, monkeypatch):
    """Shortened, on a coarse mesh."""
    page = (Path(__file__).parents[1] / "docs" / "howto" / "analysis.md").read_text()
    text, _ = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    pytest.importorskip("dask")
    monkeypatch.chdir(tmp_path)
    found: dict = {}
    exec(text.replace("ne=8, np=6", "ne=2, np=4").replace("days=0.5, every=6", "days=0.1"), found)
    assert found["energy"].sum("wavenumber").compute().max() > 100.0
    assert found["gauss"].h.shape[1:] == (64, 128)


def triangle(a, b, c):
    """Signed areas of spherical triangles (van Oosterom & Strackee 1983)."""
    below = 1.0 + sum(np.sum(x * y, axis=-1) for x, y in ((a, b), (b, c), (c, a)))
    return 2.0 * np.arctan2(np.sum(a * np.cross(b, c), axis=-1), below)


@pytest.mark.parametrize("mesh", [Mesh.build(8, 4), Mesh.build(8, 8)], ids=["np4", "np8"])
def test_cells_around_the_nodes_cover_the_sphere_as_the_weights_do(mesh):
    corners = position(*mesh.cell_corners())
    parts = [triangle(mesh.xyz, corners[:, k], corners[:, (k + 1) % 4]) for k in range(4)]
    assert np.min(parts) > -1e-15  # anticlockwise, the node inside
    area, weights = sum(parts), mesh.area / mesh.radius**2
    assert area.sum() == pytest.approx(4.0 * np.pi, rel=1e-13)
    ratio = np.sort(area / weights)
    assert ratio[7] < 0.51 < 0.97 < ratio[8] and ratio[-1] < 1.02
    h = depth(mesh.lon, mesh.lat)
    assert np.average(h, weights=area) == pytest.approx(np.average(h, weights=weights), rel=1e-7)
