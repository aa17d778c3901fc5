"""The shallow-water equations of dinosaur with its own steps, implicit for gravity waves."""

from __future__ import annotations

from importlib.metadata import version

import jax
import numpy as np
import serve
from dinosaur import coordinate_systems as systems
from dinosaur import layer_coordinates, time_integration
from dinosaur.shallow_water import ShallowWaterEquations, ShallowWaterSpecs, State
from dinosaur.spherical_harmonic import Grid, uv_nodal_to_vor_div_modal

jax.config.update("jax_enable_x64", True)

STEPS = {
    "imex-rk-sil3": time_integration.imex_rk_sil3,
    "crank-nicolson-rk3": time_integration.crank_nicolson_rk3,
    "crank-nicolson-rk4": time_integration.crank_nicolson_rk4,
}


class Model:
    """Model of dinosaur with one layer, in units of the radius of the planet and of 1 / (2 Ω)."""

    def __init__(self, case: serve.Case) -> None:
        self.grid = Grid(
            longitude_wavenumbers=case.truncation + 1,
            total_wavenumbers=case.truncation + 2,
            longitude_nodes=case.lon.size,
            latitude_nodes=case.lat.size,
        )
        speed = 2.0 * case.rotation * case.radius
        self.metres = speed**2 / case.gravity
        u, v, h, self.b = (np.array(x).T for x in (case.u, case.v, case.h, case.b))
        self.mean = np.average(h, weights=np.broadcast_to(np.cos(case.lat), h.shape)) / self.metres
        vorticity, divergence = uv_nodal_to_vor_div_modal(self.grid, u / speed, v / speed)
        depth = self._modes(h) - self.mean * self._modes(self.metres + 0.0 * h)
        self.initial = State(vorticity[None], divergence[None], depth[None])
        system = systems.CoordinateSystem(self.grid, layer_coordinates.LayerCoordinates(1))
        specs = ShallowWaterSpecs(np.ones(1), 1.0, 0.5, 1.0, None)
        equations = ShallowWaterEquations(system, specs, self._modes(self.b), np.array([self.mean]))
        step = STEPS[case.stepper](equations, case.dt * 2.0 * case.rotation)

        def run(state: State, steps: int) -> State:
            return jax.lax.fori_loop(0, steps, lambda _, now: step(now), state)

        self.steps = jax.jit(run)

    def _modes(self, field: np.ndarray) -> jax.Array:
        return self.grid.to_modal(field / self.metres)

    def start(self, steps: int) -> State:
        """Return the initial state."""
        return self.initial

    def run(self, state: State, steps: int) -> State:
        """Take all steps in one compiled loop."""
        return jax.block_until_ready(self.steps(state, steps))

    def surface(self, state: State) -> np.ndarray:
        """Return the free surface [m]."""
        height = state.potential[0] + self._modes(self.b)
        return np.asarray(self.grid.to_nodal(height) + self.mean).T * self.metres


if __name__ == "__main__":
    serve.answer(Model, version("dinosaur-dycore"))
