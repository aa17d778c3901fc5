"""Steppers that treat linear gravity waves implicitly and all other terms explicitly."""

from abc import abstractmethod
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
import warp as wp

from swe_sphere.arrays import Array
from swe_sphere.equations.model import Model
from swe_sphere.equations.spectrum import SpectralRadii
from swe_sphere.errors import ConfigError
from swe_sphere.solvers.gravity_waves import explicit_radii, reference_depth
from swe_sphere.steppers import stability
from swe_sphere.steppers.flow_limit import strongest_advection
from swe_sphere.steppers.stability import Complex, Rows, tableau
from swe_sphere.steppers.stage_solver import WaveSolver
from swe_sphere.steppers.stepper import Stepper, read_methods

MUCH_FASTER = 1e4
"""Largest ratio of implicit to explicit wave frequencies in the analysis of stability."""


class ImexStepper(Stepper):
    """A stepper with a solver of linear gravity waves L; the wind limits its step (docs/results).

    `tolerance`: see `StageSolver`; `solver`: that of another stepper, with its tolerance, to share.
    """

    family, reach, long_run_factor = "imex", 8.0, 0.6
    least_ratio: ClassVar[float] = 8.0
    """Least ratio of implicit to explicit wave frequencies in the analysis of stability."""
    wind_factor: ClassVar[float] = 1.0
    """Factor of the explicit rate in winds faster than a third of the gravity waves."""
    solver: WaveSolver

    def __init__(
        self, model: Model, dt: float, tolerance: float | None = None,
        solver: WaveSolver | None = None,
    ) -> None:  # fmt: skip
        self.solver = solver or WaveSolver(model, self.solver_tolerance(tolerance), self.name)
        super().__init__(model, dt)
        self.space = self.solver.space
        self._depth = slice(2 * model.device_mesh.size, 3 * model.device_mesh.size)
        self.allocate()

    @classmethod
    def spectral_radii(cls, model: Model, state: wp.array, t: float = 0.0) -> SpectralRadii:
        """Return the rates [s-1] that limit explicit steps of F - L (see `explicit_radii`).

        They include the advection of a trial run; all times `wind_factor` in strong winds. If the
        initial wind is faster than the gravity waves, the Coriolis force adds to advection.
        """
        fastest = np.sqrt(model.scene.planet.gravity * reference_depth(model).max())
        at_start, wind = explicit_radii(model.inviscid, state, t), model.strongest_wind
        wave = max(at_start.wave, strongest_advection(model))
        wave *= cls.wind_factor if 3.0 * wind > fastest else 1.0
        if wind > fastest:
            wave += float(np.abs(model.coriolis).max())
        return replace(at_start, wave=wave)

    @classmethod
    def amplification(cls, z_wave: Complex, z_dissipation: Complex) -> Array:
        """Return the largest amplification factors for implicit waves faster than explicit ones."""
        of_faster = np.geomspace(cls.least_ratio, MUCH_FASTER, 40)
        factors = np.concatenate([-of_faster, [0.0], of_faster])
        z_implicit = factors.reshape(-1, *(1 for _ in z_wave.shape)) * z_wave
        return np.asarray(cls.split_factor(z_implicit, z_wave, z_dissipation).max(0))

    @classmethod
    @abstractmethod
    def split_factor(cls, z_implicit: Complex, z_wave: Complex, z_dissipation: Complex) -> Array:
        """Return the largest amplification factors, given also implicit eigenvalues times dt."""


def scaled_rows(stack: wp.array, factors: Array) -> list[Any]:
    """Return the rows of a stack, each followed by its factor, for `Launcher.combine`."""
    return [each for row, c in enumerate(factors) if c != 0.0 for each in (stack[row], float(c))]


class ImexRungeKutta(ImexStepper):
    """Y_i = x + dt sum_j (explicit_ij N(Y_j) + implicit_ij L Y_j), N = F - L; one solve a stage.

    The first stage is x. The unknown is the change Y_i - x, so that the solver's tolerance is
    relative to the change; the solved equation implies L Y_i, whose guess is that of the last step.
    """

    memory = "state", "slopes"  # linear slopes of depth in the last step
    explicit: ClassVar[Rows]
    """Rows below the diagonal, from the second stage on."""
    implicit: ClassVar[Rows]
    """Rows up to and with the diagonal, from the second stage on; one diagonal for all."""
    b: ClassVar[tuple[float, ...]]
    """Weights of both parts."""

    @classmethod
    def complete(cls) -> None:
        explicit = stability.checked_tableau(cls, "explicit", first=1, diagonal=False)
        implicit = stability.checked_tableau(cls, "implicit", first=1)
        diagonal = [row[-1] for row in cls.implicit]
        if len({*diagonal}) != 1 or not diagonal[0] > 0.0:
            raise ConfigError(
                f"stepper {cls.name}: the last numbers in the rows of `implicit`, its diagonal,"
                f" must be equal and positive, got {diagonal}"
            )
        stability.check_order(cls, explicit, implicit)
        cls.error_constant = stability.error_constant(implicit, np.array(cls.b), cls.order)

    def allocate(self) -> None:
        model, mesh, dt, stages = self.model, self.model.device_mesh, self.dt, len(self.b)
        stack = self.space.stack(2 * stages)
        self._full = [stack[i] for i in range(stages)]
        self._linear = [stack[stages + i] for i in range(stages)]
        self.slopes = wp.zeros((stages, mesh.size), dtype=mesh.real, device=model.device)
        states = (model.zeros() for _ in range(5))
        self._rhs, self._change, self._stage, self._known, self._nothing = states
        self._guess = wp.zeros_like(self.slopes[0])
        a_e, a_i = tableau(self.explicit, stages), tableau(self.implicit, stages)
        self._tau, self._offsets = dt * self.implicit[0][-1], dt * a_e.sum(axis=1)
        rows = (np.concatenate([e, np.tril(a_i, -1)[i] - e]) for i, e in enumerate(a_e))
        self._sums = [scaled_rows(stack, dt * row) for row in rows]
        self._last = scaled_rows(stack, dt * np.array(self.b))

    def make_guesses(self, slope: wp.array) -> None:
        """Guess the linear part of the initial slope for all stages."""
        self.solver.waves.linearise(self.state)
        self.solver.waves.apply(self.state, self._linear[0])
        for i in range(len(self.b)):
            wp.copy(self.slopes[i], self._linear[0][self._depth])

    def advance(self) -> None:
        combine, tau = self.model.launch.combine, self._tau
        self.solver.aim(self.state, self.error_constant, self.order, self.dt)
        self.solver.waves.linearise(self.state)
        self.model.tendency(self.state, self.time, self._full[0])
        self.solver.waves.apply(self.state, self._linear[0])
        for i in range(1, len(self.b)):
            # the change Y_i - x, and L Y_i
            combine(self._nothing, *self._sums[i], out=self._known)
            self.space.axpby(tau, self._linear[0], 1.0, self._known, self._rhs)
            combine(self._known[self._depth], self.slopes[i], tau, out=self._guess)
            self.solver.solve(tau, self.time, self._rhs, self._guess, self._change)
            slope = self._linear[i]
            self.space.axpby(-1.0 / tau, self._known, 1.0 / tau, self._change, slope)
            wp.copy(self.slopes[i], slope[self._depth])
            self.space.axpby(1.0, self._change, 1.0, self.state, self._stage)
            self.model.tendency(self._stage, self.time + self._offsets[i], self._full[i])
        combine(self.state, *self._last, out=self._stage)
        self.solver.accept(self.state, self._stage, self.dt)
        self.space.copy(self._stage, self.state)

    @classmethod
    def split_factor(cls, z_implicit: Complex, z_wave: Complex, z_dissipation: Complex) -> Array:
        a_e, a_i = (tableau(rows, len(cls.b)) for rows in (cls.explicit, cls.implicit))
        b = np.array(cls.b)
        return stability.runge_kutta_factor(b, (a_e, z_wave + z_dissipation), (a_i, z_implicit))


ARK2, ARS343 = read_methods(ImexRungeKutta, "ARK2", "ARS343")
