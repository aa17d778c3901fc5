"""Errors of transport by resolution, with and without the limiter: a few minutes."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import product

import numpy as np
import typer
from mixing import filaments, mixing
from numpy.typing import NDArray
from sections import Section, command

from swe_sphere.equations.effects import Tracers
from swe_sphere.equations.model import Model
from swe_sphere.equations.scene import Scene, apply_settings
from swe_sphere.equations.spectrum import SpectralRadii
from swe_sphere.io.integrals import norms
from swe_sphere.mesh import Mesh
from swe_sphere.planet import DAY
from swe_sphere.steppers import STEPPERS
from swe_sphere.testcases import get_scene

PERIOD = 12.0 * DAY
SHARE = 0.5
"""Step as a fraction of the stability limit in the fastest wind: time errors are negligible."""
MESHES = ((5, 4), (10, 4), (20, 4), (4, 8), (8, 8))
CHEAP = ((5, 4), (10, 4), (4, 8))
DAMPED = ((5, 4), (10, 4))
"""Meshes (ne, np) with hyperviscosity, whose short steps are expensive on finer meshes."""
TREATMENTS = {
    "none": (),
    "limiter": ("tracers.limiter=true",),
    "hyperviscosity": ("hyperviscosity.factor=30",),
}
TARGET = 0.033
"""The l2 error of the cosine bells that defines the minimal resolution."""

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Run:
    """A run of 12 days: mesh, initial, middle and final fields, and cost."""

    mesh: Mesh
    start: dict[str, Array]
    middle: dict[str, Array]
    end: dict[str, Array]
    dt: float
    seconds: float

    @property
    def degrees(self) -> float:
        """Mean distance of nodes along the equator [degrees]."""
        return 90.0 / (self.mesh.ne * (self.mesh.np - 1))

    def error(self, name: str) -> dict[str, float]:
        """Return error norms of the mixing ratio relative to the initial one."""
        return norms(self.mesh.area, self.end[f"q_{name}"], self.start[f"q_{name}"])

    def drift(self, name: str) -> float:
        """Return the relative change of the mass of a tracer."""
        masses = [self.mesh.area @ fields[f"hq_{name}"] for fields in (self.start, self.end)]
        return float(masses[1] / masses[0] - 1.0)


def carried(scene: Scene, ne: int, np_: int) -> Run:
    """Return the run of a scene over 12 days with rk4."""
    mesh = Mesh.build(ne, np_)
    model = Model(mesh, scene)
    state = model.initial_state()
    spectra = (model.spectral_radii(state, t) for t in (0.0, 0.25 * PERIOD))
    limit = min(STEPPERS["rk4"].stable_dt(SpectralRadii(s.wave, s.dissipation)) for s in spectra)
    steps = 2 * math.ceil(0.5 * PERIOD / (SHARE * limit))
    stepper = STEPPERS["rk4"](model, PERIOD / steps)
    stepper.start(state)
    fields, begun = [model.fields(state)], time.perf_counter()
    for _ in range(2):
        for _ in range(steps // 2):
            stepper.step()
        fields.append(model.fields(stepper.state, stepper.time))
    start, middle, end = fields
    return Run(mesh, start, middle, end, stepper.dt, time.perf_counter() - begun)


def prices() -> Section:
    """Table of the time that tracers and the limiter take."""
    scene, bells = get_scene("williamson5"), get_scene("deformational").tracers or {}
    mesh, rows = Mesh.build(16, 4), []
    for count in (0, 1, 4):
        carried_along = dict(list(bells.items())[:count])
        effects = (*scene.effects, *([Tracers(limiter=True)] if count else []))
        model = Model(mesh, replace(scene, effects=effects, tracers=carried_along or None))
        state, out = model.initial_state(), model.zeros()
        tendency = least_time(partial(model.tendency, state, 0.0, out))
        limiter = "" if model.limiter is None else least_time(partial(model.limiter, state))
        rows.append([str(count), tendency, limiter])
    return Section(
        "Cost",
        "williamson5 at ne16 np4 with no, one or four tracers; the limiter is applied once a step.",
        ["tracers", "right-hand side [ms]", "limiter [ms]"],
        rows,
    )


def least_time(work: Callable[[], None], batches: int = 60) -> str:
    """Return the least time [ms] of a call as text: other programs only prolong calls."""
    times = []
    for _ in range(batches):
        begun = time.perf_counter()
        for _ in range(5):
            work()
        times.append((time.perf_counter() - begun) / 5)
    return f"{1e3 * min(times):.2f}"


def vortices() -> Section:
    """Table of the moving vortices."""
    rows, before = [], {}
    scene = get_scene("moving-vortices")
    for ne, np_ in MESHES:
        run = carried(scene, ne, np_)
        exact = scene.exact(run.mesh.lon, run.mesh.lat, PERIOD)[2]
        error = norms(run.mesh.area, run.end["h"], exact)
        rows.append([*size(run), *numbers(error), order(error["l2"], before, ne, np_)])
    return Section(
        "Moving vortices",
        "Nair & Jablonowski (2008), doi:10.1175/2007MWR2105.1, with α = π/4, transported as depth:"
        " vortices wind up a smooth front into an ever thinner spiral while they cross the corners"
        " of the cube. Coarse meshes do not resolve the spiral.",
        ["ne", "np", "degrees", "l1", "l2", "linf", "order"],
        rows,
    )


def reversals() -> Section:
    """Table of cases 1 to 3."""
    rows = []
    for case in (1, 2, 3):
        before: dict[tuple[int, int], float] = {}
        for ne, np_ in CHEAP:
            run = carried(get_scene("deformational", case=case), ne, np_)
            errors = {name: run.error(name) for name in ("gaussian_hills", "cosine_bells")}
            l2 = [errors[name]["l2"] for name in errors]
            drift = f"{abs(run.drift('gaussian_hills')):.0e}"
            rows.append([str(case), *size(run), *numbers(l2), order(l2[0], before, ne, np_), drift])
    return Section(
        "Deformational flow, cases 1 to 3",
        "Nair & Lauritzen (2010), doi:10.1016/j.jcp.2010.08.014: the wind reverses after day 6."
        " Without dissipation the spatial errors of this model are waves without damping and"
        " reverse too, even for filaments that the mesh has lost. The remaining error is that of"
        " the time steps. These rows show consistency (in case 3 the depth varies, and tracers with"
        " it) and conservation (mass: relative drift of the hills), but they say little about the"
        " accuracy of transport. Published errors of schemes with damping are not comparable.",
        ["case", "ne", "np", "degrees", "hills l2", "bells l2", "order", "mass"],
        rows,
    )


@cache
def treated(treatment: str, ne: int, np_: int) -> Run:
    """Return the run of case 4 with the effects of a treatment."""
    scene = get_scene("deformational", case=4)
    return carried(apply_settings(scene, TREATMENTS[treatment]), ne, np_)


def case_4() -> Section:
    """Table of case 4 with and without limiter and hyperviscosity."""
    rows = []
    names = list(get_scene("deformational", case=4).tracers or ())
    for treatment in TREATMENTS:
        before: dict[tuple[int, int], float] = {}
        for ne, np_ in DAMPED if treatment == "hyperviscosity" else MESHES:
            run = treated(treatment, ne, np_)
            l2 = [run.error(name)["l2"] for name in names]
            q = run.end["q_slotted_cylinders"]
            slope = order(l2[0], before, ne, np_)
            extremes = [f"{q.min() - 0.1:+.1e}", f"{q.max() - 1.0:+.1e}"]
            drift = f"{max(abs(run.drift(name)) for name in names):.0e}"
            rows.append([treatment, *size(run), *numbers(l2), slope, *extremes, drift])
    head = (
        "in addition to transport", "ne", "np", "degrees", "hills l2", "bells l2", "correlated l2",
        "cylinders l2", "order", "cylinders: min - 0.1", "max - 1", "mass",
    )  # fmt: skip
    undamped, limited = map(least_resolution, ("none", "limiter"))
    return Section(
        "Deformational flow, case 4",
        "A background flow carries the tracers once around the planet, so that errors cannot"
        " reverse. `--set tracers.limiter=true` returns every mixing ratio to its initial bounds"
        " after each step. `--set hyperviscosity.factor=30` damps unresolved scales in depth and"
        " tracers. Without either, the noise of lost filaments remains. Under- and overshoots are"
        " those of the slotted cylinders; mass is the largest relative drift of the four tracers."
        " Minimal resolution (Lauritzen et al. 2012, doi:10.5194/gmd-5-887-2012): the l2 error of"
        f" the bells is {TARGET} at a node distance of {limited} with the limiter, and {undamped}"
        " with neither limiter nor dissipation (np 4, from the last two meshes).",
        head, rows,
    )  # fmt: skip


def least_resolution(treatment: str) -> str:
    """Return as text the node distance at which the l2 of the bells is `TARGET`, for np 4."""
    runs = [treated(treatment, ne, 4) for ne in (10, 20)]
    x = np.log([run.degrees for run in runs])
    y = np.log([run.error("cosine_bells")["l2"] for run in runs])
    at = float(np.exp(x[1] + (np.log(TARGET) - y[1]) * (x[1] - x[0]) / (y[1] - y[0])))
    if at < 0.5 * runs[1].degrees:
        return f"far below {runs[1].degrees:.2g}°"
    return f"{at:.2g}°" + (" (extrapolated)" if at < runs[1].degrees else "")


def half_way() -> Iterator[tuple[list[str], Run]]:
    """Yield the first cells of a row, and the run, of case 4 on fine meshes."""
    for treatment, (ne, np_) in product(("none", "limiter"), ((20, 4), (8, 8))):
        yield [treatment, str(ne), str(np_)], treated(treatment, ne, np_)


def kept_filaments() -> Section:
    """Filaments of case 4 on day 6."""
    thresholds, bells = np.arange(0.1, 0.95, 0.1), "q_cosine_bells"
    rows = []
    for cells, run in half_way():
        shares = filaments(run.mesh.area, run.start[bells], run.middle[bells], thresholds - 1e-9)
        rows.append([*cells, *(f"{share:.1f}" for share in shares)])
    return Section(
        "Filaments on day 6",
        "Case 4: the area in which the cosine bells reach at least the threshold, in percent of the"
        " initial area (Lauritzen et al. 2012, section 3.3); 100 is exact.",
        ["in addition to transport", "ne", "np", *(f"{each:.1f}" for each in thresholds)], rows,
    )  # fmt: skip


def mixed() -> Section:
    """Mixing of two related tracers of case 4 on day 6."""
    rows = []
    for cells, run in half_way():
        bells, other = run.middle["q_cosine_bells"], run.middle["q_correlated"]
        rows.append([*cells, *numbers(mixing(run.mesh.area, bells, other))])
    return Section(
        "Mixing on day 6",
        'Case 4: the mean distance from the curve that relates the two tracers "cosine_bells" and'
        ' "correlated" (Lauritzen et al. 2012, section 3.5). Real mixing resembles physical mixing'
        " of air; unmixing and overshooting do not occur in nature.",
        ["in addition to transport", "ne", "np", "real mixing", "unmixing", "overshooting"], rows,
    )  # fmt: skip


def size(run: Run) -> list[str]:
    """Return the cells that identify the mesh."""
    return [str(run.mesh.ne), str(run.mesh.np), f"{run.degrees:.2g}"]


def numbers(values: dict[str, float] | Iterable[float]) -> list[str]:
    """Return the cells of small numbers."""
    return [f"{x:.1e}" for x in (values.values() if isinstance(values, dict) else values)]


def order(error: float, before: dict[tuple[int, int], float], ne: int, np_: int) -> str:
    """Return the observed order from the mesh with half the ne; errors are stored in `before`."""
    before[ne, np_] = error
    half = before.get((ne // 2, np_)) if ne % 2 == 0 else None
    return "" if half is None else f"{math.log2(half / error):.1f}"


main = command(
    "transport",
    {
        "prices": prices, "vortices": vortices, "reversals": reversals, "case-4": case_4,
        "filaments": kept_filaments, "mixing": mixed,
    },
)  # fmt: skip

if __name__ == "__main__":
    typer.run(main)
