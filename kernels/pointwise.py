"""Terms that act at a point: their rates at a node, or at as many nodes as a register holds.

What they read, arrays and coefficients, is in a structure that holds it and nothing else.
"""

import functools
import types
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import warp as wp

from swe_sphere.kernels.define import func, struct_of
from swe_sphere.kernels.simd.arithmetic import product_of
from swe_sphere.kernels.simd.memory import run_of
from swe_sphere.kernels.simd.register import Register


@dataclass(frozen=True)
class PointTerm:
    """Formulas of one effect at a node: rates of change of the wind (two) and of the depth (one).

    They are functions of (c, i, u, v, h), or of (c, i, u, v, h, du, dv, dh) for derivatives, with i
    the number of the node and c the coefficients: c.name of `numbers`, c.name[i] of `fields`.
    outside: what they read from around them, which is compiled in: other values, other kernels.
    """

    name: str
    wind: Callable[..., Any] | None = None
    depth: Callable[..., Any] | None = None
    numbers: tuple[str, ...] = ()
    fields: tuple[str, ...] = ()
    outside: tuple[object, ...] = ()


@dataclass(frozen=True)
class Pointwise:
    """The terms of one node's state alone, compiled into one assembly kernel.

    `rotation`: -f k x V.  `forcing`: a prescribed tendency of every unknown, independent of the
    state.  `terms`: formulas of effects.  `tangent`: the derivative of all but forcing at the state
    `base`, applied to a direction; the terms are derivatives then.
    """

    rotation: bool = False
    forcing: bool = False
    terms: tuple[PointTerm, ...] = ()
    tangent: bool = False

    @property
    def needs_base(self) -> bool:
        """Whether there are derivatives that have to know the state they are taken at."""
        return self.tangent and bool(self.terms)


NO_POINTWISE = Pointwise()


@dataclass(frozen=True)
class PointwiseSum:
    """Warp functions for the rates at a node, or at as many nodes as a register has lanes.

    Their argument c is an instance of `structure`, which is the same for all lanes.
    """

    structure: Any
    """Warp structure with just what is read: arrays over nodes (N,), (2N,) or (unknowns*N,)."""
    wind: Any
    """(c, node, size, x): two rows of rates of the wind [m s-2]."""
    depth: Any
    """(c, node, size, w, x): rate of the depth [m s-1], with the wind of w or a prescribed one."""
    add: Any
    """(c, node, size, x, r): the rows r and all rates."""


@dataclass(frozen=True)
class _Terms:
    """Warp functions of (c, i, state, direction): sums of terms, c an instance of `structure`."""

    structure: Any
    wind: Any
    depth: Any


@functools.cache
def pointwise_sum(unknowns: int, register: Register, point: Pointwise) -> PointwiseSum:
    """Return the functions for these terms."""
    real, last, vector = register.real, unknowns - 1, wp.array(dtype=register.real)
    terms = _sum_of_terms(point.terms, real, point.tangent) if point.terms else None
    structure = _structure(unknowns, real, point, terms and terms.structure)
    depth = _depth_of(unknowns, register, point, structure, terms and terms.depth)
    wind = _wind_of(register, point, structure, terms and terms.wind)
    on_depth = point.forcing or any(term.depth for term in point.terms)
    on_wind = point.forcing or point.rotation or any(term.wind for term in point.terms)

    @func
    def add(c: structure, node: int, size: int, x: vector, r: register.rows(unknowns)):
        if wp.static(unknowns == 3 and on_wind):
            two = wind(c, node, size, x)
            r[0] = r[0] + two[0]
            r[1] = r[1] + two[1]
        if wp.static(on_depth):
            r[last] = r[last] + depth(c, node, size, x, x)
        return r

    return PointwiseSum(structure, wind, depth, add)


def _structure(unknowns: int, real: Any, point: Pointwise, terms: Any) -> Any:
    vector = wp.array(dtype=real)
    optional = {
        "coriolis": (point.rotation, vector),
        "forcing": (point.forcing, vector),
        "base": (point.needs_base, vector),
        "wind": (unknowns == 1 and terms is not None, vector),
        "terms": (terms is not None, terms),
    }
    members = {name: kind for name, (wanted, kind) in optional.items() if wanted}
    return struct_of("Pointwise", members)


def _wind_of(register: Register, point: Pointwise, structure: Any, of_terms: Any) -> Any:
    real, lanes, pair = register.real, register.lanes, register.rows(2)
    vector, load, mul = wp.array(dtype=real), run_of(register), product_of(register)
    one, acts = lanes == 1, any(term.wind for term in point.terms)
    triple = wp.types.vector(3, real)

    @func
    def wind(c: structure, node: int, size: int, x: vector):
        r = pair()
        if wp.static(point.forcing):
            r[0] = load(c.forcing, node)
            r[1] = load(c.forcing, size + node)
        if wp.static(point.rotation):
            f = load(c.coriolis, node)
            r[0] = r[0] + mul(f, load(x, size + node))
            r[1] = r[1] - mul(f, load(x, node))
        if wp.static(acts):
            for i in range(node, node + lanes):
                d = triple(x[i], x[size + i], x[2 * size + i])
                at = d
                if wp.static(point.tangent):
                    at = triple(c.base[i], c.base[size + i], c.base[2 * size + i])
                rate = of_terms(c.terms, i, at, d)
                if wp.static(one):
                    r += rate
                else:
                    r[0, i - node] = r[0, i - node] + rate[0]
                    r[1, i - node] = r[1, i - node] + rate[1]
        return r

    return wind


def _depth_of(
    unknowns: int, register: Register, point: Pointwise, structure: Any, of_terms: Any
) -> Any:
    real, value, lanes = register.real, register.value, register.lanes
    vector, load, last = wp.array(dtype=real), run_of(register), unknowns - 1
    one, acts = lanes == 1, any(term.depth for term in point.terms)
    triple = wp.types.vector(3, real)

    @func
    def state(c: structure, i: int, size: int, w: vector, x: vector):
        if wp.static(unknowns == 1):
            return triple(c.wind[i], c.wind[size + i], x[i])
        else:
            return triple(w[i], w[size + i], x[2 * size + i])

    @func
    def depth(c: structure, node: int, size: int, w: vector, x: vector):
        r = value(real(0.0))
        if wp.static(point.forcing):
            r = load(c.forcing, last * size + node)
        if wp.static(acts):
            for i in range(node, node + lanes):
                d = state(c, i, size, w, x)
                at = d
                if wp.static(point.tangent):
                    at = state(c, i, size, c.base, c.base)
                if wp.static(point.tangent and unknowns == 1):
                    d = triple(real(0.0), real(0.0), x[i])  # a prescribed wind does not change
                rate = of_terms(c.terms, i, at, d)
                if wp.static(one):
                    r += rate
                else:
                    r[i - node] = r[i - node] + rate
        return r

    return depth


def _sum_of_terms(terms: tuple[PointTerm, ...], real: Any, tangent: bool) -> _Terms:
    """Return the sum of all terms.

    The structure holds the coefficients of the first term as `mine`, and those of the other terms
    as `others`.
    """
    vector, pair, triple = wp.array(dtype=real), wp.types.vector(2, real), wp.types.vector(3, real)
    members = {name: real for name in terms[0].numbers} | {name: vector for name in terms[0].fields}
    mine = struct_of("Coefficients", members)
    others = _sum_of_terms(terms[1:], real, tangent) if terms[1:] else None
    members = {"mine": mine} | ({"others": others.structure} if others else {})
    structure, more_wind = struct_of("Terms", members), others and others.wind
    more_depth = others and others.depth
    wind, depth = (
        formula and _typed(formula, mine, real) for formula in (terms[0].wind, terms[0].depth)
    )

    @func
    def of_wind(c: structure, i: int, x: triple, d: triple):
        r = pair()
        if wp.static(wind is not None and tangent):
            u, v = wind(c.mine, i, x[0], x[1], x[2], d[0], d[1], d[2])
            r += pair(u, v)
        elif wp.static(wind is not None):
            u, v = wind(c.mine, i, x[0], x[1], x[2])
            r += pair(u, v)
        if wp.static(others is not None):
            r += more_wind(c.others, i, x, d)
        return r

    @func
    def of_depth(c: structure, i: int, x: triple, d: triple):
        r = real(0.0)
        if wp.static(depth is not None and tangent):
            r += depth(c.mine, i, x[0], x[1], x[2], d[0], d[1], d[2])
        elif wp.static(depth is not None):
            r += depth(c.mine, i, x[0], x[1], x[2])
        if wp.static(others is not None):
            r += more_depth(c.others, i, x, d)
        return r

    return _Terms(structure, of_wind, of_depth)


def _typed(formula: Callable[..., Any], coefficients: type, real: type) -> wp.Function:
    """The formula as a Warp function of numbers of the type `real`."""
    code = formula.__code__
    typed = types.FunctionType(
        code, formula.__globals__, formula.__name__, None, formula.__closure__
    )
    names = code.co_varnames[: code.co_argcount]
    kinds = (coefficients, int, *(real for _ in names[2:]))
    typed.__annotations__ = dict(zip(names, kinds, strict=True))
    typed.__qualname__, typed.__module__ = formula.__qualname__, formula.__module__
    return wp.func(typed)
