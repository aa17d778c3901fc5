"""Case 7 of Williamson et al. (1992): from an analysed state of the atmosphere at 500 hPa.

The three analyses of the paper (21 December 1978, 9 and 16 January 1979) are not public any more.
The scene reads any analysis; without one it starts from a synthetic state and says so.
"""

from pathlib import Path

import numpy as np

from swe_sphere.equations.effects import DYNAMICS, Rotation
from swe_sphere.equations.scene import Array, Scene, State
from swe_sphere.errors import ConfigError
from swe_sphere.planet import EARTH
from swe_sphere.testcases.analysis import read_analysis
from swe_sphere.testcases.harmonics import Complex, GaussGrid
from swe_sphere.testcases.random_flow import BalancedFlow, random_streamfunction
from swe_sphere.testcases.recommended import recommended
from swe_sphere.testcases.williamson import PAPER

DEPTH = 1e4
"""Mean depth [m], put in the place of that of the analysis as in the paper."""
DEGREE = 42
"""Highest degree of the synthetic state, that of the paper's analyses."""
HIGHEST = 1000
"""Highest degree that may be asked for."""
JET, EDDIES = 20.0, 12.0
"""Largest zonal-mean wind and root mean square of the rest, of the synthetic state [m s-1]."""


@recommended(ne=12, np=8, dt=150.0, days=5.0)
def williamson7(
    file: Path | None = None, degree: int = 0, balanced: bool = False, seed: int = 1
) -> Scene:
    """Flow at 500 hPa, from a file of analysed winds; without one, SYNTHETIC.

    Case 7, five days from an analysis. The mean of the height is replaced by 10 km.

    Without a file the state is synthetic: jets of 20 m/s in both hemispheres, u ~ cos³ θ sin² θ,
    and random eddies of 12 m/s (root mean square) whose kinetic energy at degree n of the
    spherical harmonics goes as x / (1 + x⁴), x = n / 6, 2 ≤ n ≤ 42; the height is in linear
    balance, g ∇²h = ∇·(f ∇ψ). It is no state that ever was.

    Args:
        file: netCDF file with u, v [m s-1] and z [m, or m2 s-2] on a latitude-longitude grid; see
            `swe_sphere.testcases.analysis` for what it must hold.
        degree: leave out of the file's fields what is above this degree of the spherical
            harmonics; 0: nothing.
        balanced: the file's wind without its divergent part, up to degree (42), and the height of
            the nonlinear balance equation in the place of the file's.
        seed: of the random phases of the synthetic state.

    Raises:
        ConfigError: a file that is not as it must be.
    """
    if file is None:
        if seed < 0:
            raise ConfigError(f"williamson7: seed must not be negative, but is {seed}")
        title, source = "SYNTHETIC 500 hPa-like flow", "SYNTHETIC initial state"
        initial: State = BalancedFlow(_streamfunction(seed), EARTH, DEPTH, linear=True).state
    else:
        title, source = f"500 hPa flow from {file.name}", f"initial state from {file.name}"
        initial = _analysed(file, degree, balanced)

    return Scene(
        name="williamson7",
        title=title,
        reference=f"{source}; the case: {PAPER}, case 7",
        effects=(*DYNAMICS, Rotation()),
        initial=initial,
        report="height at days 1 to 5 against a reference; drift of energy and potential enstrophy",
        parameters={"file": "SYNTHETIC"} if file is None else {},
    )


def _streamfunction(seed: int) -> Complex:
    """Jets and random eddies, as coefficients [m2 s-1]."""

    def spectrum(n: Array) -> Array:
        ratio = n / 6.0
        return ratio / (1.0 + ratio**4)

    found: Complex = random_streamfunction(spectrum, DEGREE, EDDIES, EARTH.radius, seed)
    grid = GaussGrid(5)
    sine = np.sin(grid.points[1])
    # -∂ψ/∂θ / a ~ cos³ θ sin² θ, which is largest where sin² θ = 2/5
    jets = -(sine**3 / 3.0 - sine**5 / 5.0) * EARTH.radius * JET / (0.4 * 0.6**1.5)
    found[:6, :6] += grid.coefficients(jets)
    return found


def _analysed(file: Path, degree: int, balanced: bool) -> State:
    """The state of a file, with a mean depth of 10 km."""
    if not 0 <= degree <= HIGHEST:
        raise ConfigError(f"williamson7: degree must be from 0 to {HIGHEST}, but is {degree}")
    analysis = read_analysis(file)
    mean = analysis.mean_height()
    if analysis.z.min() - mean + DEPTH <= 0.0:
        raise ConfigError(f"{file}: z varies by more than 10 km: is it in m, or m2 s-2 as it says?")

    filtered = degree or balanced
    state: State = analysis.filtered(degree or DEGREE, balanced) if filtered else analysis.state

    def initial(lon: Array, lat: Array) -> tuple[Array, Array, Array]:
        u, v, z = state(lon, lat)
        return u, v, z - mean + DEPTH

    return initial
