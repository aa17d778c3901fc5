"""Measure implicit and exponential steppers and preconditioners.

python benchmarks/implicit.py              all sections
python benchmarks/implicit.py counts price
python benchmarks/implicit.py --list
"""

from __future__ import annotations

import typer
from exponential_runs import exponential, exponential_steps
from implicit_newton import forcing, newton
from implicit_runs import drift, race
from implicit_solver import counts, long_steps, price, steady
from implicit_step import coarse, precision, smoothing, step
from sections import command

SECTIONS = {
    "counts": counts,
    "price": price,
    "step": step,
    "precision": precision,
    "smoothing": smoothing,
    "coarse": coarse,
    "newton": newton,
    "forcing": forcing,
    "race": race,
    "steady": steady,
    "drift": drift,
    "long-steps": long_steps,
    "exponential": exponential,
    "exponential-steps": exponential_steps,
}

main = command("implicit", SECTIONS)

if __name__ == "__main__":
    typer.run(main)
