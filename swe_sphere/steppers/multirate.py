"""Multirate steppers: gravity waves in short sub-steps, all other terms in long steps."""

import math
from dataclasses import replace
from typing import ClassVar

import numpy as np
import warp as wp

from swe_sphere.arrays import Array
from swe_sphere.equations.model import Model
from swe_sphere.equations.spectrum import SpectralRadii
from swe_sphere.errors import ConfigError
from swe_sphere.kernels.assembly import drift, kick
from swe_sphere.kernels.dynamics import gradient, transport
from swe_sphere.kernels.local import field_kernel
from swe_sphere.solvers.gravity_waves import INERTIAL
from swe_sphere.steppers.flow_limit import FlowLimitStepper, strongest_advection, wind_share
from swe_sphere.steppers.imex_runge_kutta import scaled_rows
from swe_sphere.steppers.stability import Complex, Rows, check_order, tableau
from swe_sphere.steppers.stepper import read_methods

STAGES = 3
ANGLE = 1.2
"""Largest phase change [rad] of the fastest gravity wave in a sub-step."""


class MultirateInfinitesimalStep(FlowLimitStepper):
    """Multirate infinitesimal step: each Runge-Kutta stage integrates the gravity waves.

    Wensch, Knoth & Galant 2009, Knoth & Wensch 2014 (doi:10.1175/MWR-D-13-00068.1; source of the
    coefficients). With the changes D_j since the start x of the step, D_i is the result of Z' = L Z
    + [sum_j gamma_ij D_j / dt + sum_j beta_ij (F(x + D_j) - L D_j)] / d_i from sum_j alpha_ij D_j
    after the time d_i dt, d_i = sum_j beta_ij. L are the gravity waves on a fluid at rest that is
    as deep as x. L is linear: the term subtracted from F is L of the mean of the D_j with the
    weights beta_ij / d_i, and Z is relative to it. Without gravity waves it is Runge-Kutta.

    `substeps`: least number of sub-steps in a step, not negative; 0: as many as the waves need.
    """

    alpha: ClassVar[Rows]
    """Rows of the second and the third stage, like those of `gamma`."""
    beta: ClassVar[Rows]
    gamma: ClassVar[Rows]
    reach, tries = 60.0, 120
    repeats_from = 0

    @classmethod
    def complete(cls) -> None:
        alpha, beta, gamma = cls._matrices()
        *rows, b = np.linalg.solve(np.eye(STAGES) - alpha - gamma, beta)
        check_order(cls, np.array([np.zeros(STAGES), *rows]), weights=b)

    def __init__(self, model: Model, dt: float, substeps: int = 0) -> None:
        super().__init__(model, dt)
        if substeps < 0:
            raise ConfigError(f"substeps: must be 0 or more, got {substeps}")
        model, alpha, beta, gamma = self.model, *self._matrices()
        self._durations = dt * beta.sum(axis=1)
        times = [0.0]
        for i, row in enumerate(alpha + gamma):
            times.append(self._durations[i] + row[:i] @ times[1:])
        self._offsets, self._steps = times[:STAGES], [1] * STAGES
        """Times of the slopes since the start of the step [s], and the sub-steps."""
        self._fast: FastWaves | None = None
        if model.scene.effect("pressure-gradient") is not None:
            self._fast, start = FastWaves(model), model.initial_state()
            radius = (1.0 - wind_share(model, start)) * model.spectral_radii(start).wave
            self._steps = substep_counts(beta, max(dt * radius, ANGLE * substeps))
        self._moved = model.zeros() if self._fast is None else self._fast.state
        self._rate, self._stage, self._nothing = (model.zeros() for _ in range(3))
        stack = wp.zeros((2 * STAGES - 1, model.size), dtype=self.state.dtype, device=model.device)
        self._changes = [stack[0], stack[1], self._moved]
        self._slopes = [stack[2 + i] for i in range(STAGES)]
        weights = beta / beta.sum(axis=1)[:, None]
        mean, rates = weights[:, 1:], np.hstack([gamma[:, :2] / self._durations[:, None], weights])
        self._starts, self._rates, self._means = (
            [scaled_rows(stack, row) for row in rows] for rows in (alpha[:, :2] - mean, rates, mean)
        )
        model.counters["fast_steps"] = 0

    def advance(self) -> None:
        model, x, stage, combine = self.model, self.state, self.state, self.model.launch.combine
        for i, change in enumerate(self._changes):
            model.tendency(stage, self.time + self._offsets[i], self._slopes[i])
            combine(self._nothing, *self._starts[i], out=self._moved)
            combine(self._nothing, *self._rates[i], out=self._rate)
            if self._fast is None:
                combine(self._moved, self._rate, self._durations[i], out=self._moved)
            else:
                rest = model.point_of_tangent(x)
                self._fast.move(rest, self._rate, self._durations[i], self._steps[i], x)
                model.counters["fast_steps"] += self._steps[i]
            combine(self._moved, *self._means[i], out=change)
            stage = self._stage if i + 1 < STAGES else x
            combine(x, change, 1.0, out=stage)

    @classmethod
    def _matrices(cls) -> tuple[Array, Array, Array]:
        return tableau(cls.alpha, STAGES), tableau(cls.beta, STAGES), tableau(cls.gamma, STAGES)

    @classmethod
    def spectral_radii(cls, model: Model, state: wp.array, t: float = 0.0) -> SpectralRadii:
        """Return spectral radii [s-1], with the slow rate in place of the wind's share.

        The slow rate is the largest of the wind's share, the strongest advection of a trial run,
        and INERTIAL times the Coriolis parameter, which limits the waves as a wind does.
        """
        found = super().spectral_radii(model, state, t)
        if model.scene.effect("pressure-gradient") is None:
            return found
        slow = max(found.wind, INERTIAL * found.inertial, strongest_advection(model.inviscid))
        return replace(found, wind=min(slow, found.wave))

    @classmethod
    def propagator(cls, share: float, wave: Complex, wind: Complex, loss: Complex) -> Complex:
        """Return matrices (..., 2, 2) that map (h' sqrt(g/H), u) over a step; see the base."""
        alpha, beta, gamma = cls._matrices()
        x, z, damped = np.eye(2), wave[..., None], (loss - wind)[..., None]
        changes, slopes = np.zeros((2, STAGES, *wave.shape[:-1], 2, 2), complex)
        for i, steps in enumerate(substep_counts(beta, float(np.abs(wave).max()))):
            d, stage = beta[i].sum(), x + changes[i - 1]  # the last one is 0 before its stage
            slopes[i] = damped * stage - z * stage[..., ::-1, :]
            mean = np.tensordot(beta[i, 1:] / d, changes[:-1], 1)
            moved = np.tensordot(alpha[i], changes, 1) - mean
            rate = np.tensordot(gamma[i] / d, changes, 1) + np.tensordot(beta[i] / d, slopes, 1)
            changes[i] = mean + _waves(wave, moved, rate, d, steps)
        return np.asarray(x + changes[-1])


def substep_counts(beta: Array, angle: float) -> list[int]:
    """Return the sub-steps of each stage for waves that turn by `angle` radians in a step."""
    return [max(1, math.ceil(d * angle / ANGLE)) for d in beta.sum(axis=1)]


def _waves(z: Complex, moved: Complex, rate: Complex, duration: float, steps: int) -> Complex:
    """Apply the map of `FastWaves` to (h, u), the rows of `moved`, with L = -z (0 1; 1 0)."""
    tau = duration / steps
    h, u = moved[..., 0, :], moved[..., 1, :]
    u = u + 0.5 * tau * (rate[..., 1, :] - z * h)
    for step in range(steps):
        h = h + tau * (rate[..., 0, :] - z * u)
        part = tau if step + 1 < steps else 0.5 * tau
        u = u + part * (rate[..., 1, :] - z * h)
    return np.stack([h, u], axis=-2)


MIS2, MIS3C = read_methods(MultirateInfinitesimalStep, "MIS2", "MIS3C")


class FastWaves:
    """Solves dV/dt = -g grad h + rate, dh/dt = -div(H V) + rate by Störmer-Verlet sub-steps.

    H is the depth of a state, held constant. Tracers have the flux of their masses at that state,
    so that a constant mixing ratio stays constant: only the time-integrated flux counts, so they
    move along the total displacement of the fluid in one step.
    """

    def __init__(self, model: Model) -> None:
        self._model, mesh = model, model.device_mesh
        n = mesh.size
        self.state = model.zeros()
        """State that is stepped: wind and depth, then tracers or mass flux."""
        self._winds, self._depth = 2 * n, self.state[2 * n : 3 * n]
        types, self._has_carried = mesh.types(), int(model.carried is not None)
        kernels = [field_kernel(types, formula) for formula in (transport(alone=True), gradient)]
        self._transport, self._slope = kernels
        self._geometry = mesh.geometry(types.geometry)
        self._divergence = mesh.scratch(1, types.value)
        self._gradient = mesh.scratch(2, types.value)
        self._drift_kernel, self._kick_kernel = model.launch.compile(mesh.real, drift, kick)
        model.launch.load(*kernels)
        self._path, self._crossed, self._behind = self.state, self.state, slice(0, 0)
        if model.carried is not None:
            self._path = wp.zeros(2 * n, dtype=mesh.real, device=model.device)
            self._crossed, self._behind = model.zeros(), slice(3 * n, model.size)

    def move(
        self, rest: wp.array, rate: wp.array, duration: float, steps: int, mass_state: wp.array
    ) -> None:
        """Advance `state` by a duration [s] in `steps` sub-steps.

        rest: the state whose depth is H; rate: rate of change of all fields apart from the waves;
        mass_state: the state that holds the masses of tracers.
        """
        tau = duration / steps
        self._kick(rate, 0.5 * tau)
        for step in range(steps):
            self._drift(rest, rate, tau, float(step > 0))
            self._kick(rate, tau if step + 1 < steps else 0.5 * tau)
        if self._model.carried is not None:
            self._model.carried.transport(self._path, mass_state, self._crossed)
            moved, gain, crossed = (x[self._behind] for x in (self.state, rate, self._crossed))
            self._model.launch.combine(moved, gain, duration, crossed, 1.0, out=moved)

    def _drift(self, rest: wp.array, rate: wp.array, tau: float, kept: float) -> None:
        launch, mesh, s = self._model.launch, self._model.device_mesh, self.state
        inputs = self._geometry, s, rest, self._winds, 1, self._divergence.values, s
        mesh.over_elements(self._divergence, self._transport, mesh.threads(1), *inputs)
        layout, local = (mesh.places(1), mesh.inverse_area, mesh.size), self._divergence.flat
        carried = self._has_carried, kept, self._path
        launch(self._drift_kernel, mesh.size, *layout, local, tau, rate, s, *carried)

    def _kick(self, rate: wp.array, tau: float) -> None:
        launch, mesh, s = self._model.launch, self._model.device_mesh, self.state
        inputs = self._geometry, s, self._depth, 0, 1, self._gradient.values, s
        mesh.over_elements(self._gradient, self._slope, mesh.threads(1), *inputs)
        layout = mesh.places(2), mesh.inverse_area, mesh.lanes, mesh.size
        local, gravity = self._gradient.flat, self._model.scene.planet.gravity
        launch(self._kick_kernel, mesh.size, *layout, local, gravity, tau, rate, s)
