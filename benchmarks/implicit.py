"""Measure implicit and exponential steppers and preconditioners; write their page.

    python benchmarks/implicit.py              all sections
    python benchmarks/implicit.py counts price
    python benchmarks/implicit.py --list

Sections that are not run keep what was measured before (benchmarks/results/implicit.json).
"""

from __future__ import annotations

import typer
from exponential_runs import exponential, exponential_steps
from implicit_newton import forcing, newton
from implicit_runs import drift, race
from implicit_solver import counts, long_steps, price, steady
from sections import command

SECTIONS = {
    "counts": counts,
    "price": price,
    "newton": newton,
    "forcing": forcing,
    "race": race,
    "steady": steady,
    "drift": drift,
    "long-steps": long_steps,
    "exponential": exponential,
    "exponential-steps": exponential_steps,
}
HEAD = """# Implicit and exponential steppers, measured

On williamson5 (15 days, ne16 np4) fully implicit steps of one to four hours, up to 58 gravity-wave
limits, cost 1.6 to 2.4 times as much as `rk4` and have its vorticity error; their depth error is
about 8e-4, the size of the gravity waves that they do not resolve, instead of 1.3e-4. On a mesh
refined four times `bdf2` costs 1.4 times as much as `rk4`. On a steady flow the error does not
depend on the step, up to one step of five days.

Made by `python benchmarks/implicit.py` (float64, one core). A right-hand-side equivalent is the
time of one right-hand side with DSS in the same process. Wall time is that of the steps alone, with
the set-up of the preconditioner and without compiling. l2 is that of the surface height relative to
the independent spectral reference unless stated otherwise.
[The preconditioner](preconditioners.md) has its own page, which lists ideas that were not kept.
"""


main = command("implicit", HEAD, SECTIONS)

if __name__ == "__main__":
    typer.run(main)
