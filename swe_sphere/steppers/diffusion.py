"""Viscosity and hyperviscosity on their own, so that they limit no step.

They are linear, symmetric and cheap to keep stable: a Runge-Kutta-Legendre method of s stages
damps all modes up to a rate times step of (s² + s - 2)/2 (Meyer, Balsara & Aslam 2014,
doi:10.1016/j.jcp.2013.08.021, section 2.2: RKL2, of second order).
"""

import warp as wp

from swe_sphere.equations.model import Model
from swe_sphere.kernels.diffusive_stage import diffusive_stage_kernel

__all__ = ["Diffusion", "legendre_stages"]

REACH = 0.75
"""Part of the stable interval that is used: with two or four stages the fastest modes are hardly
damped at its end."""

Stage = tuple[float, float, float, float]


def legendre_stages(reach: float) -> list[Stage]:
    """Coefficients of the second and all later stages for a rate times step of up to `reach`.

    For Y_j = mu Y_(j-1) + nu Y_(j-2) + (1 - mu - nu) Y_0 + rate dt F(Y_(j-1)) + first dt F(Y_0)
    they are (mu, nu, rate, first); the first stage is Euler's, of a third of the next stage's rate
    over its mu.
    """
    stages = 2
    while 0.5 * REACH * (stages**2 + stages - 2) < reach:
        stages += 1
    unit = 4.0 / (stages**2 + stages - 2)
    b = [1 / 3, 1 / 3, *((j**2 + j - 2) / (2 * j * (j + 1)) for j in range(2, stages + 1))]
    found = []
    for j in range(2, stages + 1):
        mu = (2 * j - 1) / j * b[j] / b[j - 1]
        nu = -(j - 1) / j * b[j] / b[j - 2]
        found.append((mu, nu, mu * unit, (b[j - 1] - 1.0) * mu * unit))
    return found


class Diffusion:
    """Steps of dt [s] of dy/dt = D(y) + slope, with D the diffusion of a model."""

    def __init__(self, model: Model, dt: float) -> None:
        self._model, self._dt = model, dt
        self._later = legendre_stages(dt * model.diffusion_radius)
        self._nothing, self._first, self._rate = (model.zeros() for _ in range(3))
        self._stages = model.zeros(), model.zeros()
        self._kernel = diffusive_stage_kernel(model.device_mesh.real)
        model.launch.load(self._kernel)

    @property
    def evaluations(self) -> int:
        """Of D in a step."""
        return 1 + len(self._later)

    def act(self, state: wp.array) -> None:
        """Diffuse the state by itself."""
        self._step(state, self._nothing, state, 0.0, 1.0)

    def join(self, past: wp.array, slope: wp.array) -> None:
        """Make of the slope of all else, held from `past` on, the mean slope of both together.

        Where D(past) and the slope cancel nothing is left of it: steady states stay.
        """
        self._step(past, slope, slope, 1.0, 1.0 / self._dt)

    def _step(
        self, x: wp.array, slope: wp.array, out: wp.array, less: float, scale: float
    ) -> None:
        """out = scale (Y - less x) after a step from x."""
        dt, first, rate, (last, spare) = self._dt, self._first, self._rate, self._stages
        self._model.diffusion(x, first)
        (mu, _, euler, _), *_ = self._later
        euler *= dt / (3.0 * mu)
        self._combine(x, 1.0, x, 0.0, x, 0.0, first, euler, first, 0.0, slope, euler, last)
        before, left = x, len(self._later)
        for mu, nu, a, b in self._later:
            self._model.diffusion(last, rate)
            left -= 1
            keep, by, target = (0.0, 1.0, spare) if left else (less, scale, out)
            a, b = by * dt * a, by * dt * b
            self._combine(
                x, by * (1.0 - mu - nu - keep), last, by * mu, before, by * nu, rate, a, first, b,
                slope, a + b, target,
            )  # fmt: skip
            before, last, spare = last, target, last

    def _combine(self, *terms: wp.array | float) -> None:
        self._model.launch(self._kernel, self._model.size, *terms)
