"""Faults planted in the running program: metric terms, quadrature, scene fields, tableaus."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np

from mutants.kinds import Swap

__all__ = ["SWAPS"]

PERCENT = 1.01

STEADY = ("williamson2-tilted",)
FINE = ("williamson2-tilted-np",)
UNSTEADY = ("lauter-day",)
TRANSPORT = ("williamson1-smooth-np",)
FORCED = ("driven",)
DECAY = ("viscosity-np",)


def _scaled(field: str, *where: Any, factor: float = PERCENT) -> Callable[[Any], Any]:
    """Meshes with part of an array multiplied."""

    def change(assemble: Callable[..., Any]) -> Callable[..., Any]:
        def mutated(*arguments: Any) -> Any:
            mesh = assemble(*arguments)
            values = getattr(mesh, field).copy()
            values[where] *= factor
            return replace(mesh, **{field: values})

        return mutated

    return change


def _mesh(name: str, cases: tuple[str, ...], field: str, *where: Any) -> Swap:
    return Swap(name, "swe_sphere.mesh.mesh:_assemble", cases, _scaled(field, *where))


def _returning(scale: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Functions whose value is changed."""
    return lambda function: lambda *arguments: scale(function(*arguments))


def _entry(index: int) -> Callable[[Any], Any]:
    """One of an array of numbers, or of a tuple of arrays, 1 % too large."""

    def scale(values: Any) -> Any:
        changed = list(values)
        changed[index] = changed[index] * PERCENT
        return np.array(changed) if isinstance(values, np.ndarray) else tuple(changed)

    return scale


MAKE_SCENE = "swe_sphere.studies.cases.measure:make_scene"


def _scene(name: str, cases: tuple[str, ...], field: str, scale: Callable[[Any], Any]) -> Swap:
    """Scenes one of whose functions is changed, after the exact solution was made."""

    def change(make_scene: Callable[..., Any]) -> Callable[..., Any]:
        def mutated(config: Any) -> Any:
            scene = make_scene(config)
            return replace(scene, **{field: _returning(scale)(getattr(scene, field))})

        return mutated

    return Swap(name, MAKE_SCENE, cases, change)


def _drop_contributor(mesh: Any) -> Any:
    """The last node, where three or four elements meet, loses one of them."""
    offsets = mesh.gather_offsets.copy()
    offsets[-1] -= 1
    return replace(mesh, gather_offsets=offsets, gather_entries=mesh.gather_entries[:-1])


def _tableau(row: int, column: int) -> Callable[[Any], Any]:
    """An entry of a tableau 1 % too large."""
    return lambda a: tuple(_entry(column)(r) if i == row else r for i, r in enumerate(a))


def _stepper(module: str, attribute: str, change: Callable[[Any], Any], stepper: str) -> Swap:
    where = f"swe_sphere.steppers.{module}:{attribute}"
    return Swap(f"{attribute} 1 % off", where, (f"stepper-{stepper}",), change)


METRIC = (
    *(
        _mesh(f"basis[{i}, {k}] + 1 %", STEADY, "basis", Ellipsis, i, k)
        for i, k in product((0, 1), (0, 1))
    ),
    *(
        _mesh(f"basis[{i}, {k}] + 1 % at one node of one element", FINE, "basis", 66, 1, 2, i, k)
        for i, k in product((0, 1), (0, 1))
    ),
    _mesh("jacobian + 1 %", DECAY, "jacobian", Ellipsis),
    _mesh("jacobian + 1 % at one node of one element", DECAY, "jacobian", 1, 1, 2),
    _mesh("nodal area + 1 %", STEADY, "area", Ellipsis),
    _mesh("nodal area + 1 % at one node", STEADY, "area", 7),
    *(
        _mesh(f"derivative[{i}, {j}] + 1 %, np 4", STEADY, "derivative", i, j)
        for i, j in product(range(4), range(4))
        if (i, j) not in ((1, 1), (2, 2))  # these are zero
    ),
)
"""Every metric term."""

QUADRATURE = (
    *(_mesh(f"weight {i} + 1 % in kernels, np 4", STEADY, "gll_weights", i) for i in range(4)),
    _mesh("all weights + 1 % in kernels", STEADY, "gll_weights", Ellipsis),
    *(
        Swap(
            f"quadrature weight {i} + 1 % everywhere",
            "swe_sphere.mesh.gll:gll_weights",
            ("start-williamson2",),
            _returning(_entry(i)),
        )
        for i in (0, 1, 2)
    ),
)
"""Quadrature weights, in the kernels alone or everywhere."""

SCENES = (
    _scene("Coriolis parameter + 1 %, steady", STEADY, "coriolis", lambda f: PERCENT * f),
    _scene("Coriolis parameter + 1 %, unsteady", UNSTEADY, "coriolis", lambda f: PERCENT * f),
    _scene("slope of the bottom + 1 %", UNSTEADY, "bottom", lambda b: PERCENT * b),
    *(
        _scene(f"forcing of {name} + 1 %", FORCED, "forcing", _entry(i))
        for i, name in enumerate(("eastward wind", "northward wind", "depth"))
    ),
    *(
        _scene(f"prescribed {name} wind + 1 %", TRANSPORT, "wind", _entry(i))
        for i, name in enumerate(("eastward", "northward"))
    ),
)
"""Fields that act on the fluid."""

ASSEMBLY = (
    Swap(
        "a contributor to a node is missing",
        "swe_sphere.mesh.mesh:_assemble",
        STEADY,
        _returning(_drop_contributor),
    ),
)

STEPPERS = (
    _stepper("runge_kutta", "RK4.a", _tableau(1, 1), "rk4"),
    _stepper("runge_kutta", "RK4.b", _entry(1), "rk4"),
    _stepper("runge_kutta", "SSPRK3.a", _tableau(1, 0), "ssprk3"),
    _stepper("runge_kutta", "KG5.a", _tableau(0, 0), "kg5"),
    _stepper("leapfrog", "Leapfrog.default_strength", lambda x: PERCENT * x, "leapfrog"),
    _stepper("leapfrog", "Leapfrog.default_share", lambda x: PERCENT * x, "leapfrog"),
    _stepper("leapfrog", "Leapfrog.default_strength", lambda x: PERCENT * x, "semi-implicit"),
    _stepper("dirk", "TRBDF2.a", _tableau(2, 0), "tr-bdf2"),
    _stepper("dirk", "SDIRK3.a", _tableau(1, 0), "sdirk3"),
    _stepper("dirk", "ESDIRK4.a", _tableau(4, 2), "esdirk4"),
    _stepper("imex_runge_kutta", "ARK2.explicit", _tableau(1, 1), "ark2"),
    _stepper("imex_runge_kutta", "ARS343.implicit", _tableau(1, 1), "ars343"),
)

SWAPS = (*METRIC, *QUADRATURE, *SCENES, *ASSEMBLY, *STEPPERS)
"""All of them."""
