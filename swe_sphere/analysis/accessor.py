"""The xarray accessor `ds.swe`: quantities and pictures derived from the fields of a run.

Datasets from `swe_sphere.open_run` and `Simulation.to_xarray` have the accessor; importing this
module adds it to all other datasets.
"""

import json
import os
from collections.abc import Iterable, Mapping
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import xarray as xr
from scipy import sparse
from scipy.sparse.linalg import splu

from swe_sphere.analysis.regrid import Grid, gaussian, holding, lat_lon, on_grid, on_nodes
from swe_sphere.arrays import Array
from swe_sphere.errors import ConfigError
from swe_sphere.io.integrals import flow_integrals, norms
from swe_sphere.io.layout import MESH_ATTRIBUTES, TOPOLOGY, VARIABLES, decode, in_python, plain
from swe_sphere.io.runfile import TIME_TOLERANCE, Nodal, RunFile, engine, mesh_of
from swe_sphere.io.scalar_fields import check_field, derive, evaluate
from swe_sphere.mesh import Interpolator, Mesh
from swe_sphere.operators.diagnose import vorticity
from swe_sphere.operators.sparse import stiffness
from swe_sphere.planet import DAY, Planet
from swe_sphere.settings.values import convert, validate
from swe_sphere.testcases.harmonics import GaussGrid, mean_squares

if TYPE_CHECKING:
    from cartopy.mpl.geoaxes import GeoAxes

    from swe_sphere.pictures.plot import Film

SPECTRA = {
    "rotational_energy": ("kinetic energy of the rotational wind", "m2 s-2"),
    "divergent_energy": ("kinetic energy of the divergent wind", "m2 s-2"),
    "enstrophy": ("half the mean square of the relative vorticity", "s-2"),
}


def open_run(
    path: str | os.PathLike[str], chunks: Mapping[str, int] | Literal["auto"] | None = None
) -> xr.Dataset:
    """Return the file of a run as an xarray dataset: fields on (time, node), diagnostic series.

    Times are seconds since the start; attributes include the entries of the summary of the run.
    `ds.swe` (`swe_sphere.analysis.accessor`) derives spectra, errors, pictures and more.

    Args:
        path: netCDF file or Zarr store of a run.
        chunks: None reads all data at once. {"time": 1} or "auto" reads them when needed, by dask.

    Examples:
        >>> from swe_sphere import Simulation, open_run
        >>> sim = Simulation("williamson2", ne=2, np=4, dt=3600)
        >>> summary = sim.run(days=1, every=6, out="quick.nc")
        >>> run = open_run("quick.nc")
        >>> run.h.dims, run.sizes["time"], run.attrs["completed"]
        (('time', 'node'), 5, 1)
        >>> run.swe.to_latlon(19, 36).h.shape
        (5, 19, 36)

    Raises ConfigError if the file is missing, damaged or of another kind, or for unknown chunks.
    """
    found, kept = RunFile(path).attributes, dict.fromkeys(TOPOLOGY, False)  # keeps integers
    raw: dict[str, Any] = {"decode_times": False, "mask_and_scale": kept, "chunks": chunks}
    try:
        data = xr.open_dataset(path, engine=engine(Path(path)), **raw)
    except (ImportError, TypeError, ValueError) as error:
        raise ConfigError(f"cannot read {path} in chunks {chunks!r}: {error}") from error
    for variable in data.variables.values():
        variable.attrs.pop("_FillValue", None)  # describes the storage, not the variable
    if chunks is None:
        with data:
            data.load()
    return decode(data, path).assign_attrs(plain(found))


@xr.register_dataset_accessor("swe")  # type: ignore[no-untyped-call]
class Analysis:
    """Analysis of the fields (time, node) of a run, or of one of its frames (node).

    Fields on other grids, potential vorticity, streamfunction and spectra are evaluated lazily,
    frame by frame, if the dataset consists of dask arrays (`open_run(path, chunks={"time": 1})`).
    Integrals and errors are evaluated at once, with one frame in memory at a time.

    Methods raise ConfigError if the dataset is not that of a run, or lacks needed fields or frames.

    Examples:
        >>> from swe_sphere import Simulation
        >>> state = Simulation("williamson2", ne=4, np=6).to_xarray()
        >>> grid = state.swe.to_latlon(19, 36)
        >>> grid.h.dims, float(grid.u.sel(lat=0.0, lon=40.0).round(2)[0])
        (('time', 'lat', 'lon'), 38.61)
        >>> energy = state.swe.spectrum(degree=8).rotational_energy.isel(time=0)
        >>> int(energy.idxmax())
        1
    """

    def __init__(self, data: xr.Dataset) -> None:
        self._data = data

    @cached_property
    def mesh(self) -> Mesh:
        """The mesh of the fields, rebuilt from the attributes of the dataset."""
        if self._data.sizes.get("time") == 0:
            raise ConfigError("this dataset holds no frames: choose at least one time")
        values = in_python(self._data.attrs)
        if not {*MESH_ATTRIBUTES} <= values.keys() or "node" not in self._data.dims:
            raise ConfigError(
                "this dataset is on a grid, or not of a run: open the file that a run wrote at the"
                " nodes of its mesh with swe_sphere.open_run"
            )
        return mesh_of(values, self._data, "cannot use this dataset")

    def to_latlon(self, rows: int = 181, columns: int = 360) -> xr.Dataset:
        """Return all fields on evenly spaced latitudes and longitudes: (..., lat, lon).

        rows, columns: numbers of latitudes and longitudes; an odd number of rows includes the
        poles. The values are those of the polynomials in the elements; u needs v, and v needs u.
        """
        return self.to_grid(lat_lon(rows, columns))

    def to_gaussian(self, n: int) -> xr.Dataset:
        """Return all fields on 2n Gauss latitudes and 4n longitudes; see `to_latlon`."""
        return self.to_grid(gaussian(n))

    def to_grid(self, grid: Grid) -> xr.Dataset:
        """Return all fields on a grid of `swe_sphere.analysis.regrid`; see `to_latlon`."""
        return on_grid(self._data, Interpolator(self.mesh, *grid.points), grid)

    def zonal_mean(self, rows: int = 181) -> xr.Dataset:
        """Return means of all fields along circles of latitude: (..., lat), at `rows` latitudes."""
        fine = self.to_latlon(rows, 4 * truncation(self.mesh))
        means = fine.drop_vars(["lon_bnds", "cell_area"]).mean("lon", keep_attrs=True)
        for name, variable in means.data_vars.items():
            if "lon" in fine[name].dims:  # profiles are no means
                variable.attrs["cell_methods"] = "longitude: mean"
        return means

    def spectrum(self, degree: int | None = None) -> xr.Dataset:
        """Return kinetic energy [m2 s-2] and enstrophy [s-2] by spherical wavenumber.

        The shape is (..., wavenumber). Energies are those of the rotational and of the divergent
        wind; their sums over the wavenumbers are means over the sphere. degree: the highest
        wavenumber, by default 2 ne (np - 1), with two nodes per wavelength on the equator.
        """
        degree = truncation(self.mesh) if degree is None else convert("degree", int, degree)
        if degree < 1:
            raise ConfigError(f"degree={degree}: a spectrum goes to wavenumber 1 at least")
        # 1.5 times as fine as `degree` requires: aliases appear only beyond that degree
        at = Interpolator(self.mesh, *gaussian((3 * degree + 5) // 4).points)
        sizes = {"kind": len(SPECTRA), "wavenumber": degree + 1}
        wind = holding(self._data, "u", "v")
        found: xr.DataArray = on_nodes(
            lambda u, v: spectra(*at.wind(u, v), degree, self.mesh.radius), sizes, *wind
        )
        parts = {
            name: found.isel(kind=k).assign_attrs(long_name=text, units=units)
            for k, (name, (text, units)) in enumerate(SPECTRA.items())
        }
        about = {"long_name": "spherical wavenumber", "units": "1"}
        return xr.Dataset(parts, {"wavenumber": ("wavenumber", np.arange(degree + 1), about)})

    def potential_vorticity(self) -> xr.DataArray:
        """Potential vorticity (ζ + f) / h [m-1 s-1] at the nodes."""
        relative, f, h = holding(self._data, "vorticity", "f", "h")
        about = {"long_name": "potential vorticity", "units": "m-1 s-1"}
        return ((relative + f) / h).rename("potential_vorticity").assign_attrs(about)

    def streamfunction(self) -> xr.DataArray:
        """Streamfunction ψ of the wind's rotational part k × ∇ψ [m2 s-1] at the nodes.

        k × ∇ψ is nearest to the wind in the mean square: ψ, of mean zero, solves the weak form of
        ∇²ψ = ζ: ∫ ∇φ·∇ψ = -∫ φ ζ for every continuous test function φ on the elements.
        """
        wind, mesh = holding(self._data, "u", "v"), self.mesh
        # ψ is defined up to a constant, which is set to zero at the first node
        factors = splu(
            sparse.csc_array(stiffness(mesh, np.ones(mesh.size)))[1:, 1:], diag_pivot_thresh=0.0,
            permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True},
        )  # fmt: skip

        def solved(u: Array, v: Array) -> Array:
            psi: Array = np.append(0.0, factors.solve((-mesh.area * vorticity(mesh, u, v))[1:]))
            return psi - float(np.average(psi, weights=mesh.area))

        found: xr.DataArray = on_nodes(solved, {"node": mesh.size}, *wind)
        about = {"standard_name": "atmosphere_horizontal_streamfunction", "units": "m2 s-1",
                 "long_name": "streamfunction"}  # fmt: skip
        return found.rename("streamfunction").assign_attrs(about)

    def integrals(self) -> xr.Dataset:
        """Return mass, energy, potential enstrophy, extremes, ... at every time: (time,).

        Names and units are those of the series in the file of a run; see `swe_sphere.io.integrals`.
        """
        given = self._data.attrs.get("planet", {})
        planet = Planet(**(json.loads(given) if isinstance(given, str) else given))
        names = ("u", "v", "h", "b", "f", "vorticity", "divergence")
        holding(self._data, *names)
        frames, about = self.frames, VARIABLES["series"]
        fields = (frames.fields(k, names) for k in range(frames.times.size))
        rows = [flow_integrals(self.mesh, planet, **each) for each in fields]
        values = {name: ("time", [row[name] for row in rows], about[name]) for name in rows[0]}
        return self._series(values, frames.times)

    def error_norms(self, other: xr.Dataset, fields: Iterable[str] = ("h", "wind")) -> xr.Dataset:
        """Return l1, l2 and linf of this run against `other`, the reference, at all common times.

        Norms are those of Williamson et al. (1992), at the nodes and with the weights of `other`;
        the meshes may differ. fields: "h", "wind", "surface", "vorticity", tracers, .... Results
        are named l1_h, l2_h, ..., linf_wind.

        Raises ConfigError if the runs have no time in common, or a dataset is not that of a run.
        """
        if not isinstance(other, xr.Dataset):
            raise ConfigError(f"error_norms needs a dataset from open_run, got {other!r}")
        ours, theirs = self.frames, Analysis(other).frames
        pairs = np.argwhere(np.abs(ours.times[:, None] - theirs.times) <= TIME_TOLERANCE)
        if not pairs.size:
            raise ConfigError("the two runs have no common time")
        at = ours.sampler(*theirs.points)
        found: dict[str, list[float]] = {}
        one = isinstance(fields, str) or not np.iterable(fields)
        names: Iterable[Any] = dict.fromkeys([fields] if one else fields)
        for k, j in pairs:
            left, right = ours.fields(k), theirs.fields(j)
            for field in names:
                errors = norms(theirs.area, evaluate(at, left, field), derive(right, field))
                for norm, value in errors.items():
                    found.setdefault(f"{norm}_{field}", []).append(value)
        values = {name: ("time", numbers) for name, numbers in found.items()}
        return self._series(values, ours.times[pairs[:, 0]])

    def plot(
        self, field: str | None = None, time: float | None = None, ax: "GeoAxes | None" = None,
        **look: Any,
    ) -> "GeoAxes":  # fmt: skip
        """Draw a field on the globe; return the map, which is axes of cartopy.

        time: the frame [days since the start]; None for the last. ax: axes of cartopy to draw into,
        which keep their title; None for a new figure. look: options projection="robinson",
        winds="arrows", mesh=True, ...; see `swe_sphere.pictures.look.Look`.

        Raises ConfigError if there is no frame at that time.
        """
        from swe_sphere.pictures.look import Look
        from swe_sphere.pictures.plot import draw_state

        when = None if time is None else convert("time", float, time) * DAY
        return draw_state(self.frames, field, ax, validate(Look, look), when)

    def animate(self, field: str | None = None, rate: float = 8.0, **look: Any) -> "Film":
        """Return all frames as a film of matplotlib, which a notebook shows.

        rate: frames per second. look: options as for `plot`. `film.save("jet.gif")` writes a file.

        Raises ConfigError if there are fewer than two frames.
        """
        from swe_sphere.pictures.look import Look
        from swe_sphere.pictures.plot import Film, default_field

        field = check_field(field or default_field(self.frames), self.frames.about)
        return Film.of(self.frames, field, validate(Look, look), rate)

    @property
    def frames(self) -> "Frames":
        """The frames as a source of pictures."""
        return Frames(self._data, self.mesh)

    def _series(self, values: dict[str, Any], times: Array) -> xr.Dataset:
        """Return values by name at times [s]."""
        about = {"long_name": "time since the start", "units": "s"}
        return xr.Dataset(values, {"time": ("time", times, about)})


class Frames(Nodal):
    """Frames of the dataset of a run."""

    path = Path("the dataset")

    def __init__(self, data: xr.Dataset, mesh: Mesh) -> None:
        self._data, self.mesh = data, mesh
        self.attributes = {str(name): value for name, value in data.attrs.items()}
        self.about = {str(name): field.attrs for name, field in data.data_vars.items()}
        self.times = np.zeros(1)  # a dataset without times is one frame
        if "time" in data.coords:
            self.times = np.atleast_1d(decode(data[["time"]], self.path)["time"].values)

    @cached_property
    def bottom(self) -> Array:  # type: ignore[override]
        return self.fields(0, ["b"]).get("b", np.zeros(self.mesh.size))

    def frame(self, time: float | None = None) -> dict[str, Array]:
        return {"b": self.bottom, **self.fields(self.index(time))}

    def fields(self, k: int, names: Iterable[str] | None = None) -> dict[str, Array]:
        """Return the fields (N,) of frame k, by default all; names without a field are skipped."""
        data = self._data.isel(time=k) if "time" in self._data.dims else self._data
        if others := set(data["h"].dims if "h" in data else ()) - {"node"}:
            raise ConfigError(f"choose one of {', '.join(map(str, others))} (isel) first")
        wanted = data.data_vars if names is None else names
        nodal = [name for name in wanted if name in data and data[name].dims == ("node",)]
        return {str(name): data[name].values for name in nodal}


def truncation(mesh: Mesh) -> int:
    """Spherical wavenumber with two nodes per wavelength on the equator of a uniform mesh."""
    return 2 * mesh.ne * (mesh.np - 1)


def spectra(u: Array, v: Array, degree: int, radius: float) -> Array:
    """Return rotational and divergent kinetic energy [m2 s-2] and enstrophy [s-2], (3, degree + 1).

    u, v: wind [m s-1] on a Gaussian grid. Values are means over the sphere: both energies, summed
    over all wavenumbers n, are the mean of (u² + v²) / 2; the enstrophy sums to the mean of ζ² / 2.
    The energy of degree n is a² / (2 n (n + 1)) times the mean squares of the vorticity and the
    divergence of that degree (Lambert, 1984, Atmosphere-Ocean 22, eq. 6).
    """
    grid = GaussGrid(u.shape[0] - 1)
    squares = (mean_squares(grid.against_gradients(*flux)) for flux in ((v, -u), (u, v)))
    enstrophy, divergent = (x[: degree + 1] / radius**2 for x in squares)
    n = np.arange(degree + 1.0)
    factor = np.divide(radius**2, n * (n + 1.0), out=np.zeros_like(n), where=n > 0)
    return 0.5 * np.stack([factor * enstrophy, factor * divergent, enstrophy])
