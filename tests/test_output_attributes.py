"""Attributes of output variables, against tables here and in docs/reference/files.md."""

import math
import re
from dataclasses import replace
from pathlib import Path

import pytest
import xarray as xr

from swe_sphere.equations.effects import Tracers
from swe_sphere.planet import EARTH
from swe_sphere.simulation.simulation import Simulation
from swe_sphere.testcases import get_scene

from .support import thorough

ON_NODES = {"mesh": "mesh", "location": "node", "coordinates": "lat lon", "grid_mapping": "sphere"}
CLOCK = {
    "standard_name": "time", "units": "seconds since 2000-01-01 00:00:00",
    "calendar": "proleptic_gregorian", "units_metadata": "leap_seconds: none",
}  # fmt: skip
FRAMES = {
    "h": ("m", "", "depth of the fluid"),
    "u": ("m s-1", "eastward_wind", "eastward wind"),
    "v": ("m s-1", "northward_wind", "northward wind"),
    "vorticity": ("s-1", "atmosphere_upward_relative_vorticity", "relative vorticity"),
    "divergence": ("s-1", "divergence_of_wind", "divergence of the wind"),
    "q_smoke": ("1", "", "mixing ratio of tracer smoke"),
}
"""Units, standard name and long name of the fields."""
CONSTANTS = {
    "b": ("m", "surface_altitude", "height of the bottom"),
    "f": ("s-1", "coriolis_parameter", "Coriolis parameter"),
    "area": ("m2", "cell_area", "quadrature weight of the node, its share of the sphere's area"),
}
ABOUT = "area mean of the absolute angular momentum per unit density about the axis"
SERIES = {
    "mass": ("m", "area mean of the fluid depth"),
    "energy": ("m3 s-2", "area mean of the total energy per unit density"),
    "potential_enstrophy": ("m-1 s-2", "area mean of the potential enstrophy"),
    "angular_momentum_x": ("m3 s-1", f"{ABOUT} through 0E on the equator"),
    "angular_momentum_y": ("m3 s-1", f"{ABOUT} through 90E on the equator"),
    "angular_momentum_z": ("m3 s-1", f"{ABOUT} through the poles"),
    "axial_angular_momentum": ("m3 s-1", f"{ABOUT} of rotation"),
    "equatorial_angular_momentum": (
        "m3 s-1", f"{ABOUT.replace('about', 'across')} of rotation",
    ),
    "equatorial_momentum_drift": (
        "1",
        "change of the equatorial angular momentum since the start over the length of the vector",
    ),
    "total_vorticity": ("s-1", "area mean of the relative vorticity"),
    "total_divergence": ("s-1", "area mean of the divergence"),
    "max_wind": ("m s-1", "largest wind speed"),
    "max_wave": ("m s-1", "largest gravity wave speed"),
    "max_signal": ("m s-1", "largest wind speed plus gravity wave speed"),
    "min_depth": ("m", "least fluid depth"),
    "angular_momentum_drift": (
        "1", "change of the axial angular momentum since the start over the length of the vector",
    ),
}  # fmt: skip
NUMBERS = (
    "mass_drift", "energy_drift", "enstrophy_drift", "mass_drift_q_smoke", "min_q_smoke",
    "max_q_smoke", "courant_advective", "courant_gravity", "l1_h", "l2_h", "linf_h", "l1_v", "l2_v",
    "linf_v",
)  # fmt: skip
"""Series without units, whose long name is the name with spaces."""
OTHERS = {
    "lat": (
        ("node",),
        {"standard_name": "latitude", "long_name": "latitude", "units": "degrees_north",
         "bounds": "lat_bnds"},
    ),
    "lon": (
        ("node",),
        {"standard_name": "longitude", "long_name": "longitude", "units": "degrees_east",
         "bounds": "lon_bnds"},
    ),
    "lat_bnds": (("node", "corner"), {}),
    "lon_bnds": (("node", "corner"), {}),
    "mesh": (
        (),
        {"cf_role": "mesh_topology", "topology_dimension": 2, "node_coordinates": "lon lat",
         "face_node_connectivity": "face_nodes", "face_dimension": "face",
         "long_name": "Gauss-Lobatto-Legendre points of the elements and the quads between them"},
    ),
    "face_nodes": (
        ("face", "corner"),
        {"_FillValue": -1, "cf_role": "face_node_connectivity", "start_index": 0,
         "long_name": "corner nodes of each quad, anticlockwise"},
    ),
    "sphere": ((), {"grid_mapping_name": "latitude_longitude", "earth_radius": EARTH.radius}),
    "time": (("time",), {**CLOCK, "long_name": "time", "axis": "T"}),
    "diagnostic_time": (
        ("diagnostic_time",), {**CLOCK, "long_name": "time of the diagnostics"},
    ),
}  # fmt: skip
"""Dimensions and attributes of the other variables."""


def expected() -> dict[str, tuple[tuple[str, ...], dict[str, object]]]:
    """Dimensions and attributes of all variables by name."""
    table: dict[str, tuple[tuple[str, ...], dict[str, object]]] = dict(OTHERS)
    for name, (units, standard, long) in (FRAMES | CONSTANTS).items():
        about = {"units": units, "long_name": long, **ON_NODES}
        about |= {"standard_name": standard} if standard else {}
        if name in FRAMES:
            about |= {"_FillValue": "NaN", "cell_measures": "area: area"}
        table[name] = (("time", "node") if name in FRAMES else ("node",), about)
    for name, (units, long) in (SERIES | {n: ("1", n.replace("_", " ")) for n in NUMBERS}).items():
        about = {"_FillValue": "NaN", "units": units, "long_name": long}
        table[name] = ("diagnostic_time",), about
    return table


@pytest.fixture(scope="module", params=["run.nc", "run.zarr"])
def written(request, tmp_path_factory):
    """A file of a run with a tracer and an exact solution."""
    scene = get_scene("williamson2")
    smoke = {"smoke": lambda lon, lat: 1.0 + 0.0 * lon}
    scene = replace(scene, effects=(*scene.effects, Tracers()), tracers=smoke)
    path = tmp_path_factory.mktemp("output") / request.param
    assert Simulation(scene, ne=2, np=4, dt=1800.0).run(days=1 / 24, out=path).completed
    return path


def test_variables_have_the_dimensions_and_attributes_of_the_table(written):
    table = expected()
    with xr.open_dataset(written, decode_cf=False) as data:
        assert {*data.variables} == {*table}
        for name, variable in data.variables.items():
            found = {
                key: getattr(x, "tolist", lambda x=x: x)() for key, x in variable.attrs.items()
            }
            found = {key: "NaN" if x != x else x for key, x in found.items()}
            if written.suffix == ".zarr" and "_FillValue" not in table[name][1]:
                found.pop("_FillValue", None)  # which xarray adds in stores
            assert (variable.dims, found) == table[name], name
            assert variable.dtype == ("i4" if name in ("mesh", "face_nodes", "sphere") else "f8")


def test_the_page_on_files_has_the_dimensions_and_units_of_the_file(written):
    page = (Path(__file__).parents[1] / "docs" / "reference" / "files.md").read_text("utf-8")
    part = page.partition("## Every variable")[2].partition("\n## ")[0]
    stated = {}
    for line in re.findall(r"^\| `.*\|$", part, re.MULTILINE):
        names, dims, units, _ = (cell.strip() for cell in line.strip("|").split("|"))
        for name in re.findall(r"`([^`]+)`", names):
            name = f"angular_momentum{name}" if name.startswith("_") else name
            stated[name.replace("NAME", "smoke")] = dims, units
    with xr.open_dataset(written, decode_cf=False) as data:
        for name, variable in data.variables.items():
            if name.endswith("_bnds") or name == "mesh":
                continue  # bounds have the units of their coordinate, and the mesh has no values
            if re.fullmatch("l(1|2|inf)_[hv]", name):
                assert stated["l1_h"] == stated["linf_v"] == ("diagnostic_time", "1")
                continue
            dims, units = stated[name]
            assert dims == ", ".join(variable.dims), name
            every = [each.strip() for each in units.split(",")]
            found = variable.attrs.get("units", "").replace(
                "seconds since 2000-01-01 00:00:00", "s"
            )
            assert found.partition("_")[0] in {each.partition(" since")[0] for each in every}, name


def test_attributes_of_the_file_state_mesh_scene_and_time(written):
    with xr.open_dataset(written, decode_cf=False) as data:
        about = data.attrs
        assert about["Conventions"] == "CF-1.11 UGRID-1.0"
        assert (about["ne"], about["np"], about["stretch"], about["spin"]) == (2, 4, 1.0, 0.0)
        assert about["radius"] == EARTH.radius and about["scene"] == "williamson2"
        assert (about["dt"], about["start_step"], about["precision"]) == (1800.0, 0, "float64")
        assert data["time"].values.tolist() == [0.0, 3600.0]
        assert data["diagnostic_time"].values.tolist() == [0.0, 1800.0, 3600.0]
        assert math.isclose(data["area"].sum(), 4.0 * math.pi * EARTH.radius**2, rel_tol=1e-5)


@pytest.mark.parametrize("name", ["run.nc", thorough("run.zarr")])
def test_a_continued_file_keeps_its_beginning_and_has_each_sample_once(name, tmp_path):
    file = tmp_path / name
    first = Simulation("williamson2", ne=2, np=4, dt=1800.0)
    first.run(days=1 / 24, out=file, progress=False)
    Simulation.from_checkpoint(file).run(days=1 / 12, out=file, progress=False)
    with xr.open_dataset(file, decode_cf=False) as data:
        assert data["diagnostic_time"].values.tolist() == [0.0, 1800.0, 3600.0, 5400.0, 7200.0]
        assert data["time"].values.tolist() == [0.0, 3600.0, 7200.0]
        assert data.attrs["start_step"] == 0 and data.attrs["run_id"] == first.run_id
        assert data.attrs["history"].count("run williamson2") == 2
