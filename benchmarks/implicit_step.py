"""Sections on an implicit step: where its time goes, and the number of Chebyshev steps."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable
from typing import Any
from unittest.mock import patch

import numpy as np
from implicit_common import DAYS
from sections import Section
from threadpoolctl import threadpool_limits

from swe_sphere.equations.model import Model
from swe_sphere.mesh import Mesh
from swe_sphere.planet import DAY
from swe_sphere.simulation.planning import RunPlan
from swe_sphere.simulation.simulation import Simulation
from swe_sphere.solvers.preconditioners import coarse as coarse_level
from swe_sphere.solvers.preconditioners import multilevel

DT = 3600.0
FIRST = 10
"""Steps before the clocks start: set-up, compiling and recording of launches."""
RUNS = 5
SMOOTHING = (4, 6, 8, 12, 16)
"""Numbers of Chebyshev steps that are compared."""
CASES = (
    (8, 6, "bdf2", 3600.0, 8.0), (8, 6, "tr-bdf2", 14400.0, 8.0), (8, 8, "bdf2", 1800.0, 3.0),
    (8, 8, "bdf2", 3600.0, 8.0), (8, 8, "tr-bdf2", 14400.0, 8.0), (6, 12, "bdf2", 3600.0, 3.0),
    (4, 16, "bdf2", 3600.0, 4.0), (4, 16, "bdf2", 7200.0, 4.0),
)  # fmt: skip
"""ne, np, stepper, step [s] and days of the runs that compare them."""


COARSE = (3, 4, 5, 6, 8)
"""Numbers of Chebyshev steps on the coarse functions that are compared."""
COARSE_CASES = (
    (16, "bdf2", 7200.0, 15.0), (16, "tr-bdf2", 14400.0, 15.0), (16, "bdf2", 14400.0, 10.0),
    (30, "bdf2", 3600.0, 8.0), (30, "bdf2", 7200.0, 4.0), (30, "tr-bdf2", 14400.0, 4.0),
    (60, "bdf2", 3600.0, 3.0), (60, "bdf2", 7200.0, 4.0),
)  # fmt: skip
"""ne, stepper, step [s] and days of the runs that compare them, np 4."""


PRECISION_CASES = (
    (16, "bdf2", 3600.0, 5.0), (16, "tr-bdf2", 14400.0, 5.0), (16, "esdirk4", 7200.0, 5.0),
    (16, "gauss-legendre", 3600.0, 3.0), (30, "bdf2", 3600.0, 2.0), (30, "tr-bdf2", 14400.0, 4.0),
    (60, "bdf2", 3600.0, 1.0), (60, "tr-bdf2", 14400.0, 2.0),
)  # fmt: skip
"""ne, stepper, step [s] and days of the runs that compare number types of linear systems."""


class Clocks:
    """Number of calls and wall time [s] of wrapped functions."""

    def __init__(self) -> None:
        self.calls: dict[str, int] = defaultdict(int)
        self.seconds: dict[str, float] = defaultdict(float)

    def timed(self, part: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """Return the function with a clock around it."""

        def call(*args: Any, **options: Any) -> Any:
            began = time.perf_counter()
            result = function(*args, **options)
            self.seconds[part] += time.perf_counter() - began
            self.calls[part] += 1
            return result

        return call


def step() -> Section:
    """Measure where the time of a step of bdf2 goes."""
    mesh = Mesh.build(16, 4)
    with threadpool_limits(1, user_api="blas"):
        runs = [_timed_run(mesh) for _ in range(RUNS)]
    steps, clocks = min(runs, key=lambda each: each[1].seconds["step"])
    labels = {
        "preconditioner": "preconditioner",
        "jacobian": "products d − τJd",
        "basis": "Krylov basis: products and combinations",
        "linearise": "linearisation",
        "residual": "residuals",
    }
    clocks.seconds["basis"] -= clocks.seconds["preconditioner"] + clocks.seconds["jacobian"]
    clocks.calls["basis"] = clocks.calls["jacobian"]
    spent = {name: 1e3 * seconds / steps for name, seconds in clocks.seconds.items()}
    rows = [
        [label, f"{clocks.calls[name] / steps:.2f}",
         f"{1e6 * clocks.seconds[name] / clocks.calls[name]:.0f}", f"{spent[name]:.2f}"]
        for name, label in labels.items()
    ]  # fmt: skip
    rest = spent["step"] - sum(spent[name] for name in labels)
    rows.append(
        ["initial guess, acceptance of the step, masses, norms, control", "", "", f"{rest:.2f}"]
    )
    rows.append(["whole step", "1.00", f"{1e3 * spent['step']:.0f}", f"{spent['step']:.2f}"])
    return Section(
        "Where the time of a step of bdf2 goes",
        f"williamson5, ne16 np4, {DT:.0f} s, one core: mean wall time over the steps of {DAYS:g} "
        f"days after the first {FIRST}, of the fastest of {RUNS} runs, with clocks around the "
        "calls.",
        ["part", "calls a step", "µs a call", "ms a step"],
        rows,
    )


def _timed_run(mesh: Mesh) -> tuple[int, Clocks]:
    """Return the number of timed steps, and the clocks of their parts."""
    steps = round(DAYS * DAY / DT)
    sim = Simulation("williamson5", mesh=mesh, stepper="bdf2")
    sim.begin(RunPlan(DT, steps, steps, DT))
    sim.stepper.take(FIRST)
    clocks, solver = Clocks(), sim.stepper.solver
    problem = solver.problem
    for owner, name, part in (
        (problem.precondition, "apply", "preconditioner"),
        (problem, "jacobian", "jacobian"),
        (problem, "residual", "residual"),
        (problem, "linearise", "linearise"),
        (solver.newton.gmres, "solve", "basis"),
        (sim.stepper, "step", "step"),
    ):
        setattr(owner, name, clocks.timed(part, getattr(owner, name)))
    for _ in range(steps - FIRST):
        sim.stepper.step()
    return steps - FIRST, clocks


def precision() -> Section:
    """Measure time and iterations of a step with linear systems in float64 and in float32."""
    rows = []
    for ne, stepper, dt, days in PRECISION_CASES:
        mesh, same = Mesh.build(ne, 4), property(lambda model: model)
        with threadpool_limits(1, user_api="blas"):
            single = [_smoothed(mesh, stepper, dt, days)]
            with patch.object(Model, "for_solves", same):
                double = [_smoothed(mesh, stepper, dt, days) for _ in range(2)]
            single.append(_smoothed(mesh, stepper, dt, days))
        seconds = [min(run[0] for run in runs) for runs in (double, single)]
        rows.append(
            [f"ne{ne} np4", stepper, f"{dt:.0f}", *(f"{1e3 * each:.3g}" for each in seconds),
             f"{seconds[1] / seconds[0]:.2f}", f"{double[0][3]:.2f}", f"{single[0][3]:.2f}"]
        )  # fmt: skip
        print(*rows[-1], sep=" | ", flush=True)  # noqa: T201 - a run takes a while
    return Section(
        "Linear systems in float32 and in float64",
        "williamson5, one core: CPU time of a step and Krylov iterations a step. Each time is the "
        "lesser of two runs; those in float64 come between those in float32.",
        ["mesh", "stepper", "Δt [s]", "float64 [ms]", "float32 [ms]", "ratio",
         "iterations in float64", "in float32"],
        rows,
    )  # fmt: skip


def smoothing() -> Section:
    """Measure time and iterations of a step by the number of Chebyshev steps in a cycle."""
    rows = []
    for ne, np_, stepper, dt, days in CASES:
        mesh = Mesh.build(ne, np_)
        counts = dict.fromkeys((None, *SMOOTHING))
        with threadpool_limits(1, user_api="blas"):
            runs = [{n: _smoothed(mesh, stepper, dt, days, n) for n in counts} for _ in range(2)]
        least = {n: min(run[n][0] for run in runs) for n in counts}
        _, kept, courant, _ = runs[0][None]
        rows.append(
            [f"ne{ne} np{np_}", stepper, f"{dt:.0f}", f"{courant:.1f}", f"{kept}",
             f"{1e3 * least[None]:.2f}", *(f"{least[n] / least[None]:.2f} ({runs[0][n][3]:.1f})"
             for n in SMOOTHING)]
        )  # fmt: skip
        print(*rows[-1], sep=" | ", flush=True)  # noqa: T201 - a run takes a while
    return Section(
        "Chebyshev steps of a cycle above np 4",
        "williamson5, one core. CPU time of a step, the lesser of two runs in turns. The last "
        "columns contain the time with a fixed number of Chebyshev steps over that with the "
        "number that is kept, and in brackets the Krylov iterations a step. The Courant number is "
        "the root of the largest diagonal entry of S, for the implicit time τ. From 40 on there "
        "are two cycles, the first one with half as many steps. Ratios of columns with the kept "
        "number show the scatter, up to an eighth.",
        ["mesh", "stepper", "Δt [s]", "Courant number", "kept", "ms a step",
         *(f"{n} steps" for n in SMOOTHING)],
        rows,
    )  # fmt: skip


def coarse() -> Section:
    """Measure iterations and time by the number of Chebyshev steps on coarse functions."""
    rows = []
    for ne, stepper, dt, days in COARSE_CASES:
        mesh = Mesh.build(ne, 4)
        with threadpool_limits(1, user_api="blas"):
            runs = [_smoothed(mesh, stepper, dt, days, of_coarse=n) for n in COARSE]
        rows.append(
            [f"ne{ne} np4", stepper, f"{dt:.0f}", f"{days:g}", f"{runs[0][2]:.1f}",
             *(f"{run[3]:.1f} ({1e3 * run[0]:.3g})" for run in runs)]
        )  # fmt: skip
        print(*rows[-1], sep=" | ", flush=True)  # noqa: T201 - a run takes a while
    return Section(
        "Chebyshev steps on the coarse functions",
        "williamson5, one core: Krylov iterations a step and, in brackets, CPU time of a step "
        "[ms] of one run. The Courant number is the root of the largest diagonal entry of S, for "
        f"the implicit time τ. The preconditioner takes {coarse_level.STEPS} steps.",
        ["mesh", "stepper", "Δt [s]", "days", "Courant number", *(f"{n} steps" for n in COARSE)],
        rows,
    )


def _smoothed(
    mesh: Mesh, stepper: str, dt: float, days: float, fixed: int | None = None,
    of_coarse: int = coarse_level.STEPS,
) -> tuple[float, int, float, float]:  # fmt: skip
    """Return CPU time a step, Chebyshev steps, Courant number, and iterations a step."""
    steps = round(days * DAY / dt)
    sim = Simulation("williamson5", mesh=mesh, stepper=stepper)
    least, most = (fixed or bound for bound in (multilevel.LEAST_STEPS, multilevel.MOST_STEPS))
    with (
        patch.multiple(multilevel, LEAST_STEPS=least, MOST_STEPS=most),
        patch.object(coarse_level, "STEPS", of_coarse),
    ):
        sim.begin(RunPlan(dt, steps, steps, dt))
        sim.stepper.take(1)
        began = time.process_time()
        for _ in range(steps - 1):
            sim.stepper.step()
        seconds = (time.process_time() - began) / (steps - 1)
    iterations = sim.stepper.counters["krylov_iterations"] / steps
    inner = sim.stepper.solver.problem.precondition
    if not hasattr(inner, "operator"):  # that of several stages
        return seconds, 0, 0.0, iterations
    courant = float(np.sqrt(inner.operator.diagonal.max()))
    return seconds, len(inner._multilevel._last), courant, iterations
