"""The meshes and precisions of a sweep, each made once."""

from __future__ import annotations

from swe_sphere.simulation.setup import make_scene
from swe_sphere.studies.sweep.bench import Bench
from swe_sphere.studies.sweep.plan import SweepPlan

__all__ = ["Benches"]


class Benches:
    """Benches by ne, np and precision."""

    def __init__(self, plan: SweepPlan) -> None:
        self._plan = plan
        self._known: dict[tuple[int, int, str], Bench] = {}
        scene = make_scene(plan.run_config())
        self._ne, self._np = plan.ne or (scene.ne,), plan.np or (scene.np,)

    def at(self, ne: int, np: int, precision: str) -> Bench:
        """The bench of that mesh and precision."""
        key = (ne, np, precision)
        if key not in self._known:
            self._known[key] = Bench(self._plan.run_config(ne=ne, np=np, precision=precision))
        return self._known[key]

    def all(self) -> list[Bench]:
        """Those that the plan asks for."""
        return [
            self.at(ne, np, precision)
            for ne in self._ne
            for np in self._np
            for precision in self._plan.precision
        ]

    def in_float64(self, bench: Bench) -> Bench:
        """The bench of the same mesh in double precision."""
        return self.at(bench.mesh.ne, bench.mesh.np, "float64")

    @property
    def first(self) -> Bench:
        """Any one of them."""
        return self.all()[0]

    @property
    def largest_ne(self) -> int:
        """Elements along an edge of the finest mesh."""
        return max(self._ne)

    @property
    def largest_np(self) -> int:
        """Nodes along an edge of the largest elements."""
        return max(self._np)
