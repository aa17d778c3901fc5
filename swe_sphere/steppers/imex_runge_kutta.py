"""Implicit-explicit Runge-Kutta methods: a method is its two Butcher tableaus."""

import math
from typing import ClassVar

import numpy as np
import warp as wp
from numpy.typing import NDArray

from swe_sphere.equations.model import Model
from swe_sphere.equations.spectrum import Spectrum
from swe_sphere.solvers.vector_space import VectorSpace
from swe_sphere.steppers.combinations import Combiner
from swe_sphere.steppers.imex_limit import explicit_spectrum, implicit_explicit_step
from swe_sphere.steppers.stability import Complex, error_constant, runge_kutta_growth, tableau
from swe_sphere.steppers.stage_solver import WaveSolver
from swe_sphere.steppers.stepper import Stepper

Rows = tuple[tuple[float, ...], ...]


class ImexRungeKutta(Stepper):
    """Y_i = x + dt sum_j (explicit_ij N(Y_j) + implicit_ij L Y_j), N = F - L; one solve a stage.

    The first stage is x.  Solved for is the change Y_i - x, so that the tolerance of the solver is
    one of the change; L Y_i is what the solved equation implies, and the guess for it is the one of
    a step before.  The step is limited by the wind (docs/imex_steps.md).

    `tolerance`: see `StageSolver`; `coriolis`: see `WaveSolver`; `solver`: the one of another
    stepper of the same model, to share it with its options.
    """

    family = "imex"
    memory = "state", "slopes"  # the linear ones of depth in the last step
    solver: WaveSolver
    faster: ClassVar[float] = 8.0
    """How many times faster than the explicit waves the implicit ones are at least in the analysis
    of stability.  (Waves of nearly one frequency in both parts would grow in any implicit-explicit
    Runge-Kutta method; but such are long ones, whose growth is tiny.)"""

    explicit: ClassVar[Rows]
    """Rows below the diagonal, from the second stage on."""
    implicit: ClassVar[Rows]
    """Rows up to and with the diagonal, from the second stage on; one diagonal for all."""
    b: ClassVar[tuple[float, ...]]
    """The weights of both."""

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        if "name" in vars(cls):
            implicit = tableau(cls.implicit, len(cls.b))
            cls.error_constant = error_constant(implicit, np.array(cls.b), cls.order)

    def __init__(
        self, model: Model, dt: float, tolerance: float | None = None, coriolis: str = "explicit",
        solver: WaveSolver | None = None,
    ) -> None:  # fmt: skip
        super().__init__(model, dt)
        self.solver = solver or WaveSolver(
            model, self.solver_tolerance(tolerance), coriolis, self.name
        )
        self.counters, self.space = self.solver.counters, self.solver.space
        stages, n, mesh = len(self.b), model.device_mesh.size, model.device_mesh
        self._tau = dt * self.implicit[0][-1]
        stack = self.space.stack(2 * stages)
        self._full = [stack[i] for i in range(stages)]
        self._linear = [stack[stages + i] for i in range(stages)]
        self.slopes = wp.zeros((stages, n), dtype=mesh.real, device=model.device)
        self._past = [self.slopes[i] for i in range(stages)]
        self._rhs, self._change, self._stage, self._known, self._nothing = (
            model.zeros() for _ in range(5)
        )
        self._guess = wp.zeros(n, dtype=mesh.real, device=model.device)
        self._depth = slice(2 * n, 3 * n)
        self._depths = VectorSpace(model.mesh.area, mesh=mesh)
        a_e, a_i = tableau(self.explicit, stages), tableau(self.implicit, stages)
        self._sums = [
            Combiner(model, stack, dt * np.concatenate([e, np.tril(a_i, -1)[i] - e]))
            for i, e in enumerate(a_e)
        ]
        self._last = Combiner(model, stack, dt * np.array(self.b))
        self._offsets = dt * a_e.sum(axis=1)

    def begin(self, slope: wp.array) -> None:
        """Guess the linear part of the slope at the start for all stages."""
        self.solver.waves.linearise(self.state)
        self.solver.waves.apply(self.state, self._linear[0])
        for guess in self._past:
            wp.copy(guess, self._linear[0][self._depth])

    def advance(self) -> None:
        """Take a step, stage by stage."""
        self.solver.aim(self.state, self.error_constant, self.order, self.dt)
        self.solver.waves.linearise(self.state)
        self.model.tendency(self.state, self.time, self._full[0])
        self.solver.waves.apply(self.state, self._linear[0])
        for i in range(1, len(self.b)):
            self._solve_stage(i)
            self.space.copy(self.state, self._stage)
            self.space.axpy(1.0, self._change, self._stage)
            self.model.tendency(self._stage, self.time + self._offsets[i], self._full[i])
        self._last(self.state, self._stage)
        self.solver.motion.accept(self.state, self._stage, self.dt)
        self.space.copy(self._stage, self.state)

    def _solve_stage(self, i: int) -> None:
        """The change Y_i - x, and L Y_i."""
        self._sums[i](self._nothing, self._known)
        self.space.copy(self._known, self._rhs)
        self.space.axpy(self._tau, self._linear[0], self._rhs)
        wp.copy(self._guess, self._known[self._depth])
        self._depths.axpy(self._tau, self._past[i], self._guess)
        self.solver.solve(self._tau, self.time, self._rhs, self._guess, self._change)
        slope = self._linear[i]
        self.space.copy(self._change, slope)
        self.space.axpby(-1.0 / self._tau, self._known, 1.0 / self._tau, slope)
        wp.copy(self._past[i], slope[self._depth])

    @classmethod
    def spectrum(cls, model: Model, state: wp.array, t: float = 0.0) -> Spectrum:
        """Spectral radii [s-1] of the explicit part: see `explicit_spectrum`."""
        return explicit_spectrum(model, state, t)

    @classmethod
    def stable_dt(cls, wave: float, dissipation: float = 0.0) -> float:
        """Largest step [s] that amplifies no mode: see `implicit_explicit_step`."""

        a_e, a_i = (tableau(rows, len(cls.b)) for rows in (cls.explicit, cls.implicit))

        def growth(z_implicit: Complex, z_wave: Complex, z_loss: Complex) -> NDArray[np.float64]:
            return runge_kutta_growth(np.array(cls.b), (a_e, z_wave + z_loss), (a_i, z_implicit))

        return implicit_explicit_step(growth, wave, dissipation, cls.faster)


class ARK2(ImexRungeKutta):
    """Semi-implicit Runge-Kutta: second order, L-stable waves, two solves a step.

    ARK2 of Giraldo, Kelly & Constantinescu 2013 (doi:10.1137/120876034), eqs. 3.9-3.11.
    """

    name, order = "ark2", 2
    style = ("#832121", "v")
    faster = 12.0  # what is nearer to the implicit waves grows by 1e-3 a step and less
    _g, _w = 1.0 - math.sqrt(0.5), 0.25 * math.sqrt(2.0)
    _a32 = (3.0 + 2.0 * math.sqrt(2.0)) / 6.0
    explicit = ((2.0 * _g,), (1.0 - _a32, _a32))
    implicit = ((_g, _g), (_w, _w, _g))
    b = (_w, _w, _g)


class ARS343(ImexRungeKutta):
    """Semi-implicit Runge-Kutta: third order, L-stable waves, three solves a step.

    Ascher, Ruuth & Spiteri 1997 (doi:10.1016/S0168-9274(97)00056-1), section 2.7.
    """

    name, order = "ars343", 3
    style = ("#C44931", "P")
    # where the depth differs from that of the implicit part by a third and more, as much of the
    # gravity waves is explicit: there this method grows (semi-implicit leapfrog does not)
    faster = 2.5
    _g = 0.4358665215084590
    _b1, _b2 = -1.5 * _g**2 + 4.0 * _g - 0.25, 1.5 * _g**2 - 5.0 * _g + 1.25
    _a42 = _a43 = 0.5529291480359398
    _a31 = (
        (1.0 - 4.5 * _g + 1.5 * _g**2) * _a42
        + (2.75 - 10.5 * _g + 3.75 * _g**2) * _a43
        - 3.5 + 13.0 * _g - 4.5 * _g**2
    )  # fmt: skip
    _a32 = (
        (-1.0 + 4.5 * _g - 1.5 * _g**2) * _a42
        + (-2.75 + 10.5 * _g - 3.75 * _g**2) * _a43
        + 4.0 - 12.5 * _g + 4.5 * _g**2
    )  # fmt: skip
    explicit = ((_g,), (_a31, _a32), (1.0 - _a42 - _a43, _a42, _a43))
    implicit = ((0.0, _g), (0.0, 0.5 * (1.0 - _g), _g), (0.0, _b1, _b2, _g))
    b = (0.0, _b1, _b2, _g)
