"""Random balanced flows, and states read from files of analyses."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from functools import partial
from pathlib import Path

import netCDF4
import numpy as np
import pytest
import xarray as xr
from scipy.special import lpmv

from swe_sphere.cli.main import main
from swe_sphere.equations.model import Model
from swe_sphere.equations.scene import Array
from swe_sphere.errors import ConfigError
from swe_sphere.mesh import Mesh
from swe_sphere.planet import EARTH, Planet
from swe_sphere.simulation.diagnostics import Snapshot
from swe_sphere.testcases import get_scene
from swe_sphere.testcases.harmonics import (
    BalancedFlow,
    GaussGrid,
    mean_squares,
    random_streamfunction,
    synthesis,
)

STILL = Planet(EARTH.radius, EARTH.gravity, 0.0)


def coefficients(degree: int = 7, seed: int = 3) -> np.ndarray:
    rng = np.random.default_rng(seed)
    c = rng.standard_normal((degree + 1, degree + 1, 2)) @ np.array([1.0, 1.0j])
    c[:, 0] = c[:, 0].real
    return np.tril(c)


def points(count: int = 60) -> tuple[Array, Array]:
    rng = np.random.default_rng(5)
    return rng.uniform(0.0, 2.0 * np.pi, count), rng.uniform(-1.5, 1.5, count)


def test_synthesis_is_the_sum_of_spherical_harmonics() -> None:
    c, (lon, lat) = coefficients(), points()
    expected = np.zeros_like(lon)
    for n in range(8):
        for m in range(n + 1):
            norm = np.prod(np.arange(n - m + 1.0, n + m + 1.0)) ** -0.5 * np.sqrt(2 * n + 1)
            legendre = (-1) ** m * norm * lpmv(m, n, np.sin(lat))  # without the sign of Condon
            expected += (c[n, m] * legendre * np.exp(1j * m * lon)).real
    value, east, north = synthesis(c, lon, lat)
    np.testing.assert_allclose(value, expected, rtol=0.0, atol=1e-12)
    d = 1e-5
    steps = [(lon + d, lat), (lon - d, lat), (lon, lat + d), (lon, lat - d)]
    e, w, n_, s = (synthesis(c, *where)[0] for where in steps)
    np.testing.assert_allclose(east, (e - w) / (2.0 * d * np.cos(lat)), atol=1e-6)
    np.testing.assert_allclose(north, (n_ - s) / (2.0 * d), atol=1e-6)


def test_synthesis_has_one_gradient_at_a_pole() -> None:
    lon = np.linspace(0.0, 2.0 * np.pi, 7)
    for pole in (-0.5 * np.pi, 0.5 * np.pi):
        _, east, north = synthesis(coefficients(), lon, np.full(7, pole))
        x = -np.sin(lon) * east - np.sin(pole) * np.cos(lon) * north
        assert np.ptp(x) < 1e-12 * np.abs(north).max() and np.abs(north).max() > 1.0


def test_gauss_grid_undoes_synthesis() -> None:
    c, grid = coefficients(), GaussGrid(9)
    value, east, north = synthesis(c, *grid.points)
    found = grid.coefficients(value)
    np.testing.assert_allclose(found[:8, :8], c, atol=1e-13)
    assert np.abs(found[8:]).max() < 1e-13
    n = np.arange(8)[:, None]
    laplacian = -grid.against_gradients(east, north)[:8, :8]
    np.testing.assert_allclose(laplacian, -n * (n + 1) * c, atol=1e-11)


def test_random_flow_has_the_spectrum_asked_for() -> None:
    psi = random_streamfunction(lambda n: n**-3.0, 12, 15.0, EARTH.radius, seed=4)
    n = np.arange(13)
    energy = 0.5 * n * (n + 1) / EARTH.radius**2 * mean_squares(psi)
    assert energy.sum() == pytest.approx(0.5 * 15.0**2) and energy[:2].sum() == 0.0
    np.testing.assert_allclose(energy[2:] / energy[2], (np.arange(2, 13) / 2.0) ** -3.0)
    grid = GaussGrid(24)
    u, v, _ = BalancedFlow(psi, EARTH, 1e4).state(*grid.points)
    assert grid.coefficients(u**2 + v**2)[0, 0].real == pytest.approx(15.0**2)
    other = random_streamfunction(lambda n: n**-3.0, 12, 15.0, EARTH.radius, seed=5)
    assert np.abs(psi - other).max() > 0.1 * np.abs(psi).max()


@pytest.mark.parametrize("planet", [EARTH, STILL], ids=["rotating", "still"])
def test_balanced_depth_keeps_the_flow_free_of_divergence(planet: Planet) -> None:
    """The divergence's growth in the model is that of the discretisation alone."""
    name = {"rotating": planet is EARTH}
    scene = get_scene("turbulence", wavenumber=4, **name)
    growth = [divergence_growth(scene, ne) for ne in (4, 6)]
    flat = scene.initial
    object.__setattr__(scene, "initial", lambda lon, lat: (*flat(lon, lat)[:2], 1e4 + 0.0 * lon))
    assert growth[0] < 2e-3 * divergence_growth(scene, 4) and growth[1] < 0.1 * growth[0]


def divergence_growth(scene, ne: int) -> float:
    """Root mean square of d(divergence)/dt [s-2] without dissipation."""
    model = Model(Mesh.build(ne, 8), scene.without_effect("hyperviscosity"))
    rate = model.zeros()
    model.tendency(model.initial_state(), 0.0, rate)
    divergence = Snapshot(model, rate, 0.0).all_fields["divergence"]
    return float(np.sqrt(np.average(divergence**2, weights=model.mesh.area)))


def test_turbulence_is_the_same_for_the_same_seed_on_any_points() -> None:
    lon, lat = points()
    one, two = (get_scene("turbulence", seed=s).initial(lon, lat) for s in (1, 2))
    again = get_scene("turbulence", seed="1").initial(lon[:5], lat[:5])
    np.testing.assert_allclose(np.array(one)[:, :5], again, rtol=1e-12)
    assert np.abs(one[0] - two[0]).max() > 5.0


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"wavenumber": 1}, "turbulence: wavenumber must be 2 to 40, got 1"),
        ({"wavenumber": "2.5"}, "turbulence: wavenumber must be a whole number, got '2.5'"),
        ({"speed": 0.0}, "turbulence: speed must be positive, got 0.0"),
        ({"seed": -1}, "scene.seed must not be negative, got -1"),
    ],
)
def test_bad_turbulence(given: dict[str, float | str], message: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(message)):
        get_scene("turbulence", **given)


def test_turbulence_too_strong_to_balance() -> None:
    with pytest.raises(ConfigError, match=r"turbulence: a mean depth of 10 km cannot balance 300"):
        get_scene("turbulence", speed=300.0).initial(*points(2000))


def test_synthetic_state_says_so_everywhere(tmp_path: Path, capsys, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    scene = get_scene("williamson7")
    assert "SYNTHETIC" in scene.title and scene.reference.startswith("SYNTHETIC")

    def said(*arguments: str) -> str:
        with pytest.raises(SystemExit) as status:
            main(arguments)
        assert not status.value.code
        return capsys.readouterr().out

    assert "SYNTHETIC" in next(x for x in said("list").splitlines() if "williamson7" in x)
    run = ("run", "williamson7", "--ne", "2", "--np", "4", "--days", "0.1", "--out", "a.nc")
    assert "SYNTHETIC" in said(*run)
    assert "SYNTHETIC" in json.loads(said(*run, "--overwrite", "--json"))["title"]
    with netCDF4.Dataset("a.nc") as file:
        assert "SYNTHETIC" in file.title and "SYNTHETIC" in file.scene_parameters


def test_synthetic_state_is_like_the_atmosphere() -> None:
    grid = GaussGrid(60)
    u, v, h = get_scene("williamson7").initial(*grid.points)
    assert grid.coefficients(h)[0, 0].real == pytest.approx(1e4, rel=1e-12)
    assert 15.0 < u.mean(axis=1).max() < 30.0 and 9000.0 > h.min() > 8000.0
    assert np.abs(v).max() < 60.0 and 10300.0 < h.max() < 10800.0


@pytest.mark.parametrize("linear", [True, False])
def test_solid_body_flow_is_balanced_by_its_known_depth(linear: bool) -> None:
    """g h = const - (a Ω u0 + u0²/2) sin² θ; without the square for the linear balance."""
    psi, speed = np.zeros((2, 2), dtype=np.complex128), 30.0
    psi[1, 0] = -EARTH.radius * speed / np.sqrt(3.0)
    lon, lat = points()
    u, v, h = BalancedFlow(psi, EARTH, 5e3, linear).state(lon, lat)
    np.testing.assert_allclose(u, speed * np.cos(lat), atol=1e-11)
    fall = EARTH.radius * EARTH.rotation * speed + (0.0 if linear else 0.5 * speed**2)
    expected = 5e3 + fall * (1.0 / 3.0 - np.sin(lat) ** 2) / EARTH.gravity
    np.testing.assert_allclose(h, expected, rtol=1e-12)
    assert not v.any()


def analysis(path: Path, change: Callable[[netCDF4.Dataset], None] | None = None, **how) -> Path:
    """A file with the Rossby-Haurwitz wave on a grid."""
    degrees = how.get("lat", np.linspace(88.75, -88.75, 72))
    lon = how.get("lon", np.arange(144) * 2.5)
    around, up = np.meshgrid(np.radians(lon), np.radians(degrees))
    u, v, h = how.get("scene", get_scene("williamson6")).initial(around, up)
    with netCDF4.Dataset(path, "w") as file:
        for name, values in {"lat": degrees, "lon": lon}.items():
            file.createDimension(name, len(values))
            file.createVariable(name, "f8", (name,))[:] = values
            file[name].units = "degrees"
        file.createDimension("time", 1)
        units = {"u": "m s-1", "v": "m s-1", "z": "m"}
        for (name, unit), values in zip(units.items(), (u, v, h), strict=True):
            if name == how.get("without"):
                continue
            file.createVariable(name, "f8", ("time", "lat", "lon"), fill_value=-999.0)[0] = values
            file[name].units = unit
        if change is not None:
            change(file)
    return path


GRIDS = {
    "regular": {},
    "with poles": {"lat": np.linspace(-90.0, 90.0, 73)},
    "from -180": {"lon": np.arange(144) * 2.5 - 180.0},
    "gaussian": {"lat": np.degrees(np.arcsin(np.polynomial.legendre.leggauss(72)[0]))},
}


@pytest.mark.parametrize("grid", GRIDS)
def test_analysis_is_read_and_interpolated(tmp_path: Path, grid: str) -> None:
    scene = get_scene("williamson7", file=str(analysis(tmp_path / "a.nc", **GRIDS[grid])))
    mesh = Mesh.build(4, 5, spin=17.0)
    expected = get_scene("williamson6").initial(mesh.lon, mesh.lat)
    for ours, theirs in zip(scene.initial(mesh.lon, mesh.lat)[:2], expected[:2], strict=True):
        np.testing.assert_allclose(ours, theirs, atol=0.02)
    depth = scene.initial(mesh.lon, mesh.lat)[2]
    assert np.average(depth, weights=mesh.area) == pytest.approx(1e4, abs=2.0)
    shift = depth - expected[2]
    assert np.ptp(shift) < 0.3
    assert scene.title == "500 hPa flow from a.nc"
    assert scene.parameters["file"] == str(tmp_path / "a.nc")


@pytest.mark.parametrize("grid", GRIDS)
def test_analysis_is_smooth_over_the_poles(tmp_path: Path, grid: str) -> None:
    """A wind of 30 m/s across the poles, read within four degrees of them."""
    flow = get_scene("williamson2", alpha=0.9)
    path = analysis(tmp_path / "a.nc", scene=flow, **GRIDS[grid])
    lon, lat = points()
    lat = np.sign(lat) * (np.pi / 2.0 - 0.045 * np.abs(lat))
    expected = flow.initial(lon, lat)
    assert np.hypot(*expected[:2]).max() > 28.0
    found = get_scene("williamson7", file=path).initial(lon, lat)
    for ours, theirs in zip(found, expected, strict=True):
        assert np.ptp(ours - theirs) < 1e-3


def test_geopotential_and_transposed_fields_are_read(tmp_path: Path) -> None:
    def change(file: netCDF4.Dataset) -> None:
        file.renameVariable("z", "old")
        z = file.createVariable("z", "f8", ("lon", "lat"))
        z[:] = file["old"][0].T * EARTH.gravity
        z.units = "m2 s-2"
        file.renameVariable("lat", "latitude")

    lon, lat = points()
    plain = get_scene("williamson7", file=analysis(tmp_path / "a.nc")).initial(lon, lat)
    other = get_scene("williamson7", file=analysis(tmp_path / "b.nc", change)).initial(lon, lat)
    np.testing.assert_allclose(plain, other, atol=1e-8)


SAMPLE = Path(__file__).with_name("data") / "analysis.nc"
"""A state of this model, in a file like those of ERA5: see benchmarks/analysis_sample.py."""


def test_the_sample_is_read_as_era5_writes_it() -> None:
    u, v, h = get_scene("williamson7", file=SAMPLE).initial(*points(3000))
    assert 30.0 < np.hypot(u, v).max() < 80.0 and 8000.0 < h.min() < h.max() < 11000.0


def test_names_of_ncep_and_one_of_several_levels(tmp_path: Path) -> None:
    """Two levels, of which that of 500 hPa is the second; or one, which must be that."""

    def change(file: netCDF4.Dataset, pressures=(850.0, 500.0)) -> None:
        file.createDimension("level", len(pressures))
        file.createVariable("level", "f4", ("level",))[:] = pressures
        file["level"].units = "millibar"
        for ours, name in {"u": "uwnd", "v": "vwnd", "z": "hgt"}.items():
            values, units = file[ours][:], file[ours].units
            file.renameVariable(ours, f"old_{ours}")
            stacked = file.createVariable(name, "f8", ("time", "level", "lat", "lon"))
            stacked[:] = np.stack([0.0 * values, values][-len(pressures) :], axis=1)
            stacked.units = units

    lon, lat = points()
    plain = get_scene("williamson7", file=analysis(tmp_path / "a.nc")).initial(lon, lat)
    other = get_scene("williamson7", file=analysis(tmp_path / "b.nc", change)).initial(lon, lat)
    np.testing.assert_array_equal(plain, other)
    alone = analysis(tmp_path / "alone.nc", partial(change, pressures=(500.0,)))
    np.testing.assert_array_equal(plain, get_scene("williamson7", file=alone).initial(lon, lat))
    for pressures in ((850.0, 700.0), (850.0,)):
        with pytest.raises(ConfigError, match="level lacks the level of 500 hPa"):
            path = tmp_path / f"{len(pressures)}.nc"
            get_scene("williamson7", file=analysis(path, partial(change, pressures=pressures)))


def test_a_filtered_analysis_has_nothing_above_its_degree() -> None:
    grid = GaussGrid(20)
    u, v, h = get_scene("williamson7", file=SAMPLE, degree=12).initial(*grid.points)
    for found in (grid.coefficients(h), grid.against_gradients(u, v)):
        assert np.abs(found[13:]).max() < 1e-10 * np.abs(found[1:13]).max()


@pytest.mark.parametrize("balanced", [False, True])
def test_what_is_smooth_and_balanced_stays_as_it_is(tmp_path: Path, balanced: bool) -> None:
    """The Rossby-Haurwitz wave, which is of degree 10 at the most; to the errors of the splines."""
    path = analysis(tmp_path / "a.nc")
    lon, lat = points()
    expected = get_scene("williamson6").initial(lon, lat)
    given = {"file": path, "degree": 12, "balanced": balanced}
    found = get_scene("williamson7", **given).initial(lon, lat)
    for ours, theirs, error in zip(found, expected, (0.02, 0.02, 0.3), strict=True):
        assert np.ptp(ours - theirs) < error
    for degree in (-1, 1001):
        with pytest.raises(ConfigError, match="degree must be from 0 to 1000"):
            get_scene("williamson7", file=path, degree=degree)
    for filtered in ({"degree": 12}, {"balanced": True}):
        with pytest.raises(ConfigError, match="give a file too"):
            get_scene("williamson7", **filtered)


def test_a_balanced_analysis_has_no_divergence(tmp_path: Path) -> None:
    grid = GaussGrid(20)
    plain, balanced = (
        grid.against_gradients(*state.initial(*grid.points)[:2])
        for state in (
            get_scene("williamson7", file=SAMPLE, degree=12),
            get_scene("williamson7", file=SAMPLE, degree=12, balanced=True),
        )
    )
    assert np.abs(balanced).max() < 1e-10 * np.abs(plain).max()


def spoil(name: str, **attributes: str) -> Callable[[netCDF4.Dataset], None]:
    return lambda file: file[name].setncatts(attributes)


def hole(file: netCDF4.Dataset) -> None:
    file["u"][0, 3, 4] = np.nan
    file["u"][0, 3, 5] = -999.0


def tall(file: netCDF4.Dataset) -> None:
    file["z"][:] = file["z"][:] * 9.8


BAD = {
    "there is no variable v or vwnd or va; u, v and z are needed": {"without": "v"},
    "z must have units 'm' (height) or 'm2 s-2' (geopotential), got 'K'": {
        "change": spoil("z", units="K")
    },
    "u must have units 'm s-1', got 'knots'": {"change": spoil("u", units="knots")},
    "damaged, or not a netCDF file": {"change": spoil("lat", units=3.0)},
    "lat must be in degrees, got 'radians'": {"change": spoil("lat", units="radians")},
    "u has 2 missing or infinite values; there must be none": {"change": hole},
    "z varies by more than 10 km": {"change": tall},
    "lat must reach the poles; 30 degrees are missing": {"lat": np.linspace(-60.0, 60.0, 49)},
    "lat must rise or fall from pole to pole": {"lat": np.r_[0.0:90.0:2.5, -90.0:0.0:2.5]},
    "lat must lie between -90 and 90, got 95": {"lat": np.linspace(-85.0, 95.0, 73)},
    "lon must be 144 equal steps of 2.5 degrees eastward": {"lon": np.arange(144) * 2.4},
    "lon must be an even number of values, got 145": {"lon": np.arange(145) * 2.5},
    "lon must have one dimension and at least 8 values": {"lon": np.arange(4) * 90.0},
}


@pytest.mark.parametrize("message", BAD)
def test_bad_analysis(tmp_path: Path, message: str) -> None:
    path = analysis(tmp_path / "bad.nc", **BAD[message])
    with pytest.raises(ConfigError, match=re.escape(message)) as caught:
        get_scene("williamson7", file=path)
    assert "\n" not in str(caught.value) and "bad.nc" in str(caught.value)


def test_analysis_with_levels_or_without_a_file(tmp_path: Path) -> None:
    def levels(file: netCDF4.Dataset) -> None:
        file.createDimension("level", 2)
        file.renameVariable("u", "old")
        file.createVariable("u", "f8", ("level", "lat", "lon")).units = "m/s"

    with pytest.raises(ConfigError, match=r"u must be on \(lat, lon\), got \(level=2, lat=72"):
        get_scene("williamson7", file=analysis(tmp_path / "a.nc", levels))
    with pytest.raises(ConfigError, match=r"cannot read absent\.nc: No such file"):
        get_scene("williamson7", file="absent.nc")
    (tmp_path / "text.nc").write_text("no netCDF")
    with pytest.raises(ConfigError, match=r"cannot read .*text\.nc: "):
        get_scene("williamson7", file=tmp_path / "text.nc")


def test_a_damaged_analysis(tmp_path: Path) -> None:
    path, plain = tmp_path / "bad.nc", xr.open_dataset(analysis(tmp_path / "a.nc"))
    plain.to_netcdf(path, encoding={name: {"zlib": True} for name in "uvz"})
    with path.open("r+b") as file:
        for tenth in range(2, 9):
            file.seek(path.stat().st_size * tenth // 10)
            file.write(bytes(1000))
    with pytest.raises(ConfigError, match=r"cannot read .*bad\.nc: damaged"):
        get_scene("williamson7", file=path)
