"""Types of the names of the package, which are imported when they are first used."""

from swe_sphere.analysis.accessor import open_run
from swe_sphere.equations.effects import (
    DYNAMICS,
    MASSES,
    Effect,
    Orography,
    PointwiseEffect,
    Rotation,
    Tracers,
)
from swe_sphere.equations.scene import Scene
from swe_sphere.errors import ConfigError
from swe_sphere.mesh import Mesh
from swe_sphere.planet import EARTH, Planet
from swe_sphere.simulation.config import Output
from swe_sphere.simulation.diagnostics import diagnostic
from swe_sphere.simulation.observers import Observer, every
from swe_sphere.simulation.simulation import Simulation
from swe_sphere.solvers.preconditioners import Preconditioner
from swe_sphere.steppers import Stepper, get_stepper, list_steppers
from swe_sphere.steppers.dirk import DiagonallyImplicit
from swe_sphere.steppers.imex_runge_kutta import ImexRungeKutta
from swe_sphere.steppers.runge_kutta import RungeKutta
from swe_sphere.studies.cases import verify
from swe_sphere.studies.sweep import sweep
from swe_sphere.testcases import get_scene, list_scenes

__all__ = [
    "DYNAMICS", "EARTH", "MASSES", "ConfigError", "DiagonallyImplicit", "Effect", "ImexRungeKutta",
    "Mesh", "Observer", "Orography", "Output", "Planet", "PointwiseEffect", "Preconditioner",
    "Rotation", "RungeKutta", "Scene", "Simulation", "Stepper", "Tracers", "__version__",
    "diagnostic", "every", "get_scene", "get_stepper", "list_scenes", "list_steppers", "open_run",
    "sweep", "verify",
]  # fmt: skip

__version__: str
