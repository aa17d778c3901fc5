"""Multirate steppers: gravity waves in short steps of their own, all else in long ones."""

import math
from dataclasses import replace
from typing import ClassVar

import numpy as np
import warp as wp
from numpy.typing import NDArray

from swe_sphere.equations.fast_waves import FastWaves
from swe_sphere.equations.model import Model
from swe_sphere.equations.spectrum import Spectrum
from swe_sphere.errors import ConfigError
from swe_sphere.kernels import combine_kernel
from swe_sphere.solvers.gravity_waves import INERTIAL
from swe_sphere.steppers.combinations import Combiner
from swe_sphere.steppers.flow_limit import FlowLimited, columns, strongest_advection, wind_share
from swe_sphere.steppers.stability import Complex, tableau

Rows = tuple[tuple[float, ...], ...]
Matrix = NDArray[np.float64]

STAGES = 3
ANGLE = 1.2
"""Radians by which the fastest gravity wave turns in a sub-step, at most."""


class InfinitesimalStep(FlowLimited):
    """Multirate infinitesimal step: the stages of a Runge-Kutta method are flows of the waves.

    Wensch, Knoth & Galant 2009, Knoth & Wensch 2014 (doi:10.1175/MWR-D-13-00068.1; from there the
    coefficients).  With the changes D_j since the start x of the step, D_i is what
    Z' = L Z + [sum_j gamma_ij D_j / dt + sum_j beta_ij (F - L)(x + D_j)] / d_i makes of
    sum_j alpha_ij D_j in the time d_i dt, d_i = sum_j beta_ij.  L are the gravity waves on a fluid
    at rest that is as deep as x.  It is linear: what is subtracted from F is L of the mean of the
    D_j with the weights beta_ij / d_i, and Z is counted from that mean.  Where there are no gravity
    waves a Runge-Kutta method is left.

    `substeps`: the least number of sub-steps in a step; 0: as many as the waves need.  Raises
    ConfigError where it is negative.
    """

    alpha: ClassVar[Rows]
    """Rows of the second and the third stage, as those of `gamma`."""
    beta: ClassVar[Rows]
    gamma: ClassVar[Rows]
    reach, looks = 60.0, 120
    repeats_from = 0

    def __init__(self, model: Model, dt: float, substeps: int = 0) -> None:
        super().__init__(model, dt)
        if substeps < 0:
            raise ConfigError(f"substeps: must be 0 or more, not {substeps}")
        model, alpha, beta, gamma = self.model, *self._matrices()
        self._durations = dt * beta.sum(axis=1)
        self._offsets, self._steps = self._times(), [1] * STAGES
        self._fast: FastWaves | None = None
        if model.scene.effect("pressure-gradient") is not None:
            self._fast, start = FastWaves(model), model.initial_state()
            radius = (1.0 - wind_share(model, start)) * model.spectrum(start).wave
            self._steps = substep_counts(beta, max(dt * radius, ANGLE * substeps))
        self._moved = model.zeros() if self._fast is None else self._fast.state
        self._rate, self._stage, self._nothing = (model.zeros() for _ in range(3))
        shape = (2 * STAGES - 1, model.size)
        stack = wp.zeros(shape, dtype=self.state.dtype, device=model.device)
        self._changes = [stack[0], stack[1], self._moved]
        self._slopes = [stack[2 + i] for i in range(STAGES)]
        weights = beta / beta.sum(axis=1)[:, None]
        mean, none = weights[:, 1:], np.zeros((STAGES, STAGES))
        rates = gamma[:, :2] / self._durations[:, None]
        self._starts, self._rates, self._means = (
            [Combiner(model, stack, row) for row in np.hstack(parts)]
            for parts in ((alpha[:, :2] - mean, none), (rates, weights), (mean, none))
        )
        self._add = combine_kernel(model.device_mesh.real, 1)
        model.launch.load(self._add)
        model.counters["fast_steps"] = 0

    def advance(self) -> None:
        """Take a step, stage by stage."""
        model, x, stage = self.model, self.state, self.state
        for i, change in enumerate(self._changes):
            model.tendency(stage, self.time + self._offsets[i], self._slopes[i])
            self._starts[i](self._nothing, self._moved)
            self._rates[i](self._nothing, self._rate)
            self._move(self._durations[i], self._steps[i])
            self._means[i](self._moved, change)
            stage = self._stage if i + 1 < STAGES else x
            model.launch(self._add, model.size, x, change, 1.0, stage)

    def _move(self, duration: float, steps: int) -> None:
        """Let the waves and the rate act for a duration [s]."""
        if self._fast is None:
            moved, rate = self._moved, self._rate
            self.model.launch(self._add, self.model.size, moved, rate, duration, moved)
            return
        rest = self.model.point_of_tangent(self.state)
        self._fast.advance(rest, self._rate, duration, steps, self.state)
        self.model.counters["fast_steps"] += steps

    @classmethod
    def _matrices(cls) -> tuple[Matrix, Matrix, Matrix]:
        alpha, beta, gamma = (tableau(rows, STAGES) for rows in (cls.alpha, cls.beta, cls.gamma))
        return alpha, beta, gamma

    def _times(self) -> list[float]:
        """When the slopes are taken, from the start of the step on [s]."""
        alpha, _, gamma = self._matrices()
        found = [0.0]
        for i, row in enumerate(alpha + gamma):
            found.append(self._durations[i] + row[:i] @ found[1:])
        return found[:STAGES]

    @classmethod
    def spectrum(cls, model: Model, state: wp.array, t: float = 0.0) -> Spectrum:
        """Spectral radii [s-1], and in the place of the wind's part in the first the slow one.

        That is of the strongest wind of a trial run, or of the Coriolis force, which limits the
        waves as a wind does: turning alone is not what breaks first.
        """
        found = super().spectrum(model, state, t)
        if model.scene.effect("pressure-gradient") is None:
            return found
        slow = max(found.wind, INERTIAL * found.turning, strongest_advection(model.inviscid))
        return replace(found, wind=min(slow, found.wave))

    @classmethod
    def propagator(
        cls, share: float, z_wave: Complex, z_wind: Complex, z_dissipation: Complex
    ) -> Complex:
        """(..., 2, 2) change of (h' sqrt(g/H), u) of a wave by a step, see `FlowLimited`."""
        alpha, beta, gamma = cls._matrices()
        z, wind, loss = columns(z_wave, z_wind, z_dissipation)
        x = np.broadcast_to(np.eye(2, dtype=complex), (*z.shape[:-1], 2, 2))
        nothing = np.zeros_like(x)
        changes: list[Complex] = []
        slopes: list[Complex] = []
        for i, steps in enumerate(substep_counts(beta, float(np.abs(z).max()))):
            d = beta[i].sum()
            stage = x + changes[-1] if changes else x
            slopes.append((loss - wind)[..., None] * stage - z[..., None] * stage[..., ::-1, :])
            parts = list(zip(alpha[i], beta[i, 1:] / d, gamma[i] / d, changes, strict=False))
            mean: Complex = sum((m * each for _, m, _, each in parts), nothing)
            moved: Complex = sum((a * each for a, _, _, each in parts), -mean)
            rate = sum((g * each for _, _, g, each in parts), nothing)
            rate = rate + sum(b / d * each for b, each in zip(beta[i], slopes, strict=False))
            changes.append(mean + _waves(z, moved, rate, d, steps))
        return x + changes[-1]


def substep_counts(beta: Matrix, angle: float) -> list[int]:
    """Sub-steps of each stage where waves turn by so many radians in a step."""
    return [max(1, math.ceil(d * angle / ANGLE)) for d in beta.sum(axis=1)]


def _waves(z: Complex, moved: Complex, rate: Complex, duration: float, steps: int) -> Complex:
    """What `FastWaves` does to (h, u), the rows of `moved`, with L = -z (0 1; 1 0)."""
    tau = duration / steps
    h, u = moved[..., 0, :], moved[..., 1, :]
    u = u + 0.5 * tau * (rate[..., 1, :] - z * h)
    for step in range(steps):
        h = h + tau * (rate[..., 0, :] - z * u)
        part = tau if step + 1 < steps else 0.5 * tau
        u = u + part * (rate[..., 1, :] - z * h)
    return np.stack([h, u], axis=-2)


class MIS2(InfinitesimalStep):
    """Split-explicit: three stages, gravity waves in short steps inside of them; second order.

    It amplifies what a wind carries by a little at any step: automatic steps are so short that it
    is 1e-4 a step, no longer than those of `rk4`, which is cheaper.
    """

    name, order = "mis2", 2
    style = ("#9AD396", (11, 1, 0))
    alpha = ((0.536946566710,), (0.480892968551, 0.500561163566))
    beta = (
        (0.126848494553,),
        (-0.784838278826, 1.37442675268),
        (-0.0456727081749, -0.00875082271190, 0.524775788629),
    )
    gamma = ((0.652465126004,), (-0.0732769849457, 0.144902430420))


class MIS3C(InfinitesimalStep):
    """Split-explicit: the same, but of third order where all is slow, and stable in moderate winds.

    What it leaves of the waves is of second order whatever their sub-steps.
    """

    name, order = "mis3c", 2
    style = ("#2350FD", (12, 1, 0))
    alpha = ((0.589557277145,), (0.544036601551, 0.565511042564))
    beta = (
        (0.397525189225,),
        (-0.227036463644, 0.624528794618),
        (-0.00295238076840, -0.270971764284, 0.671323159437),
    )
    gamma = ((0.142798786398,), (-0.0428918957402, 0.0202720980282))
