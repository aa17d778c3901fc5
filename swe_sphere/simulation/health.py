"""Does the solution still make sense? A look every few steps keeps nonsense from going on."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from swe_sphere.errors import Unstable
from swe_sphere.planet import DAY
from swe_sphere.simulation.running import Running

if TYPE_CHECKING:
    import warp as wp

EVERY = 16
"""Steps between looks."""

RUNAWAY = 10.0
"""Growth of the energy that no scene here has, and every numerical explosion soon."""


class HealthCheck:
    """Ends the run where a value is NaN, a depth negative or the energy runs away.

    It takes sums where the state is, and never the state from there.
    """

    def __init__(self, sim: Running) -> None:
        from swe_sphere.solvers.vector_space import VectorSpace  # imports Warp
        from swe_sphere.steppers.energy_norm import energy_weights

        model, mesh = sim.model, sim.model.device_mesh
        self._space = VectorSpace(energy_weights(model), model.device, mesh.real, mesh=mesh)
        first = model.names.index("h") * mesh.size
        self._depth = first, first + mesh.size
        self._linear = sim.scene.linear
        start = model.initial_state()
        self._energy = self._space.dot(start, start)

    def due(self, step: int) -> bool:
        """Every few steps."""
        return step % EVERY == 0

    def observe(self, sim: Running) -> None:
        """Look; Unstable says what is wrong, when, and what could be done."""
        failure = self._failure(sim.stepper.state)
        if failure:
            when = f"at day {sim.time / DAY:.4g} (step {sim.steps})"
            raise Unstable(f"{failure} {when}: {_advice(sim.plan.dt, sim.stable_dt)}")

    def _failure(self, state: wp.array) -> str | None:
        energy = self._space.dot(state, state)
        if not math.isfinite(energy):
            return "the solution is NaN"
        # a passive h, and that of a linear wave, may undershoot zero without harm
        if not self._linear and (depth := self._space.lowest(state, *self._depth)) < 0.0:
            return f"the depth is negative ({depth:.3g} m)"
        growth = energy / self._energy
        return f"the energy has grown {growth:.3g} times" if growth > RUNAWAY else None


def _advice(dt: float, limit: float) -> str:
    """What to say when a run goes wrong."""
    text = f"dt = {dt:.6g} s, stability limit at the start about {limit:.4g} s"
    if dt > limit:
        return f"{text}; take a smaller dt"
    return f"{text}; try a finer mesh, a smaller dt or more dissipation"
