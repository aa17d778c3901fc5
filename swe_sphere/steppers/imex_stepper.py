"""What all steppers share that treat linear gravity waves implicitly and the rest explicitly."""

from abc import abstractmethod
from dataclasses import replace
from typing import ClassVar

import numpy as np
import warp as wp

from swe_sphere.equations.model import Model
from swe_sphere.equations.spectrum import Spectrum
from swe_sphere.errors import SolverFailed
from swe_sphere.solvers.gravity_waves import GravityWaves, GravityWaveSolver
from swe_sphere.steppers.flow_limit import strongest_advection
from swe_sphere.steppers.solving import SolvingStepper
from swe_sphere.steppers.stability import Complex, largest_step

MUCH_FASTER = 1e4
"""How many times faster than the explicit waves the implicit ones may be in the analysis of
stability."""


class ImexStepper(SolvingStepper):
    """A stepper that solves (I - tau L) x = r, with L of `GravityWaves`, by `_solve`.

    The step is limited by the wind (docs/imex_steps.md).

    `tolerance`: as for `SolvingStepper`, relative to the change of the eliminated state that is
    solved for.  `coriolis`: "explicit", or "implicit" as part of L.  `solver`: that of another
    stepper of the same model, to share; it brings that option.  Raises ConfigError for options out
    of range and for a scene without gravity waves.
    """

    family = "imex"
    safety = 0.85
    faster: ClassVar[float] = 8.0
    """How many times faster than the explicit waves the implicit ones are at least in the analysis
    of stability.  (Waves of nearly one frequency in both parts would grow in any implicit-explicit
    Runge-Kutta method; but such are long ones, whose growth is tiny.)"""

    def __init__(
        self,
        model: Model,
        dt: float,
        tolerance: float | None = None,
        coriolis: str = "explicit",
        solver: GravityWaveSolver | None = None,
    ) -> None:
        super().__init__(model, dt, tolerance)
        self.solver = solver or GravityWaveSolver(GravityWaves(model, coriolis))
        self.waves = self.solver.waves
        self.counters = {"krylov_iterations": 0}
        self._allocate(model)

    def _solve(self, tau: float, r: wp.array, guess: wp.array, out: wp.array) -> None:
        """out (3N,) = (I - tau L)^-1 r, from a guess of its depth (N,).

        Raises SolverFailed where that does not converge.
        """
        self.solver.setup(tau)
        result = self.solver.solve(r, guess, out, self._goal(self.dt))
        self.counters["krylov_iterations"] += result.iterations
        if not result.converged:
            raise SolverFailed(
                f"{self.name}: the gravity waves at {self.time:.0f} s cannot be solved for: "
                f"{result.message}; choose a smaller --dt"
            )

    def costs(self) -> dict[str, float]:
        """Counts of the solver, and seconds of its set-up."""
        mine = {"setups": self.solver.setups, "setup_seconds": self.solver.setup_seconds}
        return super().costs() | mine

    @classmethod
    def spectrum(cls, model: Model, state: wp.array, t: float = 0.0) -> Spectrum:
        """Spectral radii [s-1] of what is stepped explicitly, which `stable_dt` asks for.

        Of the advection at the strongest wind of a trial run: see `strongest_advection`.
        """
        at_start = GravityWaves(model.inviscid).explicit_spectrum(state, t)
        wave = max(at_start.wave, strongest_advection(model))
        return replace(at_start, wave=wave)

    @classmethod
    def stable_dt(cls, wave: float, dissipation: float = 0.0) -> float:
        """Largest step [s] that amplifies no mode, the implicit waves being far faster.

        `wave` is the spectral radius of the explicit part, F - L: see `spectrum`.  With that of the
        whole right-hand side in its place the step is shorter than it needs to be.
        """

        def growth(z_wave: Complex, z_dissipation: Complex) -> np.ndarray:
            faster = np.geomspace(cls.faster, MUCH_FASTER, 40)
            factors = np.concatenate([-faster, [0.0], faster])
            z_implicit = factors.reshape(-1, *(1 for _ in z_wave.shape)) * z_wave
            largest: np.ndarray = cls._growth(z_implicit, z_wave, z_dissipation).max(axis=0)
            return largest

        return largest_step(growth, wave, dissipation, reach=8.0)

    @classmethod
    @abstractmethod
    def _growth(cls, z_implicit: Complex, z_wave: Complex, z_dissipation: Complex) -> np.ndarray:
        """Largest amplification factor for these eigenvalues times dt of the three parts."""


def depth_of(vector: wp.array, nodes: int) -> wp.array:
    """The depths (N,) of a vector (3N, ...) for N nodes, in its memory."""
    return vector[2 * nodes : 3 * nodes]
