"""What a scene consists of: data, and formulas by the kinds of their arguments and results."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from swe_sphere.arrays import Array
from swe_sphere.equations.effects import Effect
from swe_sphere.planet import EARTH, Planet

Scalar = Callable[[Array, Array], Array]
"""(lon, lat) [rad] -> one value a point."""
State = Callable[[Array, Array], tuple[Array, Array, Array]]
"""(lon, lat) [rad] -> eastward wind, northward wind [m s-1], fluid depth [m]."""
UnsteadyState = Callable[[Array, Array, float], tuple[Array, Array, Array]]
"""(lon, lat, t) [rad, rad, s] -> eastward wind, northward wind [m s-1], fluid depth [m]."""
Rates = Callable[[Array, Array, float], tuple[Array, Array, Array]]
"""(lon, lat, t) [rad, rad, s] -> rates of change of the winds [m s-2] and of depth [m s-1]."""
UnsteadyTracers = Callable[[Array, Array, float], Mapping[str, Array]]
"""(lon, lat, t) [rad, rad, s] -> mixing ratios by name."""
Wind = Callable[[Array, Array, float], tuple[Array, Array]]
"""(lon, lat, t) [rad, rad, s] -> eastward wind, northward wind [m s-1]."""
Parameter = float | bool | str
"""Value of a scene parameter: a number (also a whole one), a switch, a word or a path."""


@dataclass(frozen=True)
class SceneFields:
    """The attributes of a `Scene`, not yet checked."""

    name: str
    effects: tuple[Effect, ...]
    initial: State
    title: str = ""
    """Title of files and pages; empty: the name."""
    reference: str = ""
    """The paper, with its DOI."""
    report: str = ""
    """What is worth reporting, in words."""
    ne: int = 16
    """Recommended number of elements along the edge of a cube face."""
    np: int = 4
    """Recommended number of nodes along the edge of an element."""
    dt: float | None = None
    """Recommended time step [s], stable for rk4 at this ne and np; None: chosen by the stepper."""
    days: float = 5.0
    """Recommended length of the run [days]."""
    planet: Planet = EARTH
    exact: UnsteadyState | None = None
    bottom: Scalar | None = None
    """Height of the bottom [m]; there if and only if the scene has orography."""
    coriolis: Scalar | None = None
    """Coriolis parameter [s-1], only with rotation; None: that of the planet, 2 Ω sin θ."""
    wind: Wind | None = None
    """The wind, if and only if it is prescribed."""
    steady_wind: bool = False
    """Whether the prescribed wind is the same at all times, so that it need be evaluated once."""
    forcing: Rates | None = None
    """Rates of change whatever the state is; there if and only if the scene has forcing."""
    steady_forcing: bool = False
    """Whether the forcing is the same at all times, so that it need be evaluated once."""
    base: State | None = None
    """The flow that the dynamics are linearised about, if and only if they are."""
    equilibrium: Scalar | None = None
    """Depth [m] that relaxation pulls to, if and only if there is relaxation."""
    tracers: Mapping[str, Scalar] | None = None
    """Initial mixing ratios by name, in any unit; there if and only if the scene has tracers."""
    exact_tracers: UnsteadyTracers | None = None
    """What is known of the tracers at later times; NaN at those where nothing is."""
    error_field: str = "h"
    """Errors of height are those of the fluid depth ("h") or of the free surface ("surface")."""
    sheds_waves: bool = False
    """Whether the start sheds gravity waves, so that depth alone does not rank steppers."""
    parameters: Mapping[str, Parameter] = field(default_factory=dict)
    """The scene parameters (alpha, ...) this scene was made with."""
