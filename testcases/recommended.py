"""Mesh, step and length of run that suit a scene, stated beside its physics."""

from collections.abc import Callable
from dataclasses import replace
from functools import wraps
from typing import ParamSpec

from swe_sphere.equations.scene import Scene

P = ParamSpec("P")


def recommended(
    ne: int, np: int, dt: float, days: float | None = None
) -> Callable[[Callable[P, Scene]], Callable[P, Scene]]:
    """Return a decorator that gives the scenes of a factory these recommended numbers.

    Args:
        ne, np: Elements along the edge of a cube face, nodes along the edge of an element.
        dt: Time step [s], stable for rk4 on this mesh.
        days: Length of the run [days]; None: as the factory states.
    """

    def beside(factory: Callable[P, Scene]) -> Callable[P, Scene]:
        @wraps(factory)
        def make(*args: P.args, **parameters: P.kwargs) -> Scene:
            scene = factory(*args, **parameters)
            length = scene.days if days is None else days
            return replace(scene, ne=ne, np=np, dt=dt, days=length)

        return make

    return beside
