"""Mountains: a long run over one, steep and discontinuous ones, and water that runs out."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from swe_sphere.studies.stress.groups.common import KINDS, LONG, SOUND, bounded
from swe_sphere.studies.stress.scenes import dry_spot, flow_over, mesa, peak, thin_layer
from swe_sphere.studies.stress.trial import Bound, Group, Trial, each, remedied

__all__ = ["BOTTOMS", "DEPTH", "MOUNTAIN"]

MOUNTAINEERS = (*LONG, "ars343", "average-vector-field")

MOUNTAIN = Group(
    "mountain",
    "Flow over a mountain, 60 days",
    "williamson5 for four times its usual length at ne6, without dissipation. Asked: finite,"
    " mass kept, wind below 80 m/s (four times that of the start), energy that does not"
    " rise by more than 1e-4; or a stop that says why, and then the same"
    " run with hyperviscosity must pass.",
    tuple(
        remedied(
            each(
                MOUNTAINEERS,
                name="mountain",
                run={"scene": "williamson5", "ne": 6, "np": 4, "days": 60.0},
                bounds=(*bounded(80.0), Bound("energy_gain", 1e-4)),
                report=("energy_drift", "enstrophy_drift"),
                quick=("semi-implicit", "tr-bdf2"),
                quickly={"run": {"ne": 4, "days": 15.0}},
            ),
            MOUNTAINEERS,
        )
    ),
)


def _steep() -> list[Trial]:
    return [
        trial
        for label, bottom, wind in (("mesa", mesa, 150.0), ("peak", peak, 150.0))
        for trial in remedied(
            each(KINDS, name=f"over-{label}", scene=partial(flow_over, bottom),
                 run={"ne": 8, "np": 4, "days": 15.0}, bounds=bounded(wind),
                 report=("energy_drift",)),
            KINDS,
        )
    ]  # fmt: skip


BOTTOMS = Group(
    "bottoms",
    "Steep and discontinuous bottoms, 15 days",
    "The flow of williamson5 over a mesa (2000 m with vertical sides) and over a peak of 5000 m,"
    " which leaves about 900 m of water. Asked: finite, mass kept, wind below 150 m/s; or a stop"
    " that says why, and then the same run with hyperviscosity must pass.",
    tuple(_steep()),
)

THIN = (100.0, 10.0, 1.0)


def _thin() -> list[Trial]:
    steppers = ("rk4", "ssprk3", "leapfrog", "semi-implicit", "tr-bdf2", "average-vector-field")
    return [
        trial
        for depth in THIN
        for trial in remedied(
            each(steppers, name=f"onto-{depth:g}-m", scene=partial(thin_layer, depth),
                 run={"ne": 8, "np": 4, "days": 1.0}, bounds=SOUND, report=("max_wind",),
                 quick=("rk4",) if depth == 1.0 else ()),
            ("rk4", "tr-bdf2"),
        )
    ]  # fmt: skip


DEPTH = Group(
    "depth",
    "Depth that approaches zero",
    "What is guaranteed: no state with a negative depth is shown, written or gone on from; a run"
    " whose depth falls below zero stops and says so, and a scene that starts without water"
    " somewhere is refused. There is no limiter of the depth, so a bore onto thin water may be"
    " refused. Tried: a dam of 1000 m that breaks onto 100, 10 and 1 m of water (1 day, passes or"
    " is refused), and a mountain that looks out of the water (must be refused). Passive tracers do"
    " have a limiter: deformational with it keeps the bounds of the start to 1e-12 and every"
    " tracer's mass to 1e-13.",
    (
        # no dissipation makes a depth positive: with it a run may be refused as well
        *(replace(trial, expect="either") for trial in _thin()),
        *each(("rk4", "leapfrog", "semi-implicit", "tr-bdf2"), name="island", scene=dry_spot,
              run={"ne": 8, "np": 4, "days": 1.0}, expect="refuse", quick=("rk4",)),
        *each(("rk4", "ssprk3", "leapfrog"), name="limited-tracers",
              run={"scene": "deformational", "ne": 8, "np": 4, "days": 12.0,
                   "settings": ("tracers.limiter=true",)},
              bounds=(Bound("min_q_slotted_cylinders", low=0.1 - 1e-12),
                      Bound("max_q_slotted_cylinders", 1.0 + 1e-12),
                      Bound("min_q_cosine_bells", low=0.1 - 1e-12),
                      Bound("tracer_mass_drift", 1e-13))),
    ),
)  # fmt: skip
