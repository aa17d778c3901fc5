"""Long runs of flows that break down or return: waves, jets, vortices."""

from __future__ import annotations

from swe_sphere.studies.stress.groups.common import LONG, SOUND, bounded
from swe_sphere.studies.stress.trial import Bound, Group, Trial, each, remedied

__all__ = ["GALEWSKY", "MODONS", "ROSSBY_HAURWITZ"]


def _wave(label: str, perturbation: float) -> list[Trial]:
    run = {
        "scene": "williamson6", "ne": 8, "np": 4, "days": 100.0,
        "settings": (f"scene.perturbation={perturbation}",),
    }  # fmt: skip
    return each(
        LONG, name=f"rossby-haurwitz{label}", run=run, bounds=bounded(200.0),
        probes=("fourfold",), report=("symmetry_day", "off_wave", "energy_drift"),
        quick=("kg5",) if label else (), quickly={"run": {"ne": 6, "days": 10.0}},
    )  # fmt: skip


ROSSBY_HAURWITZ = Group(
    "rossby-haurwitz",
    "Rossby–Haurwitz wave, 100 days",
    "williamson6 without any dissipation, as it is and with its documented disturbance of 1 m. The"
    " wave is unstable: that it breaks is physical, and `symmetry_day` is the first day on which a"
    " hundredth of the mean of v² has left the zonal wavenumbers 0, 4, 8, … What is asked: finite"
    " to the end, mass kept, wind below 200 m/s (twice that of the start); or a stop that says why,"
    " and then the same run with hyperviscosity must pass.",
    (*remedied(_wave("", 0.0), LONG), *remedied(_wave("-disturbed", 1.0), LONG)),
)


def _jet(ne: int, steppers: tuple[str, ...]) -> list[Trial]:
    return each(
        steppers, name=f"galewsky-ne{ne}", run={"scene": "galewsky", "ne": ne, "np": 4,
        "days": 12.0}, bounds=bounded(160.0), report=("energy_drift", "enstrophy_drift"),
    )  # fmt: skip


GALEWSKY = Group(
    "galewsky",
    "Unstable jet without viscosity, 12 days",
    "galewsky beyond its usual end, when vorticity has cascaded to the grid scale and nothing takes"
    " it out. Asked: finite, mass kept, wind below 160 m/s (twice the jet); or a stop that says"
    " why, and then the same run with hyperviscosity must pass.",
    (*remedied(_jet(16, LONG), ()), *remedied(_jet(30, ("kg5", "leapfrog", "semi-implicit")), ())),
)

_MODONS = [
    trial
    for steppers, options in ((LONG[:-1], {}), (LONG[-1:], {"tolerance": 1e-6}))
    for trial in each(
        steppers, name="modons",
        run={"scene": "modons", "ne": 10, "np": 4, "days": 100.0, **options},
        bounds=(*SOUND, Bound("max_wind", 60.0), Bound("off_mirror", 1e-6)),
        probes=("mirror",), report=("energy_drift",),
    )
]  # fmt: skip
_BARE = each(
    ("rk4", "leapfrog", "tr-bdf2"), name="modons-bare", expect="either",
    run={"scene": "modons", "ne": 10, "np": 4, "days": 100.0,
         "settings": ("hyperviscosity.nu=0",)},
    bounds=bounded(150.0), probes=("mirror",), report=("off_mirror", "energy_drift"),
)  # fmt: skip

MODONS = Group(
    "modons",
    "Colliding modons, 100 days",
    "modons with the hyperviscosity that the scene calls for: finite, mass kept, wind below 60 m/s,"
    " the depth the same on both sides of the equator to 1e-6 of its variation. tr-bdf2 has a"
    " solver tolerance of 1e-6 here: solves end where the residual is small, not where it is"
    " symmetric, and with the default of 1e-2 the two sides end 1.8e-4 apart. And without"
    " hyperviscosity (bare): finite and below 150 m/s, or a stop that says why.",
    (*_MODONS, *_BARE),
)
