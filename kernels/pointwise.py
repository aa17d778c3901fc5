"""Terms that act at a point: their rates at a node, or at as many nodes as a register holds.

A structure holds the arrays and coefficients that the terms read, and nothing else.
"""

import functools
import types
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import warp as wp

from swe_sphere.kernels.define import Placeholder, func, lanes, real, rows, struct_of, vector
from swe_sphere.kernels.simd.arithmetic import mul
from swe_sphere.kernels.simd.memory import load
from swe_sphere.kernels.simd.stages import triple


@dataclass(frozen=True)
class PointTerm:
    """Formulas of the effect `name`: rates of the wind (two) [m s-2] and of the depth [m s-1].

    The formulas are functions of (c, i, u, v, h), or of (c, i, u, v, h, du, dv, dh) for
    derivatives, with i the number of the node and c the coefficients: c.x for each x in `numbers`,
    c.x[i] for each x in `fields`. outside: values of the surrounding scope, which are compiled in;
    each set of values requires a separate kernel.
    """

    name: str
    wind: Callable[..., Any] | None = None
    depth: Callable[..., Any] | None = None
    numbers: tuple[str, ...] = ()
    fields: tuple[str, ...] = ()
    outside: tuple[object, ...] = ()


@dataclass(frozen=True)
class Pointwise:
    """The terms that depend on one node's state alone, compiled into kernels that finish its rates.

    `rotation`: -f k x V. `forcing`: a prescribed tendency of every unknown, independent of the
    state. `terms`: formulas of effects. `tangent`: the derivative of all terms except forcing at
    the state `base`, applied to a direction; `terms` are then formulas of derivatives.
    """

    rotation: bool = False
    forcing: bool = False
    terms: tuple[PointTerm, ...] = ()
    tangent: bool = False

    @property
    def needs_base(self) -> bool:
        """True if some derivative depends on the state at which it is taken."""
        return self.tangent and bool(self.terms)


NO_POINTWISE = Pointwise()


@dataclass(frozen=True)
class PointwiseSum:
    """Device functions for the rates at a node, or at as many nodes as a register has lanes.

    The argument c of the functions is an instance of `structure`, which all lanes share.
    """

    structure: Any
    """Warp structure of the arrays that are read, over nodes: (N,), (2N,) or (unknowns*N,)."""
    wind: Any
    """Function (c, node, size, w, x): two rows of wind rates [m s-2]; wind from w, depth from x."""
    depth: Any
    """Function (c, node, size, w, x): a row of depth rates [m s-1]; prescribed winds replace w."""
    add: Any
    """Function (c, node, size, x, r): the rows r plus all rates."""


@functools.cache
def pointwise_sum(unknowns: int, point: Pointwise) -> PointwiseSum:
    """Return the device functions for the sum of these terms."""
    last, coefficients = unknowns - 1, _coefficients(point.terms)

    @Placeholder
    def structure(of: Any) -> Any:
        array, terms = wp.array(dtype=of.real), coefficients.find(of)
        members = {
            "coriolis": point.rotation and array,
            "forcing": point.forcing and array,
            "base": point.needs_base and array,
            "wind": unknowns == 1 and terms is not None and array,
            "terms": terms is not None and terms,
        }
        return struct_of("Pointwise", members)

    wind, depth = (_rates_of(kind, unknowns, point, structure) for kind in ("wind", "depth"))
    on_depth = point.forcing or any(term.depth for term in point.terms)
    on_wind = point.forcing or point.rotation or any(term.wind for term in point.terms)

    @func
    def add(c: structure, node: int, size: int, x: vector, r: rows(unknowns)):
        if wp.static(unknowns == 3 and on_wind):
            two = wind(c, node, size, x, x)
            r[0] = r[0] + two[0]
            r[1] = r[1] + two[1]
        if wp.static(on_depth):
            r[last] = r[last] + depth(c, node, size, x, x)[0]
        return r

    return PointwiseSum(structure, wind, depth, add)


@functools.cache
def _coefficients(terms: tuple[PointTerm, ...]) -> Placeholder:
    """Return the `Placeholder` of a structure: coefficients `mine` of a term, rest in `others`."""

    def structure(of: Any) -> Any:
        if not terms:
            return None  # that of the sum then has no member `terms`
        numbers = dict.fromkeys(terms[0].numbers, of.real)
        fields = dict.fromkeys(terms[0].fields, wp.array(dtype=of.real))
        others = {"others": _coefficients(terms[1:]).find(of)} if terms[1:] else {}
        return struct_of("Terms", {"mine": struct_of("Coefficients", numbers | fields)} | others)

    return Placeholder(structure)


def _rates_of(kind: str, unknowns: int, point: Pointwise, structure: Any) -> Any:
    """Return the function `wind` or `depth` of a `PointwiseSum`."""
    is_wind = kind == "wind"
    some, three, offset = rows(2 if is_wind else 1), rows(3), 0 if is_wind else unknowns - 1
    acts = any(getattr(term, kind) for term in point.terms)
    of_terms = _sum_of_terms(kind, point.terms, point.tangent) if acts else None

    @func
    def state(c: structure, node: int, size: int, w: vector, x: vector):
        s = three()
        if wp.static(unknowns == 1):
            s[0] = load(c.wind, node)
            s[1] = load(c.wind, size + node)
        else:
            s[0] = load(w, node)
            s[1] = load(w, size + node)
        s[2] = load(x, (unknowns - 1) * size + node)
        return s

    @func
    def in_lane(s: three, lane: int):
        if wp.static(lanes == 1):
            return triple(s[0], s[1], s[2])
        else:
            return triple(s[0, lane], s[1, lane], s[2, lane])

    def from_lane(lane: int, of: Any) -> Any:
        """Return the function that adds the rates from this lane on; loops are not vectorised."""
        later = from_lane(lane + 1, of) if lane + 1 < of.lanes else None

        @func
        def add(c: structure, node: int, s: three, base: three, r: some):
            d = in_lane(s, lane)
            if wp.static(point.tangent and unknowns == 1):
                d = triple(real(0.0), real(0.0), d[2])  # a prescribed wind does not change
            rate = of_terms(c.terms, node + lane, in_lane(base, lane), d)
            if wp.static(lanes == 1):
                r += rate
            else:
                r[0, lane] = r[0, lane] + rate[0]
            if wp.static(is_wind and lanes > 1):
                r[1, lane] = r[1, lane] + rate[1]
            if wp.static(later is None):
                return r
            else:
                return later(c, node, s, base, r)

        return add.find(of)

    add_terms = Placeholder(functools.partial(from_lane, 0)) if acts else None

    @func
    def rates(c: structure, node: int, size: int, w: vector, x: vector):
        r = some()
        if wp.static(point.forcing):
            r[0] = load(c.forcing, offset * size + node)
        if wp.static(point.forcing and is_wind):
            r[1] = load(c.forcing, size + node)
        if wp.static(point.rotation and is_wind):
            f = load(c.coriolis, node)
            r[0] = r[0] + mul(f, load(w, size + node))
            r[1] = r[1] - mul(f, load(w, node))
        if wp.static(acts):
            s = state(c, node, size, w, x)
            base = s
            if wp.static(point.tangent):
                base = state(c, node, size, c.base, c.base)
            r = add_terms(c, node, s, base, r)
        return r

    return rates


def _sum_of_terms(kind: str, terms: tuple[PointTerm, ...], tangent: bool) -> Any:
    """Return the function (c, i, state, direction) for the sum of the rates of wind or depth."""
    formula, is_wind, more = getattr(terms[0], kind), kind == "wind", bool(terms[1:])
    rates: Any = Placeholder(lambda of: wp.types.vector(2 if is_wind else 1, of.real))
    mine: Any = Placeholder(lambda of: _coefficients(terms).find(of).vars["mine"].type)
    term, acts = formula and _typed(formula, mine), formula is not None
    of_others = _sum_of_terms(kind, terms[1:], tangent) if more else None

    @func
    def of_terms(c: _coefficients(terms), i: int, x: triple, d: triple):
        r = rates()
        if wp.static(acts and is_wind and tangent):
            u, v = term(c.mine, i, x[0], x[1], x[2], d[0], d[1], d[2])
            r += rates(u, v)
        elif wp.static(acts and is_wind):
            u, v = term(c.mine, i, x[0], x[1], x[2])
            r += rates(u, v)
        elif wp.static(acts and tangent):
            r += rates(term(c.mine, i, x[0], x[1], x[2], d[0], d[1], d[2]))
        elif wp.static(acts):
            r += rates(term(c.mine, i, x[0], x[1], x[2]))
        if wp.static(more):
            r += of_others(c.others, i, x, d)
        return r

    return of_terms


def _typed(formula: Callable[..., Any], coefficients: Placeholder) -> Any:
    """Return the formula as a device function with types for its arguments."""
    code, known, around = formula.__code__, formula.__globals__, formula.__closure__
    typed = types.FunctionType(code, known, formula.__name__, None, around)
    names = code.co_varnames[: code.co_argcount]
    kinds = (coefficients, int, *(real for _ in names[2:]))
    typed.__annotations__ = dict(zip(names, kinds, strict=True))
    typed.__qualname__, typed.__module__ = formula.__qualname__, formula.__module__
    return func(typed)
