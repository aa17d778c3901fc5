"""What should not change: steady flow over corners and poles, a lake at rest, other planets."""

from __future__ import annotations

from functools import partial

from swe_sphere.studies.stress.groups.common import EXPLICIT, IMPLICIT, LONG, MASS, SOUND, SPLIT
from swe_sphere.studies.stress.scenes import PLANETS, eddies, lake_over, mesa, peak, zonal
from swe_sphere.studies.stress.trial import Bound, Group, Trial, each

__all__ = ["PLANET_GROUP", "REST", "STEADY"]

ANGLES = {"0.05": 0.05, "pi/4": 0.7853981633974483, "pi/2-0.05": 1.5207963267948966}
LINEAR = (Bound("growth_v", 1.1), Bound("l2_v", 6e-3), Bound("l2_h", 6e-4))


def _steady() -> list[Trial]:
    return [
        trial
        for label, alpha in ANGLES.items()
        for trial in each(
            (*EXPLICIT, *SPLIT, "implicit-euler", "bdf2", "tr-bdf2") if label == "pi/4" else LONG,
            name=f"steady-{label}", run={"scene": "williamson2", "alpha": alpha, "ne": 6, "np": 4,
            "days": 30.0}, bounds=(*SOUND, *LINEAR),
            quick=("rk4", "leapfrog") if label == "pi/4" else (),
            quickly={"run": {"ne": 6, "days": 10.0}},
        )
    ]  # fmt: skip


STEADY = Group(
    "steady",
    "Steady flow over corners and poles, 30 days",
    "williamson2 at ne6 np4 with its axis at 0.05, π/4 and π/2 − 0.05. Asked: errors that grow at"
    " most linearly (`growth_v`, the largest error of the wind in the last ten days over three"
    " times that of the first ten, at most 1.1), l2(v) ≤ 6e-3 and l2(h) ≤ 6e-4 at the end, mass"
    " kept.",
    tuple(_steady()),
)


def _rest() -> list[Trial]:
    bottoms = {"cone": None, "mesa": partial(lake_over, mesa), "peak": partial(lake_over, peak)}
    return [
        trial
        for label, scene in bottoms.items()
        for precision, wind in (("float64", 1e-10), ("float32", 1e-3))
        for trial in each(
            (*EXPLICIT, *SPLIT, *IMPLICIT) if label == "cone" else LONG,
            name=f"lake-{label}-{precision}", scene=scene,
            run={"scene": "lake-at-rest", "ne": 8, "np": 4, "days": 5.0, "precision": precision},
            bounds=(Bound("max_wind", wind),), report=("mass_drift",),
            quick=("rk4", "leapfrog") if (label, precision) == ("mesa", "float64") else (),
        )
    ]  # fmt: skip


REST = Group(
    "rest",
    "Lake at rest, 5 days",
    "Water at rest over the cone of williamson5, over a mesa (2000 m with vertical sides: the"
    " bottom is discontinuous) and over a peak of 5000 m under 5960 m of water. Asked: no wind"
    " above 1e-10 m/s in float64, 1e-3 m/s in float32, ever.",
    tuple(_rest()),
)

STEPPERS = ("rk4", "leapfrog", "semi-implicit", "ars343", "tr-bdf2")


def _planets() -> list[Trial]:
    return [
        trial
        for planet in PLANETS
        for trial in (
            *each(STEPPERS, name=f"zonal-{planet}", scene=partial(zonal, planet),
                  run={"ne": 8, "np": 4, "days": 10.0},
                  bounds=(*SOUND, Bound("l2_h", 3e-4), Bound("l2_v", 3e-3)),
                  quick=("rk4",) if planet == "mars" else (), quickly={"run": {"ne": 6}}),
            *each(STEPPERS, name=f"eddies-{planet}", scene=partial(eddies, planet),
                  run={"ne": 8, "np": 4, "days": 10.0},
                  bounds=(MASS, Bound("wind_growth", 2.0), Bound("energy_drift", 1e-4))),
        )
    ]  # fmt: skip


PLANET_GROUP = Group(
    "planets",
    "Other planets, 10 days",
    "Mars, a planet like Jupiter, Venus (which turns slowly and backwards) and one that does not"
    " turn: steady zonal flow of 40 m/s (exact), and a random balanced flow without dissipation."
    " Asked: errors of the former within l2(v) ≤ 3e-3 and l2(h) ≤ 3e-4; of the latter a wind that"
    " does not double and energy kept to 1e-4; mass kept. Steps are chosen by the model.",
    tuple(_planets()),
)
