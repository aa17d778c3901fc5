"""Steppers that step depth and wind one after the other: formulas, order, limits, restart."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from support import make_scene, random_state, relative

from swe_sphere.equations import Model
from swe_sphere.mesh import Mesh
from swe_sphere.steppers import STEPPERS
from swe_sphere.steppers.forward_backward import ForwardBackward, ForwardBackwardRK3

SCENES = {
    "all": ("advection", "pressure", "rotation", "orography", "forcing", "drag", "relaxation"),
    "linear": ("pressure", "rotation", "linearised", "viscosity"),
    "waves": ("pressure",),
}


class Plain:
    """Rates of both equations from whole right-hand sides of the model."""

    def __init__(self, model: Model) -> None:
        self.model, self.n = model, model.mesh.size

    def rate(self, wind: np.ndarray, depth: np.ndarray, t: float) -> np.ndarray:
        out = self.model.zeros()
        at = self.model.device_mesh.upload(np.concatenate([wind, depth]))
        self.model.conservative_tendency(at, t, out)
        return out.numpy()

    def loss(self, x: np.ndarray) -> np.ndarray:
        out = self.model.zeros()
        if self.model.dissipative:
            self.model.dissipative_tendency(self.model.device_mesh.upload(x), out)
        return out.numpy()

    def split(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return x[: 2 * self.n], x[2 * self.n :]


def ab(b: float, levels: list[np.ndarray]) -> np.ndarray:
    now, past, older = levels
    return (1.5 + b) * now - (0.5 + 2.0 * b) * past + b * older


@pytest.mark.parametrize("effects", SCENES.values(), ids=SCENES.keys())
def test_forward_backward_is_what_its_formulas_say(small_mesh, effects) -> None:
    """Shchepetkin & McWilliams (2005), from whole right-hand sides, after two steps of rk4."""
    model, dt = Model(small_mesh, make_scene(*effects)), 100.0
    plain, w = Plain(model), ForwardBackward.weights
    stepper, starter = ForwardBackward(model, dt), STEPPERS["rk4"](model, dt)
    start = model.device_mesh.upload(random_state(model))
    stepper.start(start, 50.0)
    starter.start(start, 50.0)
    levels = [start.numpy()]
    for _ in range(2):
        starter.step()
        stepper.step()
        levels.insert(0, starter.state.numpy().copy())
    for k in range(2, 6):
        winds, depths = zip(*(plain.split(x) for x in levels), strict=True)
        t, loss = 50.0 + (k + 0.5) * dt, plain.split(plain.loss(levels[0]))
        rate = plain.rate(ab(w.flow, winds), ab(w.mass, depths), t)
        depth = depths[0] + dt * (plain.split(rate)[1] + loss[1])
        delta = 0.5 + w.gamma + 2.0 * w.epsilon
        mixed = delta * depth + (1.0 - delta - w.gamma - w.epsilon) * depths[0]
        mixed += w.gamma * depths[1] + w.epsilon * depths[2]
        rate = plain.rate(ab(w.turn, winds), mixed, t)
        wind = winds[0] + dt * (plain.split(rate)[0] + loss[0])
        levels = [np.concatenate([wind, depth]), *levels[:2]]
        stepper.step()
        assert relative(stepper.state.numpy(), levels[0], 3) < 1e-12


@pytest.mark.parametrize("effects", SCENES.values(), ids=SCENES.keys())
def test_fb_rk3_is_what_its_formulas_say(small_mesh, effects) -> None:
    """Lilly et al. (2023), from whole right-hand sides."""
    model, dt = Model(small_mesh, make_scene(*effects)), 300.0
    plain, (b1, b2, b3) = Plain(model), ForwardBackwardRK3.weights
    stepper, x = ForwardBackwardRK3(model, dt), random_state(model)
    stepper.start(model.device_mesh.upload(x), 50.0)
    for k in range(3):
        t, loss, (u0, h0) = 50.0 + k * dt, plain.loss(x), plain.split(x)
        u, h, offset = u0, h0, 0.0
        for part, mix in (
            (1 / 3, lambda new, last: b1 * new + (1.0 - b1) * h0),
            (1 / 2, lambda new, last: b2 * new + (1.0 - b2) * h0),
            (1.0, lambda new, last: b3 * new + (1.0 - 2.0 * b3) * last + b3 * h0),
        ):
            at = t + offset * dt
            rate = plain.split(plain.rate(u, h, at) + loss)[1]
            new = h0 + part * dt * rate
            rate = plain.split(plain.rate(u, mix(new, h), at) + loss)[0]
            u, h, offset = u0 + part * dt * rate, new, part
        x = np.concatenate([u, h])
        stepper.step()
        assert relative(stepper.state.numpy(), x, 3) < 1e-12
