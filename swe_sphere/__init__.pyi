"""Types of the names of the package, which are imported when they are first used."""

from .analysis.accessor import open_run
from .equations.effects import (
    DYNAMICS,
    MASSES,
    Effect,
    Orography,
    PointwiseEffect,
    Rotation,
    Tracers,
)
from .equations.scene import Scene
from .errors import ConfigError
from .mesh import Mesh
from .planet import EARTH, Planet
from .simulation.config import Output
from .simulation.diagnostics import diagnostic
from .simulation.observers import Observer, every
from .simulation.simulation import Simulation
from .solvers.preconditioners import Preconditioner
from .steppers import Stepper, get_stepper, list_steppers
from .steppers.dirk import DiagonallyImplicit
from .steppers.imex_runge_kutta import ImexRungeKutta
from .steppers.runge_kutta import RungeKutta
from .studies.cases import verify
from .studies.sweep import sweep
from .testcases import get_scene, list_scenes

__all__ = [
    "DYNAMICS", "EARTH", "MASSES", "ConfigError", "DiagonallyImplicit", "Effect", "ImexRungeKutta",
    "Mesh", "Observer", "Orography", "Output", "Planet", "PointwiseEffect", "Preconditioner",
    "Rotation", "RungeKutta", "Scene", "Simulation", "Stepper", "Tracers",
    "diagnostic", "every", "get_scene", "get_stepper", "list_scenes", "list_steppers", "open_run",
    "sweep", "verify",
]  # fmt: skip

__version__: str
