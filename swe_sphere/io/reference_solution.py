"""Reference solutions; errors of runs relative to them, and of one file relative to another."""

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from swe_sphere.arrays import Array, inverse_permutation
from swe_sphere.equations.scene import Scene
from swe_sphere.errors import ConfigError
from swe_sphere.files.fingerprints import SCENE_FILE
from swe_sphere.io.integrals import Norms, norms
from swe_sphere.io.layout import TRACER, in_python
from swe_sphere.io.runfile import TIME_TOLERANCE, RunFile, Source, read_values, reading, table_in
from swe_sphere.io.scalar_fields import Sampler, check_field, derive, evaluate
from swe_sphere.mesh import Interpolator, Mesh
from swe_sphere.mesh.sphere import global_spline
from swe_sphere.operators.diagnose import divergence, vorticity
from swe_sphere.planet import DAY

if TYPE_CHECKING:
    import xarray as xr

RENAMED = {"surface_height": "surface"}
"""Names in this package of variables that have other names in references."""
ON_GRID = ("lat", "lon"), ("time", "lat", "lon")

SHIPPED = Path(__file__).parents[1] / "data"
"""Folder of the reference solutions in the package; attributes of each file describe it."""


def latitude_weights(lat: Array, bounds: Array | None = None) -> Array:
    """Return the share (M,) of the sphere's area of each latitude circle lat (M,) [rad].

    They are the zones between bounds (M, 2) [rad]; without bounds Gauss weights for latitudes of a
    Gaussian grid, for others zones between neighbours, bounded at the means of sines.
    """
    if bounds is not None:
        return np.abs(np.diff(np.sin(bounds), axis=1)[:, 0]) / 2.0
    nodes, weights = np.polynomial.legendre.leggauss(lat.size)
    order = np.argsort(lat)
    sines = np.sin(lat[order])
    if not np.allclose(sines, nodes, rtol=0.0, atol=1e-6):
        weights = np.diff(0.5 * (sines[1:] + sines[:-1]), prepend=-1.0, append=1.0)
    return weights[inverse_permutation(order)] / 2.0


class Reference(Source):
    """States on a global grid: lat (M,), lon (K,) evenly spaced [rad], fields (M K,).

    A reference is one state; a regridded run has one for each of its times.

    Files give lat and lon in degrees, and times in `time` or as "day N" in their title. Areas are
    shares of the sphere. Raises ConfigError if the file is missing or damaged, its longitudes are
    not an even number, evenly spaced eastward, or its latitudes do not reach from pole to pole.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        with reading(path) as data:
            self.attributes = in_python(data.attrs)
            self.lat, self.lon = (np.radians(data[x].values.astype(float)) for x in ("lat", "lon"))
            self._has_frames = "time" in data.variables
            days = re.findall(r"day (\d+(?:\.\d+)?)", self.title)[:1]
            stated = data["time"].values if self._has_frames else DAY * np.array(days, float)
            self.times = np.atleast_1d(stated)
            """Times [s since the start]; none where neither file nor title states one."""
            self.fields = _fields(self.path, data, -1)
            """Fields of the reference, or of the last time."""
            self.about = {x: in_python(data[x].attrs) for x in self.fields if x in data.variables}
            bounds = np.radians(data["lat_bnds"].values) if "lat_bnds" in data else None
            if not self.fields:
                raise ConfigError(
                    f"cannot read {path}: a reference needs fields on (lat, lon): regrid the file"
                    " of a run (swe-sphere regrid), or take another file"
                )
            count = self.lon.size
            around = np.diff(np.unwrap(np.append(self.lon, self.lon[0])))
            if count % 2 or not np.allclose(around, 2.0 * np.pi / count, atol=1e-6):
                raise ConfigError(
                    f"{self.path}: an even number of longitudes is needed, evenly spaced eastward"
                )
            ends, beyond = self.lat if bounds is None else bounds, 1e-3
            if bounds is None:
                beyond = 1.5 * np.abs(np.diff(self.lat)).max(initial=0.0)
            reaches = min(-ends.min(), ends.max()) + beyond >= np.pi / 2.0  # False for NaN
            if not (reaches and np.isfinite(self.lat).all()):
                raise ConfigError(f"{self.path}: latitudes must reach from pole to pole")
            weights = latitude_weights(self.lat, bounds)
        self.area = np.repeat(weights / count, count)
        self.points = np.tile(self.lon, self.lat.size), np.repeat(self.lat, count)

    def frame_time(self, time: float | None) -> float | None:  # type: ignore[override]
        """Return the time [s] of a frame as `Source` does; None for a reference without a time."""
        return super().frame_time(time) if self.times.size else None

    def is_at(self, time: float) -> bool:
        """Return whether the state, the last one, is of that time [s], or states no time."""
        return not self.times.size or abs(self.times[-1] - time) <= 1.0

    def frame(self, time: float | None = None) -> dict[str, Array]:
        index = self.index(time) if self.times.size else 0  # an error at other times
        if time is None or not self._has_frames:
            return self.fields
        with reading(self.path) as data:
            return _fields(self.path, data, index)

    def state(self, time: float | None = None) -> dict[str, Array]:
        return self.frame(time) | {"area": self.area}

    def sampler(self, lon: Array, lat: Array) -> Sampler:
        return Spline(self, lon, lat)


@dataclass
class Spline:
    """Quintic splines through the grid of a reference, at points lon, lat (P,) [rad]."""

    of: Reference
    lon: Array
    lat: Array

    def __call__(self, field: Array, sign: float = 1.0) -> Array:
        """Return a field (M K,), or with sign -1 a component of a vector, at the points."""
        grid = field.reshape(self.of.lat.size, self.of.lon.size)
        return global_spline(self.of.lat, self.of.lon, grid, 5, sign)(self.lon, self.lat)

    def wind(self, u: Array, v: Array) -> tuple[Array, Array]:
        """Return both components at the points."""
        return self(u, -1.0), self(v, -1.0)


def _fields(path: Path, data: "xr.Dataset", index: int) -> dict[str, Array]:
    """Return fields (M K,) by this package's names, at the time `index` if there are times."""
    there = {RENAMED.get(str(name), str(name)): one for name, one in data.variables.items()}
    return {
        name: read_values(path, name, one[index if one.ndim == 3 else ...]).astype(float).ravel()
        for name, one in there.items()
        if one.dims in ON_GRID and np.issubdtype(one.dtype, np.number)
    }


class OnGrid:
    """A reference, and the matrix from a mesh to its grid, which takes time to build."""

    def __init__(self, reference: Reference, mesh: Mesh) -> None:
        self._reference = reference
        self._interpolator = Interpolator(mesh, *reference.points)

    def errors(self, fields: Mapping[str, Array], height: str) -> Norms:
        """Return errors of height and, as far as the reference has them, of vorticity and wind "v".

        height: "h" or "surface"; the other one replaces it if the reference lacks it.
        """
        has = self._reference.fields.keys()
        has_surface = "surface" in has or {"h", "b"} <= has
        surface = has_surface and (height == "surface" or "h" not in has)
        names = {"h": "surface" if surface else "h"}
        names |= {"vorticity": "vorticity"} if "vorticity" in has else {}
        names |= {"v": "wind"} if {"u", "v"} <= has else {}
        area = self._reference.area
        return {field: norms(area, *self.pair(fields, name)) for field, name in names.items()}

    def decorrelation(self, fields: Mapping[str, Array]) -> float:
        """Return 1 minus the correlation of the vorticity with that of the reference."""
        covariance = np.cov(*self.pair(fields, "vorticity"), aweights=self._reference.area)
        return 1.0 - float(covariance[0, 1]) / float(np.sqrt(covariance[0, 0] * covariance[1, 1]))

    def pair(self, fields: Mapping[str, Array], name: str) -> tuple[Array, Array]:
        """Return a field on the grid, and that of the reference; `fields` (N,) are at the nodes."""
        return evaluate(self._interpolator, fields, name), self._reference.values(name)


DERIVATIVES = {"vorticity": vorticity, "divergence": divergence}


class Exact:
    """Exact solution of a scene at any point; ConfigError if it or a field is unknown.

    mesh: mesh on which derivatives of the exact wind are computed, as for the run.
    """

    def __init__(self, scene: Scene, mesh: Mesh) -> None:
        if scene.exact is None and scene.exact_tracers is None:
            raise ConfigError(f"no exact solution of {scene.name} is known: compare with a file")
        self._scene, self._mesh = scene, mesh

    def at(self, field: str, lon: Array, lat: Array, time: float | None = None) -> Array:
        """Return a field (M,), or "wind" (2, M), at lon, lat (M,) [rad] and time [s] (None: 0)."""
        scene, mesh, now = self._scene, self._mesh, time or 0.0
        if field.startswith(TRACER):
            key = field.removeprefix(TRACER)
            known = {} if scene.exact_tracers is None else scene.exact_tracers(lon, lat, now)
            if key not in known:
                raise ConfigError(f"no exact mixing ratio of {key!r} is known: compare with a file")
            found: Array = known[key]
        elif scene.exact is None:
            raise ConfigError(f"{scene.name} has exact tracers only: name one")
        elif field in DERIVATIVES:
            u, v, _ = scene.exact(mesh.lon, mesh.lat, now)
            found = Interpolator(mesh, lon, lat)(DERIVATIVES[field](mesh, u, v))
        else:
            u, v, h = scene.exact(lon, lat, now)
            bottom = 0.0 * lon if scene.bottom is None else scene.bottom(lon, lat)
            found = derive({"u": u, "v": v, "h": h, "b": bottom}, field)
        if np.isnan(found).all():
            raise ConfigError(f"{field} of {scene.name} is not known at day {now / DAY:g}")
        return found


def open_source(path: str | os.PathLike[str]) -> RunFile | Reference:
    """Return a file of a run, or a reference on a grid; ConfigError if it is neither or damaged."""
    with reading(path) as data:
        on_grid = {"lat", "lon"} <= data.sizes.keys()
    return Reference(path) if on_grid else RunFile(path)


def compare(
    a: str | os.PathLike[str], b: str | os.PathLike[str], field: str | None = None,
    time: float | None = None, across_scenes: bool = False,
) -> dict[str, str | float | None]:  # fmt: skip
    """Return norms of A - B over those of B, at the points and with the area weights of B.

    a, b: files of runs (any two meshes) or latitude-longitude references. field: a name in
    `scalar_fields.FIELDS` or the files, or "wind" for the vector; None: "h", or "surface" if one of
    the two contains no depth. time [s]: the frame; None: the time of a reference, otherwise the
    last one that both runs have. across_scenes: permits runs of different scenes. Returns field,
    time, l1, l2, linf. Raises ConfigError if a file cannot be read, if one of them lacks the field
    or a frame at that time, or if the runs are of different scenes.
    """
    ours, theirs = open_source(a), open_source(b)
    if not across_scenes:
        _check_scenes(ours, theirs)
    time = _common_time(ours, theirs) if time is None else time
    field = _common_field(ours, theirs, field)
    found = ours.at(field, *theirs.points, time)
    return {"field": field, "time": time, **norms(theirs.area, found, theirs.values(field, time))}


def _check_scenes(ours: Source, theirs: Source) -> None:
    """Raise ConfigError for runs of different scenes; a reference does not name its scene."""
    one, other = (source.attributes.get("scene") for source in (ours, theirs))
    # fingerprints of user-defined scene files; scenes of the package have none
    files = [table_in(str(s.attributes.get("sources"))).get(SCENE_FILE) for s in (ours, theirs)]
    if None in (one, other) or (one == other and files[0] == files[1]):
        return
    what = f"{ours.path} and {theirs.path} are runs of two scenes named {one}"
    if one != other:
        what = f"{ours.path} is a run of {one}, {theirs.path} one of {other}"
    raise ConfigError(f"{what}: compare runs of one scene, or give --across-scenes")


def _common_time(*sources: Source) -> float | None:
    """Return the last time [s] of which both have a frame; None for references without a time."""
    if not (timed := [s.times for s in sources if s.times.size or isinstance(s, RunFile)]):
        return None
    common = timed[0][np.isclose(timed[0][:, None], timed[-1], 0.0, TIME_TOLERANCE).any(axis=1)]
    if not common.size:
        names = " and ".join(str(source.path) for source in sources)
        raise ConfigError(f"{names} have no common time: give --time")
    return float(common[-1])


def _common_field(ours: Source, theirs: Source, field: str | None) -> str:
    """Return the field, or "surface" in place of a depth that a reference lacks."""
    references = [s for s in (ours, theirs) if isinstance(s, Reference)]
    if field is None:
        return "surface" if any("h" not in r.fields for r in references) else "h"
    field = check_field(field, [*ours.about, *theirs.about], vector=True)
    bottoms = (s.bottom if isinstance(s, RunFile) else s.frame().get("b") for s in (ours, theirs))
    bottom = next((b for b in bottoms if b is not None), None)
    without_depth = [r for r in references if "h" not in r.fields]
    without_bottom = [r for r in references if not r.fields.keys() & {"surface", "b"}]
    if field == "surface" and without_bottom and bottom is not None and np.any(bottom):
        raise ConfigError(f"{without_bottom[0].path} holds the depth alone: compare field 'h'")
    if field != "h" or not without_depth:
        return field
    if bottom is not None and np.any(bottom):
        raise ConfigError(
            f"{without_depth[0].path} holds the free surface, not the depth: compare field"
            " 'surface'"
        )
    return "surface"
