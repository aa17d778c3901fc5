"""Stability limits of semi-implicit steppers by bisection, their automatic steps, and their cost.

python benchmarks/imex_steps.py [limits] [slow] [long]       all by default: 45 min
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import typer
import warp as wp
from implicit_common import MOUNTAIN
from sections import Section, command

from swe_sphere.equations.model import Model
from swe_sphere.equations.spectrum import SpectralRadii
from swe_sphere.errors import RunFailed
from swe_sphere.mesh import Mesh
from swe_sphere.operators import diagnose
from swe_sphere.planet import DAY
from swe_sphere.simulation.simulation import Simulation
from swe_sphere.solvers.gravity_waves import advection_rate
from swe_sphere.steppers import STEPPERS, Stepper
from swe_sphere.testcases import get_scene

SCENES = ("williamson2", "williamson5", "williamson6", "galewsky")
MESHES = ("8x4", "16x4", "6x8")
OTHERS = ("lauter 8x4", "williamson5@5 12x4", "williamson5@2 16x4", "williamson5@2 8x4x4")
"""Scenes and meshes with large variations of depth, and with slow winds over the mountain."""
NAMES = ("semi-implicit", "ark2", "ars343")
DAYS, NEARNESS, MUCH, FAST = 5.0, 1.06, 3.0, 20.0
WIND = 5.0
LONG_MESHES, LONG_DAYS = ("6x6", "8x4", "12x4", "16x4", "20x4"), 100.0
LONG_NAMES = ("rk4", "leapfrog", "forward-backward", *NAMES)
SLOW_RUNS = (("rk4", 1.0), ("leapfrog", 1.0), ("semi-implicit", 1.0), ("ars343", 0.5),
             ("ars343", 1.0))  # fmt: skip


def all_limits() -> Section:
    """Automatic steps and limits of every scene and mesh."""
    np.seterr(all="ignore")
    keys = [*(f"{scene} {mesh}" for mesh in MESHES for scene in SCENES), *OTHERS]
    rows = []
    for key in keys:
        found = limits(*key.split())
        rates = ", ".join(f"{found[k]:.2e}" for k in ("start", "most", "told"))
        steps = [cell(*found[name], explicit=found["rk4"]) for name in NAMES]
        rows.append([key, f"{found['rk4']:.0f}", *steps, rates])
    return Section(
        "Automatic steps and measured limits",
        f"Each cell gives the automatic step and the limit [s], found by bisection to 6 % over"
        f" {DAYS:g} days (float64, no dissipation), with their ratio and the ratio of the step to"
        " the automatic step of rk4. ρ [s⁻¹] is given at the initial state, at the strongest wind"
        " on that mesh, and as the step assumes it (from the trial run, or 1.25 times the largest"
        " Coriolis parameter, if that is larger). A wind other than the scene's [m/s]"
        " follows @; a third number of the mesh is its refinement over the mountain.",
        ["scene, mesh", "rk4", *(f"`{name}`" for name in NAMES), "ρ"],
        rows,
    )


def limits(scene: str, mesh: str) -> dict[str, Any]:
    """Return automatic steps and limits [s], and initial and largest rates of advection [s-1]."""
    name, *speed = scene.split("@")
    ne, order, *stretch = map(int, mesh.split("x"))
    fine = {"stretch": float(stretch[0]), "centre": MOUNTAIN} if stretch else {}
    parameters = {"speed": float(speed[0])} if speed else {}
    model = Model(Mesh.build(ne, order, **fine), get_scene(name, **parameters))
    state = model.initial_state()
    found: dict[str, Any] = {"rk4": automatic(STEPPERS["rk4"], model, state)}
    wave = STEPPERS["ark2"].spectral_radii(model, state).wave
    found |= {"start": advection_rate(model, state), "told": wave, "most": strongest(model, state)}
    for name in NAMES:
        kind = STEPPERS[name]
        step = kind.safety * kind.stable_dt(SpectralRadii(wave))
        found[name] = [step, bisect(kind, model, state, step)]
    return found


def automatic(kind: type[Stepper], model: Model, state: wp.array) -> float:
    """Return the automatic step [s]."""
    spectrum = kind.spectral_radii(model, state)
    return kind.safety * kind.stable_dt(SpectralRadii(spectrum.wave, spectrum.dissipation))


def strongest(model: Model, state: wp.array) -> float:
    """Return the largest rate of advection [s-1] in a run of rk4 on the same mesh."""
    stepper = STEPPERS["rk4"](model, automatic(STEPPERS["rk4"], model, state))
    stepper.start(state)
    rates = []
    while stepper.time < DAYS * DAY:
        stepper.step()
        if stepper.time >= len(rates) * DAYS * DAY / 10:
            rates.append(advection_rate(model, stepper.state))
    return max(rates)


def bisect(kind: type[Stepper], model: Model, state: wp.array, step: float) -> float:
    """Return the longest stable step [s], to 6 %; step: first guess."""
    low, high = 0.0, np.inf
    while high > NEARNESS * low:
        works = stable(kind, model, state, step)
        low, high = (step, high) if works else (low, step)
        step = 1.4 * low if high == np.inf else float(np.sqrt(max(low, 0.5 * high) * high))
    return low


def stable(kind: type[Stepper], model: Model, state: wp.array, dt: float) -> bool:
    """Return whether the wind stays slow, or below three times its initial maximum."""
    stepper = kind(model, dt)
    stepper.start(state)
    n = model.mesh.size
    most = max(MUCH * np.abs(state.numpy()[: 2 * n]).max(), FAST)
    for step in range(round(DAYS * DAY / dt)):
        try:
            stepper.step()
        except RunFailed:
            return False
        if step % 10 == 0 and not np.abs(stepper.state.numpy()[: 2 * n]).max() < most:
            return False
    return bool(np.abs(stepper.state.numpy()[: 2 * n]).max() < most)


def slow_wind() -> Section:
    """Cost and errors of vorticity of semi-implicit steppers in a slow wind."""
    model = Model(Mesh.build(16, 4), get_scene("williamson5", speed=WIND))
    state = model.initial_state()
    truth = vorticity(run(STEPPERS["rk4"], model, state, 200.0)[0], model)
    rows = []
    for name, part in SLOW_RUNS:
        step = part * automatic(STEPPERS[name], model, state)
        step = DAYS * DAY / np.ceil(DAYS * DAY / step)
        timed = [run(STEPPERS[name], model, state, step) for _ in range(3)]
        error = np.linalg.norm(vorticity(timed[0][0], model) - truth) / np.linalg.norm(truth)
        seconds = min(seconds for _, seconds in timed)
        rows.append([f"`{name}`", f"{step:.0f}", f"{seconds:.2f}", f"{error:.1e}"])
    return Section(
        "Cost in a slow wind",
        f"williamson5 with a wind of {WIND:g} m/s, ne16 np4, {DAYS:g} days: time of the steps on"
        " one core, fastest of three, and the error of vorticity against rk4 with Δt = 200 s.",
        ["stepper", "Δt [s]", "time [s]", "l2 of vorticity"],
        rows,
    )


def long_runs() -> Section:
    """Return the last days of long runs with the automatic steps of short and of long runs."""
    rows = []
    for mesh in LONG_MESHES:
        ne, order = map(int, mesh.split("x"))
        row = [f"ne{ne} np{order}"]
        for name in LONG_NAMES:
            given = {"ne": ne, "np": order, "stepper": name, "days": LONG_DAYS}
            given["effects"] = {"edge-penalty": {"c": "default"}}
            sim = Simulation("williamson5", **given)
            sim.begin()
            short = STEPPERS[name].safety * sim.stable_dt()
            lasts = [last_day(Simulation("williamson5", **given, dt=short))]
            if STEPPERS[name].long_run_factor < 1.0:
                lasts.append(last_day(Simulation("williamson5", **given)))
            row.append("; ".join(lasts))
        rows.append(row)
    return Section(
        "Automatic steps in long runs",
        f"The day on which a run of williamson5 with the default edge penalty stops as unstable, at"
        " 0.85 of the stability limit, and behind the semicolon at the shorter automatic step of"
        f" runs of more than 20 days; a dash for runs that complete {LONG_DAYS:g} days.",
        ["mesh", *(f"`{name}`" for name in LONG_NAMES)],
        rows,
    )


def last_day(sim: Simulation) -> str:
    """Return the last day of a run as text, a dash for a run that reaches its end."""
    summary = sim.run(progress=False)
    return "–" if summary["completed"] else f"{summary['days']:.1f}"


def run(kind: type[Stepper], model: Model, state: wp.array, dt: float) -> tuple[wp.array, float]:
    """Return the final state, and the time [s] of all steps but the first."""
    stepper = kind(model, dt)
    stepper.start(state)
    stepper.step()
    start = time.perf_counter()
    for _ in range(round(DAYS * DAY / dt) - 1):
        stepper.step()
    return stepper.state, time.perf_counter() - start


def vorticity(state: wp.array, model: Model) -> np.ndarray:
    """Return relative vorticity (N,), multiplied by weights so that its norm is an area mean."""
    fields = model.fields(state)
    return np.sqrt(model.mesh.area) * diagnose.vorticity(model.mesh, fields["u"], fields["v"])


def cell(step: float, limit: float, explicit: float) -> str:
    """Return as text: automatic step and limit [s], their ratio, and the step over that of rk4."""
    return f"{step:.0f} of {limit:.0f} ({step / limit:.2f}; {step / explicit:.1f} × rk4)"


main = command("imex_steps", {"limits": all_limits, "slow": slow_wind, "long": long_runs})

if __name__ == "__main__":
    typer.run(main)
