"""Hard starts, hard meshes, hard steps: noise, random states, single precision, long steps."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

from swe_sphere.studies.stress.groups.common import EXPLICIT, IMPLICIT, SOUND, SPLIT, bounded
from swe_sphere.studies.stress.random_state import random_setting
from swe_sphere.studies.stress.scenes import noisy
from swe_sphere.studies.stress.trial import Bound, Group, Trial, each, remedied

__all__ = ["GUARDS", "LONG_STEPS", "NOISE", "PRECISION", "RANDOM", "STRETCHED"]

ALL = (*EXPLICIT, *SPLIT, *IMPLICIT)

NOISE = Group(
    "noise",
    "Noise from node to node",
    "williamson2 and williamson5 with independent random"
    " numbers added at every node: rms 1 m/s in both winds, 10 m in depth; 5 days, no dissipation,"
    " every stepper. Asked: finite, mass kept, no wind above 1.5 times that of the start (2.5"
    " times for williamson5, whose wind doubles by itself), no rise of energy above 1e-5.",
    tuple(
        trial
        for scene, growth in (("williamson2", 1.5), ("williamson5", 2.5))
        for trial in each(
            ALL, name=f"noisy-{scene}", scene=partial(noisy, scene),
            run={"ne": 8, "np": 4, "days": 5.0},
            bounds=(*SOUND, Bound("wind_growth", growth), Bound("energy_gain", 1e-5)),
            report=("energy_drift",),
            quick=("ark2",) if scene == "williamson2" else (),
            quickly={"run": {"ne": 4, "days": 2.0}},
        )
    ),
)  # fmt: skip

SEEDS = 200
QUICK_SEEDS = 2
QUICK = ("rk4", "leapfrog", "bdf2")


def _random() -> list[Trial]:
    """The seeds are dealt out among the steppers."""
    return [
        Trial(
            f"random-{stepper}",
            {"stepper": stepper, "days": 1.0},
            bounds=(Bound("stopped", 0.0), Bound("mass_drift", 1e-12), Bound("froude", 1.0)),
            method="seeds",
            steps=12,
            seeds=tuple(range(index, SEEDS, len(ALL))),
            report=("seeds", "energy_gain", "rejected_steps"),
            quick={"seeds": _quick_seeds(index)} if stepper in QUICK else None,
        )
        for index, stepper in enumerate(ALL)
    ]


def _quick_seeds(index: int) -> tuple[int, ...]:
    """The first few of a stepper's seeds with np 4: others compile kernels of their own."""
    seeds = range(index, SEEDS, len(ALL))
    return tuple(seed for seed in seeds if random_setting(seed)[0]["np"] == 4)[:QUICK_SEEDS]


RANDOM = Group(
    "random",
    f"Random admissible states, {SEEDS} seeds",
    "Each seed is a planet, a mesh (np 3, 4 or 6, stretched up to 4, turned), hills, a balanced"
    " flow and noise (`stress/random_state.py` says from which ranges), a stepper, and a step:"
    " 0.3 to 0.95 of the stability limit, or 1 to 30 gravity-wave limits and at most advective"
    " Courant number 2 where there is none."
    " 12 steps, or a day if that is less. Asked of every one: it does not stop, mass is kept to"
    " 1e-12, and the wind, at most 0.6 of the speed of gravity waves at the start, never reaches it"
    " (`froude`). (Left to run for days some of these states run dry at their coarse resolution,"
    " with every stepper and every step.)",
    tuple(_random()),
)


def _precision() -> list[Trial]:
    steppers = ("rk4", "leapfrog", "semi-implicit", "tr-bdf2")
    asked = (
        ("williamson2", 8, (Bound("apart_h", 1e-5), Bound("l2_h", 1e-4))),
        ("williamson5", 8, (Bound("apart_h", 1e-4),)),
        ("williamson6", 12, (Bound("apart_h", 1e-4), Bound("off_wave", 1e-4))),
    )
    return [
        trial
        for scene, ne, bounds in asked
        for trial in each(
            steppers, name=f"single-{scene}",
            run={"scene": scene, "ne": ne, "np": 4, "days": 15.0}, method="precisions",
            bounds=(*bounds, Bound("mass_drift", 1e-5)), report=("apart_v",),
            probes=("fourfold",) if scene == "williamson6" else (),
            quick=("leapfrog",) if scene == "williamson2" else (),
            quickly={"run": {"ne": 4, "days": 5.0}, "bounds": (Bound("apart_h", 1e-5),)},
        )
    ]  # fmt: skip


PRECISION = Group(
    "precision",
    "Single against double precision, 15 days",
    "The same run in float32 and float64 (the metric is computed in float64 in both). Asked: depths"
    " apart by at most 1e-5 (williamson2) or 1e-4 (williamson5, williamson6) in relative l2, mass"
    " kept to 1e-5, and no pattern of the cube: at most 1e-4 of v² off the wavenumber of"
    " williamson6.",
    tuple(_precision()),
)

MULTIPLES = (1.0, 10.0, 100.0, 1000.0)
LONGEST = ("implicit-euler", "crank-nicolson", "tr-bdf2", "rosenbrock-w", "average-vector-field")
"""Those that are asked for the longest step, which takes each of them a minute."""


def _long_steps() -> list[Trial]:
    return [
        trial
        for multiple in MULTIPLES
        for trial in each(
            IMPLICIT if multiple < 1000.0 else LONGEST, name=f"long-{multiple:g}x",
            run={"scene": "williamson5", "ne": 6 if multiple < 1000.0 else 4, "np": 4},
            courant=multiple, steps=4 if multiple <= 10.0 else 1,
            bounds=(*SOUND, Bound("max_wind", 120.0), Bound("step_seconds", 600.0)),
            expect="either",
            report=("rejected_steps", "newton_iterations", "krylov_iterations"), seconds=600.0,
            quick=("tr-bdf2", "crank-nicolson") if multiple == 10.0 else (),
        )
    ]  # fmt: skip


LONG_STEPS = Group(
    "long-steps",
    "Implicit steps from 1 to 1000 times the gravity-wave limit",
    "williamson5 at ne6 np4, where 1/ρ is 12 minutes: 4 steps of 1 and 10 times that, one of"
    " 100 (20 hours); and at ne4 one of 1000 (13 days). A step is accepted (passed;"
    " `rejected_steps` counts how often it was halved) or refused with the reason. Asked:"
    " never a state that is no number, mass kept, wind below 120 m/s, no step that takes more than"
    " ten minutes of a busy core.",
    tuple(_long_steps()),
)


def _roughly(steppers: Sequence[str], factor: float, **values: Any) -> list[Trial]:
    """Trials that get viscosity where the coarse side resolves next to nothing."""
    trials = each(steppers, **values)
    return remedied(trials, steppers, "viscosity.nu=1e6") if factor > 2.0 else trials


def _stretched() -> list[Trial]:
    steppers = ("rk4", "leapfrog", "semi-implicit", "ars343", "tr-bdf2")
    place = {"centre_lon": 4.71, "centre_lat": 0.52}
    return [
        trial
        for factor, l2_v in ((2.0, 3e-3), (5.0, 5e-2), (10.0, 0.2))
        for trial in (
            *_roughly(("rk4", "leapfrog", "tr-bdf2"), factor, name=f"steady-stretch{factor:g}",
                  bounds=(*SOUND, Bound("l2_v", l2_v)),
                  run={"scene": "williamson2", "alpha": 0.78, "ne": 12, "np": 4, "days": 5.0,
                       "stretch": factor, **place}),
            *each(steppers, name=f"lake-stretch{factor:g}", bounds=(Bound("max_wind", 1e-10),),
                  run={"scene": "lake-at-rest", "ne": 8, "np": 4, "days": 1.0, "stretch": factor,
                       **place}),
            *_roughly(steppers, factor, name=f"mountain-stretch{factor:g}", bounds=bounded(80.0),
                  run={"scene": "williamson5", "ne": 8, "np": 4, "days": 10.0, "stretch": factor,
                       **place}, report=("energy_drift", "dt"),
                  quick=("rk4",) if factor == 2.0 else (),
                  quickly={"run": {"ne": 4, "days": 2.0}}),
        )
    ]  # fmt: skip


STRETCHED = Group(
    "stretched",
    "Stretched meshes, factors 2, 5 and 10",
    "Refined over the mountain of williamson5, coarser by the same factor at the antipode. Steady"
    " flow at ne12 np4 for 5 days: l2(v) ≤ 3e-3, 5e-2, 0.2 (the coarse side has 1/2, 1/5, 1/10 of"
    " the resolution); lake at rest for a day: no wind above 1e-10 m/s; williamson5 for 10 days:"
    " finite, mass kept, wind below 80 m/s. At factors 5 and 10 these two may break for want of"
    " resolution on the coarse side (a face of the cube has about one element there), and then must"
    " pass with a viscosity of 1e6 m²/s; so does steady flow without it at np 6 and ne8.",
    tuple(_stretched()),
)


def _guards() -> list[Trial]:
    """Steps beyond the limit, and one within it."""
    values: dict[str, Any] = {
        "run": {"scene": "williamson6", "ne": 6, "np": 4, "days": 5.0}, "method": "file",
        "report": ("last_day",),
    }  # fmt: skip
    finite = (Bound("not_finite", 0.0, always=True),)
    return [
        *each(EXPLICIT, name="beyond-limit", part=1.5, expect="refuse", bounds=finite,
              quick=("rk4", "leapfrog"), **values),
        *each(SPLIT, name="beyond-limit", part=1.5, expect="either", bounds=finite, **values),
        *each((*EXPLICIT, *SPLIT, "tr-bdf2"), name="within-limit", bounds=finite, **values),
    ]  # fmt: skip


GUARDS = Group(
    "guards",
    "Steps beyond the limit: what stands in the file",
    "williamson6 for 5 days with a file, with steps 1.5 times the stability limit at the start: the"
    " run must stop itself and say why (or, of steppers that split, may survive), and no value in"
    " its file may be anything but a number. With its own step the same run must pass.",
    tuple(_guards()),
)
