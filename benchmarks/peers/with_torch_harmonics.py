"""The shallow-water solver among the examples of torch-harmonics, with a mountain, undamped."""

from __future__ import annotations

from importlib.metadata import version

import numpy as np
import serve
import torch
from torch_harmonics.examples.shallow_water_equations import ShallowWaterSolver

torch.set_num_threads(1)


class OverMountain(ShallowWaterSolver):
    """Solver with a bottom; it steps by the third-order Adams-Bashforth method."""

    bottom = 0.0

    def dudtspec(self, uspec: torch.Tensor) -> torch.Tensor:
        """Return the rates of geopotential, vorticity and divergence."""
        rate = super().dudtspec(uspec)
        rate[2] -= self.lap * self.bottom
        return rate


class Model:
    """Model of torch-harmonics; its latitudes go from north to south."""

    def __init__(self, case: serve.Case) -> None:
        planet = {"radius": case.radius, "omega": case.rotation, "gravity": case.gravity}
        degrees, self.gravity = case.truncation + 1, case.gravity
        self.solver = OverMountain(
            case.lat.size, case.lon.size, case.dt, lmax=degrees, mmax=degrees,
            grid="legendre-gauss", **planet,
        ).double()  # fmt: skip
        u, v, h, b = (torch.tensor(x[::-1].copy()) for x in (case.u, case.v, case.h, case.b))
        self.solver.hyperdiff = torch.ones_like(self.solver.hyperdiff)
        self.solver.bottom = self.solver.grid2spec(case.gravity * b)
        depth = self.solver.grid2spec(case.gravity * h)[None]
        self.initial = torch.cat([depth, self.solver.vrtdivspec(torch.stack([u, v]))])
        self.initial = torch.tril(self.initial)

    def start(self, steps: int) -> torch.Tensor:
        """Return the initial state."""
        return self.initial.clone()

    @torch.no_grad()
    def run(self, state: torch.Tensor, steps: int) -> torch.Tensor:
        """Take the steps of the solver."""
        return self.solver.timestep(state, steps)

    def surface(self, state: torch.Tensor) -> np.ndarray:
        """Return the free surface [m]."""
        return self.solver.spec2grid(state[0] + self.solver.bottom).numpy()[::-1] / self.gravity


if __name__ == "__main__":
    serve.answer(Model, version("torch-harmonics"))
