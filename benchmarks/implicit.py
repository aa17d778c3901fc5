"""Measure implicit and exponential steppers and preconditioners, and write docs/implicit.md.

    python benchmarks/implicit.py              all sections
    python benchmarks/implicit.py counts price
    python benchmarks/implicit.py --list

Sections that are not run keep what was measured before (docs/implicit.json).
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

Made by `python benchmarks/implicit.py` (float64, one core).  A right-hand-side equivalent is the
time of one right-hand side with DSS in the same process; wall time is that of the steps alone,
set-up of the preconditioner included, compilation not.  l2 is that of the surface height against
the independent spectral reference unless said.  What was tried and what was learnt is told in
[preconditioners](preconditioners.md).
"""


main = command("implicit", HEAD, SECTIONS)

if __name__ == "__main__":
    typer.run(main)
