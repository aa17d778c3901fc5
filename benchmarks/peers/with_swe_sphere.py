"""Runs of swe_sphere for the comparison of models."""

from __future__ import annotations

import numpy as np
import serve
import warp as wp

from swe_sphere import __version__
from swe_sphere.mesh import Interpolator, Mesh
from swe_sphere.simulation.planning import RunPlan
from swe_sphere.simulation.simulation import Simulation

wp.config.log_level = wp.LOG_WARNING


class Model:
    """Model of swe_sphere; its polynomials are evaluated at the requested points."""

    def __init__(self, case: serve.Case) -> None:
        self.case, self.mesh = case, Mesh.build(case.ne, case.np)
        lat, lon = np.meshgrid(case.lat, case.lon, indexing="ij")
        self.points = Interpolator(self.mesh, lon.ravel(), lat.ravel())

    def start(self, steps: int) -> Simulation:
        """Return a simulation before its first step."""
        case = self.case
        sim = Simulation(case.scene, mesh=self.mesh, stepper=case.stepper, precision=case.precision)
        sim.begin(RunPlan(case.dt, steps, steps, case.dt))
        return sim

    def run(self, state: Simulation, steps: int) -> Simulation:
        """Take all steps, with the checks of every run."""
        state.run_plan()
        return state

    def surface(self, state: Simulation) -> np.ndarray:
        """Return the free surface [m]."""
        fields = state.snapshot.all_fields
        height = self.points(fields["h"] + fields.get("b", 0.0))
        return height.reshape(self.case.lat.size, self.case.lon.size)


if __name__ == "__main__":
    serve.answer(Model, __version__)
