"""Case 7 of Williamson et al. (1992): a run from an analysed state of the atmosphere at 500 hPa.

The three analyses of the paper (21 December 1978, 9 and 16 January 1979) are no longer public. The
scene reads any analysis. Without a file it builds a state whose title begins with SYNTHETIC.

The netCDF file of an analysis must contain

* one-dimensional variables `lat` or `latitude` and `lon` or `longitude` [degrees] of at least 8
  values: latitudes in order, to within 1.5 grid spacings of the poles; an even number of
  longitudes, equally spaced eastward, once around without repeating the first;
* eastward wind `u`, northward wind `v`, with units of m s-1, and `z`, geopotential height with
  units of m or geopotential with units of m2 s-2, under the names of ERA5, of NCEP (`uwnd`, `vwnd`,
  `hgt`) or of CMIP (`ua`, `va`, `zg`).

The variables u, v and z have the dimensions (lat, lon) and no missing values. The scene reads the
level of 500 hPa of a pressure dimension; other dimensions must have length 1.
"""

from pathlib import Path
from typing import Any

import numpy as np

from swe_sphere.equations.scene import Array, Scene, State
from swe_sphere.errors import ConfigError
from swe_sphere.mesh.sphere import global_spline
from swe_sphere.planet import EARTH
from swe_sphere.settings.values import read_toml
from swe_sphere.testcases import harmonics
from swe_sphere.testcases.flows import ROTATING, build_scene

PAPER = "Williamson et al. (1992), J. Comput. Phys. 102, 211-224, doi:10.1016/S0021-9991(05)80016-6"
DEPTH = 1e4
"""Mean depth [m] that replaces the mean of the analysis, as in the paper."""
DEGREE = 42
"""Highest degree of the synthetic state, as in the paper's analyses."""
KNOWN = read_toml(Path(__file__).with_name("analyses.toml"))
"""Names of variables and of their units, and factors that take pressures to Pa."""


def williamson7(
    file: Path | None = None, degree: int = 0, balanced: bool = False, seed: int = 1
) -> Scene:
    """Flow at 500 hPa from a file, or a SYNTHETIC flow without a file.

    Case 7 is a run of five days from an analysis. A mean of 10 km replaces the mean height.

    Without a file the state is synthetic: jets of 20 m/s in both hemispheres, u ~ cos³ θ sin² θ,
    and random eddies of 12 m/s (root mean square) whose kinetic energy at degree n of the spherical
    harmonics is proportional to x / (1 + x⁴), x = n / 6, 2 ≤ n ≤ 42; the height is in linear
    balance, g ∇²h = ∇·(f ∇ψ). It is not an observed state.

    Args:
        file: netCDF file with u, v [m s-1] and z [m, or m2 s-2] on a latitude-longitude grid; see
            `swe_sphere.testcases.williamson7` for its contents.
        degree: highest degree of the spherical harmonics kept in the file's fields; 0 keeps all, or
            42 with `balanced`.
        balanced: keep only the rotational wind, with the height of the nonlinear balance equation.
        seed: seed of the random phases of the synthetic state.

    Raises ConfigError for a file of other contents, numbers out of range, a filter without a file.
    """
    if file is None:
        if degree or balanced:
            raise ConfigError("williamson7: degree and balanced filter a file: give a file too")
        title, source = "SYNTHETIC 500 hPa-like flow", "SYNTHETIC initial state"
        synthetic = _streamfunction(seed)
        initial: State = harmonics.BalancedFlow(synthetic, EARTH, DEPTH, linear=True).state
    else:
        title, source = f"500 hPa flow from {file.name}", f"initial state from {file.name}"
        initial = _analysed(file, degree, balanced)

    return build_scene(
        "williamson7", title=title, reference=f"{source}; the case: {PAPER}, case 7",
        effects=ROTATING, initial=initial, parameters={"file": "SYNTHETIC"} if file is None else {},
    )  # fmt: skip


def _streamfunction(seed: int) -> harmonics.Complex:
    """Return the streamfunction of jets and random eddies, as coefficients [m2 s-1]."""
    found: harmonics.Complex = harmonics.random_streamfunction(
        lambda n: n / 6.0 / (1.0 + (n / 6.0) ** 4), DEGREE, 12.0, EARTH.radius, seed
    )
    grid = harmonics.GaussGrid(5)
    sine = np.sin(grid.points[1])
    # -∂ψ/∂θ / a ~ cos³ θ sin² θ, which is largest where sin² θ = 2/5
    jets = -(sine**3 / 3.0 - sine**5 / 5.0) * EARTH.radius * 20.0 / (0.4 * 0.6**1.5)
    found[:6, :6] += grid.coefficients(jets)
    return found


def _analysed(file: Path, degree: int, balanced: bool) -> State:
    """Return the state of a file, interpolated by bicubic splines, with a mean depth of 10 km."""
    if not 0 <= degree <= 1000:
        raise ConfigError(f"williamson7: degree must be from 0 to 1000, got {degree}")
    lat, lon, *fields = _read_analysis(file)
    # each latitude stands for the zone up to the middle (in sine) to the next ones
    weights = np.diff(0.5 * (np.sin(lat[1:]) + np.sin(lat[:-1])), prepend=-1.0, append=1.0)
    mean = float(weights @ fields[2].mean(axis=1) / 2.0)
    if fields[2].min() - mean + DEPTH <= 0.0:
        raise ConfigError(f"{file}: z varies by more than 10 km: check its units, m or m2 s-2")
    signed = zip(fields, (-1.0, -1.0, 1.0), strict=True)
    splines = [global_spline(lat, lon, field, 3, sign) for field, sign in signed]

    def interpolated(lon: Array, lat: Array) -> tuple[Array, Array, Array]:
        u, v, z = (spline(lon, lat) for spline in splines)
        return u, v, z

    state: State = interpolated
    if degree or balanced:
        state = _filtered(interpolated, lat.size, degree or DEGREE, balanced)

    def initial(lon: Array, lat: Array) -> tuple[Array, Array, Array]:
        u, v, z = state(lon, lat)
        return u, v, z - mean + DEPTH

    return initial


def _filtered(state: State, latitudes: int, degree: int, balanced: bool) -> State:
    """Return the state without spherical harmonics above `degree`; the mean height is kept.

    latitudes: number of latitudes of the file. balanced: drop the divergent wind, and replace the
    height by that of `BalancedFlow`, so that almost no gravity waves remain.
    """
    grid = harmonics.GaussGrid(max(degree, latitudes))
    u, v, z = state(*grid.points)
    wanted = slice(degree + 1), slice(degree + 1)

    def potential(east: Array, north: Array) -> harmonics.Complex:
        """Return the potential [m2 s-1] whose gradient is nearest to a field [m s-1]."""
        inflow = grid.against_gradients(east, north)[wanted]
        return -EARTH.radius * harmonics.inverse_laplacian(inflow)

    streamfunction, height = potential(v, -u), grid.coefficients(z)[wanted]
    if balanced:
        return harmonics.BalancedFlow(streamfunction, EARTH, height[0, 0].real).state
    parts = np.stack([height, streamfunction, potential(u, v)])

    def filtered(lon: Array, lat: Array) -> tuple[Array, Array, Array]:
        value, east, north = harmonics.synthesis(parts, lon, lat)
        slopes = (east[2] - north[1]) / EARTH.radius, (north[2] + east[1]) / EARTH.radius
        return *slopes, value[0]

    return filtered


def _read_analysis(path: Path) -> list[Array]:
    """Return latitudes from south to north, longitudes [rad], u, v [m s-1] and z [m] of a file.

    Raises ConfigError if the file is missing, damaged, or not as described in the module.
    """
    import netCDF4

    try:
        with netCDF4.Dataset(path) as dataset:
            lat, lon = _axis(dataset, "lat"), _axis(dataset, "lon")
            _check_grid(lat, lon)
            order, dims = np.argsort(lat[1]), [lat[0].dimensions[0], lon[0].dimensions[0]]
            fields = [_field(dataset, name, dims)[order] for name in "uvz"]
            return [np.radians(lat[1])[order], np.radians(lon[1]), *fields]
    except (OSError, RuntimeError, AttributeError, TypeError, ValueError) as error:
        why = getattr(error, "strerror", None) or "damaged, or not a netCDF file"
        raise ConfigError(f"cannot read {path}: {why}") from None
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from None


def _variable(dataset: Any, ours: str) -> Any:
    for name in KNOWN["names"][ours]:
        if name in dataset.variables:
            return dataset[name]
    wanted = "; u, v and z are needed" if ours in "uvz" else ""
    raise ConfigError(f"there is no variable {' or '.join(KNOWN['names'][ours])}{wanted}")


def _axis(dataset: Any, ours: str) -> tuple[Any, Array]:
    """Return the variable of latitudes ("lat") or longitudes ("lon"), and its values [degrees]."""
    variable = _variable(dataset, ours)
    if variable.ndim != 1 or variable.size < 8:
        raise ConfigError(f"{variable.name} must have one dimension and at least 8 values")
    if not (units := getattr(variable, "units", "degrees")).startswith("degree"):
        raise ConfigError(f"{variable.name} must be in degrees, got {units!r}")
    return variable, _numbers(variable)


def _check_grid(lat: tuple[Any, Array], lon: tuple[Any, Array]) -> None:
    name, values = lat[0].name, lat[1]
    steps, largest = np.diff(values), np.abs(values).max()
    if not (np.all(steps > 0.0) or np.all(steps < 0.0)):
        raise ConfigError(f"{name} must rise or fall from pole to pole")
    if largest > 90.0 + 1e-6:
        raise ConfigError(f"{name} must lie between -90 and 90, got {largest:g}")
    gap = max(90.0 - values.max(), 90.0 + values.min())
    if gap > 1.5 * np.abs(steps).max():
        raise ConfigError(f"{name} must reach the poles; {gap:.3g} degrees are missing")
    name, count = lon[0].name, lon[1].size
    if count % 2:
        raise ConfigError(
            f"{name} must be an even number of values, got {count} (is the first one repeated?)"
        )
    step = 360.0 / count
    if np.abs(np.diff(lon[1]) - step).max() > 1e-3 * step:
        raise ConfigError(f"{name} must be {count} equal steps of {step:.4g} degrees eastward")


def _field(dataset: Any, ours: str, dims: list[str]) -> Array:
    """Return "u", "v" [m s-1] or "z" [m] as (latitudes, longitudes), named `dims` in the file."""
    variable = _variable(dataset, ours)
    units = str(getattr(variable, "units", "")).strip()
    known = dict.fromkeys(KNOWN["units"][ours], 1.0)
    if ours == "z":
        known |= dict.fromkeys(KNOWN["units"]["geopotential"], 1.0 / EARTH.gravity)
    if units not in known:
        wanted = "'m' (height) or 'm2 s-2' (geopotential)" if ours == "z" else "'m s-1'"
        raise ConfigError(f"{variable.name} must have units {wanted}, got {units!r}")
    sizes = dict(zip(variable.dimensions, variable.shape, strict=True))
    levels = {d: _level(dataset, d) for d in sizes if d not in dims}
    kept = [d for d, n in sizes.items() if n > 1 and not isinstance(levels.get(d), int)]
    if sorted(kept) != sorted(dims):
        shape = ", ".join(f"{d}={n}" for d, n in sizes.items())
        raise ConfigError(
            f"{variable.name} must be on ({', '.join(dims)}), got ({shape}): select one"
            " level and one time"
        )
    values = _numbers(variable, tuple(levels.get(d, slice(None)) for d in sizes)).squeeze()
    return known[units] * (values if kept == dims else values.T)


def _level(dataset: Any, axis: str) -> int | slice:
    """Return the index of 500 hPa on an axis of pressures, or a slice of all of any other axis."""
    variable = dataset.variables.get(axis)
    if (factor := KNOWN["pressure"].get(getattr(variable, "units", ""))) is None:
        return slice(None)
    if (found := np.flatnonzero(np.isclose(variable[:] * factor, 5e4))).size != 1:
        raise ConfigError(f"{axis} lacks the level of 500 hPa")
    return int(found[0])


def _numbers(variable: Any, key: Any = slice(None)) -> Array:
    values = np.ma.filled(np.ma.asarray(variable[key], dtype=np.float64), np.nan)
    if missing := int(np.count_nonzero(~np.isfinite(values))):
        raise ConfigError(
            f"{variable.name} has {missing} missing or infinite values; there must be none"
        )
    return np.asarray(values)
