"""The shallow-water equations written out for Dedalus; gravity waves and rotation implicit."""

from __future__ import annotations

import logging
from importlib.metadata import version

import dedalus.public as d3
import numpy as np
import serve

logging.disable(logging.INFO)


class Model:
    """Model of Dedalus, in units of the radius of the planet and of hours."""

    def __init__(self, case: serve.Case) -> None:
        self.case = case
        self.dt = case.dt / 3600.0
        radius, hour, degrees = case.radius, 3600.0, case.truncation + 1
        coords = d3.S2Coordinates("phi", "theta")
        domain = d3.Distributor(coords, dtype=np.float64)
        basis = d3.SphereBasis(
            coords, (2 * degrees, degrees), radius=1.0, dealias=case.lat.size / degrees,
            dtype=np.float64,
        )  # fmt: skip
        weights = np.broadcast_to(np.cos(case.lat)[:, None], case.h.shape)
        mean = np.average(case.h, weights=weights) / radius
        u = domain.VectorField(coords, name="u", bases=basis)
        h, b = (domain.Field(name=name, bases=basis) for name in "hb")
        for field in (u, h, b):
            field.change_scales(basis.dealias)
        lat = np.pi / 2.0 - domain.local_grids(basis, scales=basis.dealias)[1].ravel()
        self.order = np.argsort(lat)
        there = np.argsort(self.order)
        east, north, depth, bottom = (x[there].T for x in (case.u, case.v, case.h, case.b))
        self.start_u = np.array([east, -north]) * hour / radius
        self.start_h = depth / radius - mean
        b["g"] = bottom / radius
        names = {
            "u": u, "h": h, "b": b, "g": case.gravity * hour**2 / radius, "H": mean,
            "f": 2.0 * case.rotation * hour, "cross": lambda x: d3.MulCosine(d3.skew(x)),
        }  # fmt: skip
        problem = d3.IVP([u, h], namespace=names)
        problem.add_equation("dt(u) + g*grad(h) + f*cross(u) = - u@grad(u) - g*grad(b)")
        problem.add_equation("dt(h) + H*div(u) = - div(h*u)")
        self.solver = problem.build_solver(getattr(d3, case.stepper))
        self.u, self.h, self.b, self.mean, self.scales = u, h, b, mean, basis.dealias

    def start(self, steps: int) -> None:
        """Put the initial state into the fields."""
        for field, values in ((self.u, self.start_u), (self.h, self.start_h)):
            field.change_scales(self.scales)
            field["g"] = values

    def run(self, state: None, steps: int) -> None:
        """Take the steps with the solver of Dedalus."""
        for _ in range(steps):
            self.solver.step(self.dt)

    def surface(self, state: None) -> np.ndarray:
        """Return the free surface [m]."""
        for field in (self.h, self.b):
            field.change_scales(self.scales)
        height = self.h["g"] + self.b["g"] + self.mean
        return height.T[self.order] * self.case.radius


if __name__ == "__main__":
    serve.answer(Model, version("dedalus"))
