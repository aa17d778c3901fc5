"""Errors against references and between files on different grids."""

import json
from dataclasses import replace

import netCDF4
import numpy as np
import pytest
import xarray as xr

from swe_sphere.analysis.accessor import open_run
from swe_sphere.equations.effects import Forcing, Orography, Viscosity
from swe_sphere.errors import ConfigError
from swe_sphere.io.integrals import norms
from swe_sphere.io.netcdf import FrameWriter
from swe_sphere.io.reference_solution import (
    SHIPPED,
    OnGrid,
    Reference,
    compare,
    latitude_weights,
)
from swe_sphere.mesh import Mesh
from swe_sphere.planet import DAY
from swe_sphere.simulation.build import shipped_solution
from swe_sphere.simulation.config import Output
from swe_sphere.simulation.simulation import Simulation
from swe_sphere.testcases import get_scene

REFERENCES = sorted(SHIPPED.glob("*_day*.nc"))


def smooth(lon, lat):
    """A flow across the poles and a height, both smooth on the sphere."""
    u = 20.0 * np.cos(lat) + 10.0 * np.sin(lat) * np.cos(lon)
    v = -10.0 * np.sin(lon)
    h = 5000.0 + 300.0 * np.sin(lat) * np.cos(lat) ** 4 * np.cos(4.0 * lon) - 200.0 * np.sin(lat)
    return {"u": u, "v": v, "h": h - 200.0 * np.cos(lat) ** 2, "vorticity": 1e-5 * np.sin(lat)}


def nodal(mesh):
    return smooth(mesh.lon, mesh.lat) | {"divergence": np.zeros(mesh.size)}


def write_run(path, mesh, fields, bottom=0.0, time=5.0 * DAY, scene="smooth", sources="{}"):
    attributes = {"title": "smooth", "scene": scene, "sources": sources}
    with FrameWriter(path, mesh, attributes, bottom) as writer:
        writer.write(0.0, {name: 0.5 * values for name, values in fields.items()})
        writer.write(time, fields)
    return path


def write_grid(path, rows=64, extra=0.0, title="smooth, day 5"):
    """The smooth state on a Gaussian grid, as a reference of the free surface."""
    lat = np.arcsin(np.polynomial.legendre.leggauss(rows)[0])[::-1]
    lon = 2.0 * np.pi / (2 * rows) * np.arange(2 * rows)
    fields = smooth(*np.meshgrid(lon, lat))
    fields["surface_height"] = fields.pop("h") + extra
    with netCDF4.Dataset(path, "w") as data:
        data.title = title
        for name, values in {"lat": np.degrees(lat), "lon": np.degrees(lon)}.items():
            data.createDimension(name, values.size)
            data.createVariable(name, "f8", (name,))[:] = values
        for name, values in fields.items():
            data.createVariable(name, "f8", ("lat", "lon"))[:] = values
    return path


def test_gauss_weights_are_recognised():
    nodes, weights = np.polynomial.legendre.leggauss(40)
    lat = np.arcsin(nodes)
    np.testing.assert_allclose(latitude_weights(lat), weights / 2.0, rtol=1e-12)
    np.testing.assert_allclose(latitude_weights(lat[::-1]), weights[::-1] / 2.0, rtol=1e-12)


@pytest.mark.parametrize("order", [1, -1])
def test_weights_of_other_latitudes_are_zones(order):
    lat = np.radians(np.linspace(-88.0, 88.0, 45))[::order]
    edges = np.radians(np.linspace(-90.0, 90.0, 46))[::order]
    bounds = np.stack([edges[:-1], edges[1:]], axis=1)
    exact = np.abs(np.diff(np.sin(edges))) / 2.0
    np.testing.assert_allclose(latitude_weights(lat, bounds), exact, rtol=1e-12)
    assert latitude_weights(lat).sum() == pytest.approx(1.0)
    # second order: (4°)²/3 = 1.6e-3
    assert latitude_weights(lat) @ np.sin(lat) ** 2 == pytest.approx(1.0 / 3.0, rel=2e-3)


def test_a_grid_is_evaluated_anywhere(tmp_path):
    reference = Reference(write_grid(tmp_path / "grid.nc"))
    generator = np.random.default_rng(1)
    lon, lat = generator.uniform(-4.0, 8.0, 500), np.arcsin(generator.uniform(-1.0, 1.0, 500))
    lat[:3] = [0.5 * np.pi, -0.5 * np.pi, 1.5707]
    expected = smooth(lon, lat)
    assert np.abs(reference.at("surface", lon, lat) - expected["h"]).max() < 1e-5
    for name in "uv":
        assert np.abs(reference.at(name, lon, lat) - expected[name]).max() < 1e-9
    assert reference.frame_time(None) == 5.0 * DAY


def test_errors_of_a_spectral_element_solution(tmp_path):
    path = write_grid(tmp_path / "grid.nc")
    mesh = Mesh.build(6, 8, stretch=1.3, centre=(23.0, 29.0))
    fields = nodal(mesh)
    for name in ("surface", "vorticity", "wind", "u", "speed"):
        reference = Reference(path)
        pair = OnGrid(reference, mesh).pair(fields, name)
        assert norms(reference.area, *pair)["linf"] < 1e-8, name
    wrong = fields | {"h": 1.01 * fields["h"]}
    for value in OnGrid(Reference(path), mesh).errors(wrong, "h")["h"].values():
        assert value == pytest.approx(0.01, rel=1e-5)


def test_one_component_of_the_wind_is_compared_on_equal_meshes(tmp_path):
    files = [tmp_path / "a.nc", tmp_path / "b.nc"]
    for file, dt in zip(files, (864.0, 432.0), strict=True):
        sim = Simulation("williamson5", ne=2, np=4, days=0.1, dt=dt, fields=["u"])
        sim.run(out=file)
    assert compare(*files, "u")["l2"] > 0.0 == compare(files[0], files[0], "u")["l2"]


def test_the_title_of_a_reference_states_a_fraction_of_a_day(tmp_path):
    reference = Reference(write_grid(tmp_path / "grid.nc", title="smooth, day 2.5"))
    assert reference.frame_time(None) == 2.5 * DAY


def test_the_correlation_is_that_over_the_sphere(tmp_path):
    """A field of sin(lat) and one of sin(lat)**3 have the correlation sqrt(21)/5."""
    mesh = Mesh.build(6, 8)
    fields = nodal(mesh) | {"vorticity": np.sin(mesh.lat) ** 3}
    found = OnGrid(Reference(write_grid(tmp_path / "grid.nc")), mesh).decorrelation(fields)
    assert found == pytest.approx(1.0 - np.sqrt(21.0) / 5.0, rel=1e-5)


def test_surface_is_compared_over_orography(tmp_path):
    path = write_grid(tmp_path / "grid.nc", extra=700.0)
    mesh = Mesh.build(4, 8)
    fields = nodal(mesh) | {"b": np.full(mesh.size, 700.0)}
    grid = OnGrid(Reference(path), mesh)
    assert grid.errors(fields, "surface")["h"]["l2"] < 1e-6
    Simulation("williamson5", ne=2, np=4, days=0.0).run(out=tmp_path / "run.nc")
    with pytest.raises(ConfigError, match="holds the free surface, not the depth: compare"):
        compare(tmp_path / "run.nc", path, "h", 0.0)


@pytest.mark.parametrize("path", REFERENCES, ids=lambda path: path.stem)
def test_bundled_references(path):
    reference = Reference(path)
    assert reference.title.startswith(path.stem.split("_day")[0])
    assert f"{reference.frame_time(None) / DAY:g}" == path.stem.split("_day")[1]
    assert reference.area.sum() == pytest.approx(1.0, rel=1e-12)
    assert all(name in reference.attributes for name in ("source", "uncertainty", "reduction"))
    surface, vorticity = reference.values("surface"), reference.values("vorticity")
    assert 4900.0 < surface.min() < surface.max() < 10900.0
    assert abs(reference.area @ vorticity) < 1e-3 * np.abs(vorticity).max()


def test_there_are_all_references():
    assert len(REFERENCES) == 7


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """The same state on two meshes, and on the second also with a height 1 % larger."""
    folder = tmp_path_factory.mktemp("runs")
    first, second = Mesh.build(6, 6), Mesh.build(5, 8, stretch=1.4, centre=(57.0, 17.0), spin=11.0)
    larger = nodal(second) | {"h": 1.01 * nodal(second)["h"]}
    return {
        "first": write_run(folder / "first.nc", first, nodal(first)),
        "second": write_run(folder / "second.nc", second, nodal(second)),
        "larger": write_run(folder / "larger.nc", second, larger),
        "grid": write_grid(folder / "grid.nc"),
    }


@pytest.mark.parametrize("field", ["h", "wind", "u", "speed", "vorticity"])
def test_the_same_state_on_two_meshes(runs, field):
    for pair in (("first", "second"), ("second", "first")):
        found = compare(*(runs[name] for name in pair), field)
        assert found["field"] == field and found["time"] == 5.0 * DAY
        assert 0.0 < found["linf"] < 2e-7, pair


def test_one_per_cent_is_seen(runs):
    for a, b, sign in (("larger", "first", 1.0), ("first", "larger", 1.0 / 1.01)):
        found = compare(runs[a], runs[b])
        for norm in ("l1", "l2", "linf"):
            assert found[norm] == pytest.approx(0.01 * sign, rel=1e-5)


def test_the_same_mesh_is_not_interpolated(runs):
    assert compare(runs["second"], runs["second"])["linf"] == 0.0


def test_runs_and_grids_compare_both_ways(runs):
    for pair in (("first", "grid"), ("grid", "first"), ("grid", "grid")):
        found = compare(*(runs[name] for name in pair))
        assert found["field"] == "surface" and found["time"] == 5.0 * DAY
        assert found["linf"] < 2e-7, pair


def test_one_frame_of_a_regridded_run_is_a_reference(runs, tmp_path):
    """The time in such a file is a scalar."""
    one = tmp_path / "one.nc"
    open_run(runs["first"]).swe.to_latlon(19, 36).isel(time=-1).to_netcdf(one)
    for time in (None, 5.0 * DAY):
        found = compare(runs["first"], one, time=time)
        assert found["time"] == 5.0 * DAY and found["linf"] < 1e-12
    sim = Simulation("williamson5", ne=2, days=5, reference=one)
    assert sim.reference.frame_time(None) == 5.0 * DAY


def test_time_is_that_asked_for(runs, tmp_path):
    grid = write_grid(tmp_path / "grid.nc", title="smooth")  # of no time
    assert compare(runs["first"], grid, "h", time=0.0)["l2"] == pytest.approx(0.5, rel=1e-4)
    with pytest.raises(ConfigError, match="no frame at day 0: the last ones are at day 5"):
        compare(runs["first"], runs["grid"], "h", time=0.0)
    with pytest.raises(ConfigError, match="no frame at day 3: the last ones are at day 0, 5"):
        compare(runs["first"], runs["second"], time=3.0 * DAY)


def test_runs_of_different_scenes_are_compared_only_when_asked(runs, tmp_path):
    mesh = Mesh.build(6, 6)
    other = write_run(tmp_path / "other.nc", mesh, nodal(mesh), scene="rough")
    with pytest.raises(ConfigError, match=r"first.nc is a run of smooth, .* one of rough: .*"):
        compare(runs["first"], other)
    assert compare(runs["first"], other, across_scenes=True)["linf"] == 0.0


def test_so_are_runs_of_two_scenes_of_one_name(runs, tmp_path):
    mesh = Mesh.build(6, 6)
    sources = json.dumps({"the scene's file": "1f"})
    other = write_run(tmp_path / "other.nc", mesh, nodal(mesh), sources=sources)
    with pytest.raises(ConfigError, match=r"are runs of two scenes named smooth.*--across"):
        compare(runs["first"], other)
    assert compare(other, other)["linf"] == 0.0
    assert compare(runs["first"], other, across_scenes=True)["linf"] == 0.0


def test_the_time_is_the_last_that_both_runs_have(runs, tmp_path):
    mesh = Mesh.build(6, 6)
    later = write_run(tmp_path / "later.nc", mesh, nodal(mesh), time=6.0 * DAY)
    for pair in ((runs["first"], later), (later, runs["first"])):
        found = compare(*pair)
        assert (found["time"], found["linf"]) == (0.0, 0.0)
    with FrameWriter(tmp_path / "apart.nc", mesh, {}) as writer:
        writer.write(3600.0, nodal(mesh))
    with pytest.raises(ConfigError, match="have no common time"):
        compare(runs["first"], tmp_path / "apart.nc")


def test_files_are_compared_with_weights_of_areas(tmp_path):
    mesh = Mesh.build(4, 4, stretch=2.0)
    fields = nodal(mesh)
    others = fields | {"h": fields["h"] * (1.0 + 0.01 * (mesh.lat > 0.5))}
    ours = write_run(tmp_path / "ours.nc", mesh, fields)
    found = compare(ours, write_run(tmp_path / "theirs.nc", mesh, others))
    for norm, value in norms(mesh.area, fields["h"], others["h"]).items():
        assert found[norm] == pytest.approx(value, rel=1e-12)


def test_the_depth_of_a_reference_is_compared_with_that_of_the_run(tmp_path):
    """The bottom is not flat, and the surface is the error field of the scene."""
    run, grid = tmp_path / "run.nc", tmp_path / "grid.nc"
    depth, reference = tmp_path / "depth.nc", tmp_path / "surface.nc"
    values = {"ne": 2, "np": 4, "dt": 900.0, "days": 0.0625}
    Simulation("williamson5", **values, outputs=[Output(grid, grid="latlon:32x64")]).run(out=run)
    with xr.open_dataset(grid) as data:
        last = data.isel(time=-1)
        last[["h", "u", "v"]].to_netcdf(depth)
        (last.h + last.b).rename("surface").to_dataset().to_netcdf(reference)
        last[["u", "v"]].to_netcdf(tmp_path / "wind.nc")
    for file in (depth, reference):
        assert Simulation("williamson5", **values, reference=file).run()["l2_h"] < 1e-6
    assert compare(run, depth, "h")["l2"] < 1e-6
    with pytest.raises(ConfigError, match=r"depth.nc holds the depth alone: compare field 'h'"):
        compare(run, depth, "surface")
    with pytest.raises(ConfigError, match=r"depth.nc holds the depth alone: compare field 'h'"):
        compare(depth, grid, "surface")
    with pytest.raises(ConfigError, match=r"wind.nc holds neither h nor surface"):
        Simulation("williamson5", **values, reference=tmp_path / "wind.nc")
    with pytest.raises(ConfigError, match="is a file that the run reads"):
        Simulation("williamson5", **values, reference=depth).run(out=depth, overwrite=True)


def test_a_grid_of_a_hemisphere(tmp_path):
    lat, lon, path = np.arange(2.5, 90.0, 5.0), np.arange(0.0, 360.0, 5.0), tmp_path / "half.nc"
    half = xr.Dataset({"h": (("lat", "lon"), np.ones((18, 72)))}, {"lat": lat, "lon": lon})
    half.to_netcdf(path)
    with pytest.raises(ConfigError, match="latitudes must reach from pole to pole"):
        Reference(path)
    bounds = np.stack([lat - 2.5, lat + 2.5], axis=1)
    half.assign(lat_bnds=(("lat", "two"), bounds)).to_netcdf(path)
    with pytest.raises(ConfigError, match="latitudes must reach from pole to pole"):
        Reference(path)
    whole = half.reindex(lat=np.arange(-87.5, 90.0, 5.0), fill_value=1.0)
    whole.to_netcdf(path)
    assert Reference(path).area.sum() == pytest.approx(1.0)


def test_coordinates_of_no_grid_are_refused_in_one_line(tmp_path):
    lat, lon = np.arange(-85.0, 90.0, 10.0), np.arange(0.0, 360.0, 10.0)
    whole = xr.Dataset({"h": (("lat", "lon"), np.ones((18, 36)))}, {"lat": lat, "lon": lon})
    bounds = np.stack([lat - 5.0, lat + 5.0], axis=1)
    faults = {
        "is damaged": whole.assign(lat_bnds=("lat", np.linspace(-90.0, 90.0, 18))),
        "pole to pole": whole.assign_coords(lat=np.where(lat == 5.0, np.nan, lat)),
        "to pole": whole.assign_coords(lat=np.where(lat == 5.0, np.nan, lat)).assign(
            lat_bnds=(("lat", "two"), bounds)
        ),
        "pole to": whole.assign(lat_bnds=(("lat", "two"), np.full_like(bounds, np.nan))),
        "damaged": whole.isel(lon=slice(0)),
    }
    for number, (message, data) in enumerate(faults.items()):
        data.to_netcdf(path := tmp_path / f"{number}.nc")
        with pytest.raises(ConfigError, match=message):
            Reference(path)


def test_fields_that_are_not_there(runs):
    with pytest.raises(ConfigError, match="did you mean 'vorticity'"):
        compare(runs["first"], runs["second"], "vortisity")
    with pytest.raises(ConfigError, match="'divergence' is missing"):
        compare(runs["first"], runs["grid"], "divergence")


def test_a_grid_that_is_not_global(tmp_path):
    path = tmp_path / "part.nc"
    with netCDF4.Dataset(path, "w") as data:
        for name, values in {"lat": [-10.0, 0.0, 10.0], "lon": [0.0, 10.0, 20.0, 30.0]}.items():
            data.createDimension(name, len(values))
            data.createVariable(name, "f8", (name,))[:] = values
        data.createVariable("surface_height", "f8", ("lat", "lon"))[:] = 1.0
    with pytest.raises(ConfigError, match="evenly spaced eastward"):
        Reference(path)


def test_a_grid_that_goes_westward(tmp_path):
    """Its field would be drawn and compared as in a mirror."""
    path = write_grid(tmp_path / "grid.nc")
    with netCDF4.Dataset(path, "a") as data:
        data["lon"][:] = data["lon"][::-1].copy()
    with pytest.raises(ConfigError, match="evenly spaced eastward"):
        Reference(path)


def test_williamson5_references_differ_in_time():
    """The reduced files give the norms of the full ones (l2 1.46991e-2, linf 6.7463e-2)."""
    early, late = (Reference(SHIPPED / f"williamson5_day{day}.nc") for day in (5, 15))
    found = norms(early.area, early.values("surface"), late.values("surface"))
    assert found["l2"] == pytest.approx(1.46991e-2, rel=1e-3)
    assert found["linf"] == pytest.approx(6.7463e-2, rel=1e-3)


def test_only_what_is_shipped_is_found():
    scene = get_scene("williamson5")
    assert shipped_solution(scene, 15.0) == SHIPPED / "williamson5_day15.nc"
    assert shipped_solution(scene, 3.0) is None


def test_a_reference_of_another_time_is_not_compared(tmp_path) -> None:
    """It is of one time, which its title tells."""
    reference = Reference(SHIPPED / "williamson5_day15.nc")
    assert reference.frame_time(None) == reference.frame_time(15 * DAY) == 15 * DAY
    with pytest.raises(ConfigError, match="no frame at day 5: the last ones are at day 15"):
        reference.frame_time(5 * DAY)


def test_a_run_takes_its_errors_against_the_reference_of_the_package():
    """At the day of the reference, and only of the very scene that it is of."""
    small = {"ne": 2, "np": 4}
    summary = Simulation("williamson5", **small).run(days=5)
    path = SHIPPED / "williamson5_day5.nc"
    given = Simulation("williamson5", reference=path, **small).run(days=5)
    named = ("l1_h", "l2_h", "linf_h", "l2_v", "reference")
    assert [summary[name] for name in named] == [given[name] for name in named]
    assert summary["reference"] == "williamson5_day5.nc" and summary["l2_h"] < 1e-2
    assert ("errors against", "williamson5_day5.nc") in summary.rows()
    assert Simulation("williamson5", **small).run(days=0.5)["l2_h"] is None
    scene = get_scene("williamson5")
    slow = replace(scene, initial=lambda lon, lat: tuple(0.9 * x for x in scene.initial(lon, lat)))
    assert shipped_solution(scene, 15.0) == SHIPPED / "williamson5_day15.nc"
    assert shipped_solution(slow, 15.0) is None
    assert shipped_solution(replace(scene, title="Flow over a mountain", ne=9), 15.0)
    dragged = Simulation("williamson5", effects={"drag.linear": 1e-6}, **small)
    assert dragged.run(days=5)["l2_h"] is None
    viscous = get_scene("galewsky").with_effect(Viscosity(1e5))
    assert shipped_solution(viscous, 6.0) == SHIPPED / "galewsky_viscous_day6.nc"


def hill(lon, lat):
    """A change in one place, which most points do not see."""
    return 5.0 * np.exp(-900.0 * ((lon - 1.0) ** 2 + (lat - 1.0) ** 2))


@pytest.mark.parametrize("name", ["williamson5", "williamson6", "galewsky"])
def test_a_scene_with_another_function_is_not_compared_with_the_reference_of_the_package(name):
    """The bottom, the forcing and the rotation decide, also where they differ in one place."""
    scene = get_scene(name)
    day = 6.0 if name == "galewsky" else 14.0 if name == "williamson6" else 15.0
    assert shipped_solution(scene, day) is not None
    bottom, coriolis = scene.bottom or (lambda lon, lat: 0.0), scene.coriolis
    effects = (*(e for e in scene.effects if e.name not in ("orography", "forcing")),)
    changed = [
        replace(scene, initial=lambda lon, lat: (*scene.initial(lon, lat)[:2],
                                                 scene.initial(lon, lat)[2] + hill(lon, lat))),
        replace(scene, coriolis=lambda lon, lat: coriolis(lon, lat) + 1e-9 * hill(lon, lat)),
        replace(scene, bottom=lambda lon, lat: bottom(lon, lat) + hill(lon, lat),
                effects=(*effects, Orography())),
        replace(scene, forcing=lambda lon, lat, t: (0.0, 0.0, 1e-6),
                effects=(*scene.effects, Forcing())),
    ]  # fmt: skip
    assert [shipped_solution(each, day) for each in changed] == [None] * 4
    if scene.bottom:
        higher = replace(scene, bottom=lambda lon, lat: bottom(lon, lat) + hill(lon, lat))
        assert shipped_solution(higher, day) is None
        assert Simulation(higher, ne=2, np=4).run(days=day / 3)["l2_h"] is None


def test_a_reference_of_one_day_has_no_frame_of_another():
    reference = Reference(SHIPPED / "williamson5_day5.nc")
    assert reference.frame(5.0 * DAY).keys() == reference.frame().keys()
    with pytest.raises(ConfigError, match="holds no frame at day 6: the last ones are at day 5"):
        reference.frame(6.0 * DAY)


def test_the_summary_has_errors_at_the_time_of_the_reference_only(tmp_path):
    path, small = tmp_path / "day.nc", {"ne": 2, "np": 4, "dt": 1800.0}
    grid = [Output(path, grid="gaussian:12", every=6.0)]
    Simulation("williamson6", **small).run(days=0.25, outputs=grid)
    sim = Simulation("williamson6", reference=path, **small)
    sim.run(days=0.25)
    assert 0.0 < sim.summary["l2_h"] < 1e-2
    sim.step()
    assert sim.summary["l2_h"] is None
    Simulation("williamson6", **small).run(days=0.25, out=tmp_path / "run.nc")
    with pytest.raises(ConfigError, match="regrid the file of a run"):
        Simulation("williamson6", reference=tmp_path / "run.nc", **small)
