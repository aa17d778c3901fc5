"""Time steps in registers: the kernels that compute rates of change also store the next state.

With the levels Y_k of a step that begins at y, an explicit Runge-Kutta method is a chain of sums y
+ tau K + sum_k w_k (Y_k - y) of one rate K each (the form of Shu & Osher 1988), so that no rate is
stored and read again. Differences from y avoid the cancellation in sums of weighted states.
"""

import functools
from typing import Any

import warp as wp

from swe_sphere.kernels.define import (
    Placeholder,
    Register,
    kernel,
    lanes,
    real,
    rows,
    source,
    struct_of,
    value,
    vector,
)  # fmt: skip


@functools.cache
def stage_struct(real: Any) -> Any:
    """Return the Warp structure of a stage: `start` (n,), `tau` [s], and the flag `on`."""
    return struct_of("Stage", {"on": wp.bool, "tau": real, "start": wp.array(dtype=real)})


@functools.cache
def levels_struct(real: Any) -> Any:
    """Return the Warp structure of a forward-backward pass: all arrays but the rates.

    Vectors of all unknowns: the levels `now` and `past`, the `loss` and the `base`, the result
    `out`, which may be any of the levels, and the combinations `mass_mix` and `wind_mix` that the
    elements differentiate next. Numbers: `tau` [s]; `weights`, of (out, now, past) in the masses of
    `mass_mix` or the winds of `wind_mix`; `depth_weights`, the weights in the depth of `wind_mix`.
    """
    names = "now", "past", "loss", "base", "out", "mass_mix", "wind_mix"
    triple = wp.types.vector(3, real)
    members = dict.fromkeys(names, wp.array(dtype=real))
    return struct_of("Levels", members | {"tau": real, "weights": triple, "depth_weights": triple})


stage: Any = Placeholder(lambda of: stage_struct(of.real))
levels: Any = Placeholder(lambda of: levels_struct(of.real))
triple: Any = Placeholder(lambda of: wp.types.vector(3, of.real))


@functools.cache
def stage_store(fields: int) -> Any:
    """Return the device function (stage, at, size, rates, out): out[at] = start[at] + tau rate.

    If the stage is not `on`, out[at] = rate. The fields are `size` apart.
    """

    @Register.func_native(source("store_stage", fields=fields))
    def store_stage(s: stage, at: int, size: int, rates: rows(fields), out: vector): ...

    return store_stage


@functools.cache
def step_of(shifted: bool) -> Any:
    """Return the device function (now, past, at, rate, tau, weights, base, out, mixed).

    The function sets out = now + tau rate, and mixed = the weighted sum of (out, now, past), less
    `base` if `shifted`. Any of these may be the same array.
    """

    @Register.func_native(source("step", shift="sum -= *runs(base.data + at);" if shifted else ""))
    def step(
        now: vector, past: vector, at: int, rate: value, tau: real, weights: triple, base: vector,
        out: vector, mixed: vector,
    ): ...  # fmt: skip

    return step


@Register.func_native(source("mix_run"))
def mix_run(
    x: vector, levels: wp.array2d(dtype=real), weights: vector, first: int, last: int, at: int,
    out: vector,
): ...  # fmt: skip


@kernel
def mix(
    begin: int, size: int, fields: int, x: vector, levels: wp.array2d(dtype=real), weights: vector,
    first: int, last: int, out: vector,
):  # fmt: skip
    """Set out = x + sum_k w_k (levels_k - x) with first <= k < last, over runs of nodes.

    The runs start at node `begin`, and fields are `size` apart. `out` must be another array.
    """
    node = begin + lanes * wp.tid()
    for f in range(fields):
        mix_run(x, levels, weights, first, last, f * size + node, out)


@Register.func_native(source("diffusive_run"))
def diffusive_run(
    at: int, x: vector, last: vector, cl: real, before: vector, cb: real, rate: vector, cr: real,
    first: vector, cf: real, slope: vector, cs: real, change: vector, y: vector,
): ...  # fmt: skip


@kernel
def diffusive_stage(
    begin: int, x: vector, last: vector, cl: real, before: vector, cb: real, rate: vector, cr: real,
    first: vector, cf: real, slope: vector, cs: real, change: vector, y: vector,
):  # fmt: skip
    """Take a stage of a Runge-Kutta-Legendre method, over runs of vectors (n,) from `begin` on.

    change = cl last + cb before + cr rate + cf first + cs slope and y = x + change; `change` and
    `y` may be any of the vectors in the sums.
    """
    at = begin + lanes * wp.tid()
    diffusive_run(at, x, last, cl, before, cb, rate, cr, first, cf, slope, cs, change, y)
