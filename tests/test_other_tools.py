"""Files of runs in tools that know nothing of this model; each needs the tool."""

import shutil
import subprocess

import cartopy.crs as crs
import numpy as np
import pytest
import xarray as xr
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.quiver import Quiver
from support import Frame

from swe_sphere import open_run
from swe_sphere.errors import ConfigError
from swe_sphere.io.netcdf import FrameWriter
from swe_sphere.mesh import Mesh
from swe_sphere.mesh.sphere import position
from swe_sphere.pictures.look import Look
from swe_sphere.pictures.plot import draw_state


@pytest.fixture(scope="module")
def mesh():
    return Mesh.build(6, 6, spin=17.0)


@pytest.fixture(scope="module")
def run(mesh, tmp_path_factory):
    """A file of a depth without any symmetry."""
    path = tmp_path_factory.mktemp("tools") / "run.nc"
    x, y, z = mesh.xyz.T
    h = 1000.0 * np.exp(0.3 * x + 0.5 * y * z - 0.4 * z)
    fields = dict.fromkeys(("u", "v", "vorticity", "divergence"), 0.0 * h) | {"h": h}
    with FrameWriter(path, mesh, {"title": "bulges"}, 0.1 * h, coriolis=1e-4 * z) as writer:
        for k in range(2):
            writer.write(600.0 * k, fields, {"mass": 1.0})
        writer.finish({"completed": True})
    return path


KNOWN = {
    # a cell around a pole: longitude and latitude of its corners do not enclose it
    "2 point(s) specified by the coordinate variable 'lat' lie outside the bounding box of the"
    " associated boundary variable 'lat_bnds'",
    # roles of UGRID, which CF-1.11 takes in and the checker does not know
    "mesh_topology is not a valid cf_role value. It must be one of timeseries_id, profile_id,"
    " trajectory_id",
    "face_node_connectivity is not a valid cf_role value. It must be one of timeseries_id,"
    " profile_id, trajectory_id",
    "There may only be one variable containing the cf_role attribute. Currently the following"
    " variables have cf_role attributes: ['mesh', 'face_nodes']",
}


def test_the_file_is_what_cf_asks_for(run):
    runner = pytest.importorskip("compliance_checker.runner")
    runner.CheckSuite.load_all_available_checkers()
    suite = runner.CheckSuite()
    with suite.load_dataset(str(run)) as dataset:
        ((results, failed),) = suite.run_all(dataset, ["cf:1.11"]).values()
    assert len(results) > 20 and not failed
    assert {message for result in results for message in messages(result)} == KNOWN


def messages(result):
    """Of what is not as it should be; the checker also says what is."""
    scored, possible = result.value if isinstance(result.value, tuple) else (result.value, True)
    if scored < possible:
        yield from result.msgs or ()
    for child in result.children or ():
        yield from messages(child)


@pytest.mark.skipif(shutil.which("cdo") is None, reason="cdo is not installed")
def test_cdo_remaps_and_keeps_the_integral(run, mesh, tmp_path):
    out = tmp_path / "grid.nc"
    command = ["cdo", "-s", "remapcon,r72x36", "-selname,h", str(run), str(out)]
    subprocess.run(command, check=True, capture_output=True)
    with xr.open_dataset(run) as before, xr.open_dataset(out) as after:
        zones = np.diff(np.sin(np.radians(np.linspace(-90.0, 90.0, 37))))
        found = np.average(after.h.mean("lon").isel(time=-1), weights=zones)
        assert np.ptp(after.h.values) > 900.0
        assert found == pytest.approx(np.average(before.h[-1], weights=mesh.area), rel=1e-6)


def test_the_reader_of_paraview_sees_the_quads_and_their_values(run, mesh):
    vtk_netcdf = pytest.importorskip("vtkmodules.vtkIONetCDF")
    from vtkmodules.util.numpy_support import vtk_to_numpy

    reader = vtk_netcdf.vtkNetCDFUGRIDReader()
    reader.SetFileName(str(run))
    reader.UpdateTimeStep(600.0)
    grid = reader.GetOutput()
    assert grid.GetNumberOfCells() == 6 * 6**2 * 5**2
    with xr.open_dataset(run) as data:
        for name in ("h", "b", "area"):
            found = vtk_to_numpy(grid.GetPointData().GetArray(name))
            np.testing.assert_array_equal(found, data[name].values.reshape(-1, mesh.size)[-1])
    lon, lat, _ = np.radians(vtk_to_numpy(grid.GetPoints().GetData())).T
    corners = position(lon, lat)[vtk_to_numpy(grid.GetCells().GetConnectivityArray())]
    areas = sum(triangles(*(corners.reshape(-1, 4, 3)[:, k].T for k in half)) for half in HALVES)
    assert areas.min() > 0.0 and areas.sum() == pytest.approx(4.0 * np.pi, rel=1e-9)


HALVES = (0, 1, 2), (0, 2, 3)


def triangles(a, b, c):
    """Signed areas of triangles on the unit sphere (Eriksson 1990)."""
    dot = [np.sum(x * y, axis=0) for x, y in ((a, b), (b, c), (c, a))]
    return 2.0 * np.arctan2(np.sum(a * np.cross(b, c, axis=0), axis=0), 1.0 + sum(dot))


@pytest.mark.exhaustive
def test_uxarray_takes_areas_and_zonal_means(run):
    """Almost all of its time goes into numba's compiling."""
    ux = pytest.importorskip("uxarray")
    data = ux.open_dataset(run, run)
    assert float(data.uxgrid.face_areas.sum()) == pytest.approx(4.0 * np.pi, rel=1e-6)
    means = data.h.isel(time=-1).topological_mean("face").zonal_mean((-70, 50, 40))
    ours = (
        open_run(run)
        .swe.zonal_mean(181)
        .h.isel(time=-1)
        .sel(lat=[-70, -30, 10, 50], method="nearest")
    )
    np.testing.assert_allclose(means.values, ours.values, rtol=2e-3)
    assert np.ptp(ours.values) > 1000.0 * 2e-3


@pytest.mark.parametrize("seen", ["NorthPolarStereo", "Mollweide"])
def test_fields_are_drawn_on_axes_of_cartopy(seen):
    mesh = Mesh.build(3, 8)
    x, y, z = mesh.xyz.T
    axes = Figure().add_subplot(projection=getattr(crs, seen)(20.0))
    if seen == "NorthPolarStereo":
        axes.set_extent([-180, 180, 30, 90], crs.PlateCarree())
    fields = {"h": 7.0 + x + 2.0 * y * z, "b": 0.0 * x}
    draw_state(Frame(mesh, fields, 0.0, {"scene": "hills"}), "h", axes)
    (image,) = axes.images
    rows, columns = image.get_array().shape
    left, right, bottom, top = image.get_extent()
    x = left + (right - left) / columns * (0.5 + np.arange(columns))
    y = bottom + (top - bottom) / rows * (0.5 + np.arange(rows))
    places = np.stack(np.meshgrid(x, y)).reshape(2, -1)
    degrees = crs.Geodetic().transform_points(axes.projection, *places).T[:2]
    back = axes.projection.transform_points(crs.Geodetic(), *degrees).T[:2]
    inside = np.abs(back - places).max(axis=0) < 1.0  # metre: there and back again
    lon, lat = np.radians(degrees)
    assert inside.mean() > 0.7
    a, b, c = position(lon[inside], lat[inside]).T
    drawn = image.get_array().ravel()[inside]
    # cartopy's outline is a polygon within the map's own
    assert np.mean(np.abs(drawn - (7.0 + a + 2.0 * b * c)) > 1e-4) < 1e-3


def test_mesh_and_winds_are_drawn_where_axes_of_cartopy_show_them():
    mesh = Mesh.build(3, 4)
    axes = Figure().add_subplot(projection=crs.PlateCarree())
    axes.set_extent([230, 310, 0, 60], crs.PlateCarree())
    fields = {"h": 1.0 + 0.0 * mesh.lon, "u": 0.0 * mesh.lon, "v": np.cos(mesh.lat)}
    state = Frame(mesh, fields | {"b": fields["u"]}, 0.0, {})
    draw_state(state, "h", axes, Look(mesh=True, winds="arrows"))
    arrows = next(c for c in axes.collections if isinstance(c, Quiver))
    assert arrows.N > 800 and np.abs(arrows.U).max() < 1e-2 * arrows.V.min()
    assert -130.0 <= arrows.X.min() < -125.0 and -55.0 < arrows.X.max() <= -50.0
    lines = next(c for c in axes.collections if isinstance(c, LineCollection))
    ends = np.concatenate([path.vertices for path in lines.get_paths()])
    shown = (np.abs(ends[:, 0] + 90.0) < 40.0) & (np.abs(ends[:, 1] - 30.0) < 30.0)
    assert shown.sum() > 50 and axes.get_xlim() == (-130.0, -50.0)


def test_plain_axes_are_refused_in_one_line(mesh):
    fields = {"h": 1.0 + 0.0 * mesh.lon, "b": 0.0 * mesh.lon}
    with pytest.raises(ConfigError, match="ax must be axes of cartopy") as error:
        draw_state(Frame(mesh, fields, 0.0, {}), "h", Figure().subplots())
    assert "\n" not in str(error.value)
