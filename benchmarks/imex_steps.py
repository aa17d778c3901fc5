"""Limits of semi-implicit steppers by bisection, beside their automatic steps, and what they save.

    python benchmarks/imex_steps.py               all, half an hour; writes docs/imex_steps.md
    python benchmarks/imex_steps.py --meshes 8x4 --scenes williamson5

What was measured before is kept in docs/imex_steps.json; delete it to measure all again.
"""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
import warp as wp
from implicit_common import MOUNTAIN
from rich.console import Console

from swe_sphere.equations.model import Model
from swe_sphere.errors import RunFailed
from swe_sphere.files.fingerprints import machine
from swe_sphere.mesh import Mesh
from swe_sphere.operators import diagnose
from swe_sphere.planet import DAY
from swe_sphere.solvers.gravity_waves import advection_rate
from swe_sphere.steppers import STEPPERS, Stepper
from swe_sphere.testcases import get_scene

DOCS = Path(__file__).parents[1] / "docs"
STORE, PAGE = DOCS / "imex_steps.json", DOCS / "imex_steps.md"
SCENES = ("williamson2", "williamson5", "williamson6", "galewsky")
MESHES = ("8x4", "16x4", "6x8")
OTHERS = ("lauter 8x4", "williamson5@5 12x4", "williamson5@2 16x4", "williamson5@2 8x4x4")
"""Deep valleys, and slow winds over the mountain."""
NAMES = ("semi-implicit", "ark2", "ars343")
DAYS, NEARNESS, MUCH, FAST = 5.0, 1.06, 3.0, 20.0
WIND = 5.0
SLOW_RUNS = (("rk4", 1.0), ("leapfrog", 1.0), ("semi-implicit", 1.0), ("ars343", 0.5),
             ("ars343", 1.0))  # fmt: skip


def main(
    scenes: Annotated[str, typer.Option(help="SCENE[@M/S],...")] = ",".join(SCENES),
    meshes: Annotated[str, typer.Option(help="NExNP[xSTRETCH],...")] = ",".join(MESHES),
    slow: Annotated[bool, typer.Option(help="Also the runs with slow winds.")] = True,
) -> None:
    """Measure what is missing, and write the page."""
    wp.config.log_level = wp.LOG_WARNING
    np.seterr(all="ignore")
    known: dict[str, Any] = json.loads(STORE.read_text()) if STORE.exists() else {}
    keys = [f"{scene} {mesh}" for mesh in meshes.split(",") for scene in scenes.split(",")]
    for key in [*keys, *([*OTHERS, "slow"] if slow else [])]:
        if key not in known:
            known[key] = slow_wind() if key == "slow" else limits(*key.split())
            STORE.write_text(json.dumps(known, indent=1) + "\n")
            Console().print(key, known[key])
    PAGE.write_text("\n".join(page(known)))


def limits(scene: str, mesh: str) -> dict[str, Any]:
    """Automatic steps and limits [s], and rates of advection [s-1] at the start and at the most."""
    name, *speed = scene.split("@")
    ne, order, *stretch = map(int, mesh.split("x"))
    fine = {"stretch": float(stretch[0]), "centre": MOUNTAIN} if stretch else {}
    parameters = {"speed": float(speed[0])} if speed else {}
    model = Model(Mesh.build(ne, order, **fine), get_scene(name, **parameters))
    state = model.initial_state()
    found: dict[str, Any] = {"rk4": automatic(STEPPERS["rk4"], model, state)}
    wave = STEPPERS["ark2"].spectrum(model, state).wave
    found |= {"start": advection_rate(model, state), "told": wave, "most": strongest(model, state)}
    for name in NAMES:
        kind = STEPPERS[name]
        step = kind.safety * kind.stable_dt(wave)
        found[name] = [step, bisect(kind, model, state, step)]
    return found


def automatic(kind: type[Stepper], model: Model, state: wp.array) -> float:
    """The automatic step [s]."""
    spectrum = kind.spectrum(model, state)
    return kind.safety * kind.stable_dt(spectrum.wave, spectrum.dissipation)


def strongest(model: Model, state: wp.array) -> float:
    """Largest rate of advection [s-1], by rk4 on the same mesh."""
    stepper = STEPPERS["rk4"](model, automatic(STEPPERS["rk4"], model, state))
    stepper.start(state)
    rates = []
    while stepper.time < DAYS * DAY:
        stepper.step()
        if stepper.time >= len(rates) * DAYS * DAY / 10:
            rates.append(advection_rate(model, stepper.state))
    return max(rates)


def bisect(kind: type[Stepper], model: Model, state: wp.array, step: float) -> float:
    """The longest step that stays stable [s], to 6 %."""
    low, high = 0.0, np.inf
    while high > NEARNESS * low:
        works = stable(kind, model, state, step)
        low, high = (step, high) if works else (low, step)
        step = 1.4 * low if high == np.inf else float(np.sqrt(max(low, 0.5 * high) * high))
    return low


def stable(kind: type[Stepper], model: Model, state: wp.array, dt: float) -> bool:
    """Whether the wind stays below three times what it was, or slow."""
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


def slow_wind() -> list[list[Any]]:
    """Stepper, step [s], seconds of the steps, error of vorticity, over the slow flow."""
    model = Model(Mesh.build(16, 4), get_scene("williamson5", speed=WIND))
    state = model.initial_state()
    truth = vorticity(run(STEPPERS["rk4"], model, state, 200.0)[0], model)
    rows = []
    for name, part in SLOW_RUNS:
        step = part * automatic(STEPPERS[name], model, state)
        step = DAYS * DAY / np.ceil(DAYS * DAY / step)
        timed = [run(STEPPERS[name], model, state, step) for _ in range(3)]
        error = np.linalg.norm(vorticity(timed[0][0], model) - truth) / np.linalg.norm(truth)
        rows.append([name, step, min(seconds for _, seconds in timed), error])
    return rows


def run(kind: type[Stepper], model: Model, state: wp.array, dt: float) -> tuple[wp.array, float]:
    """The state at the end, and the seconds that the steps after the first took."""
    stepper = kind(model, dt)
    stepper.start(state)
    stepper.step()
    start = time.perf_counter()
    for _ in range(round(DAYS * DAY / dt) - 1):
        stepper.step()
    return stepper.state, time.perf_counter() - start


def vorticity(state: wp.array, model: Model) -> np.ndarray:
    """Relative vorticity (N,), weighted by area for norms."""
    fields = model.fields(state)
    return np.sqrt(model.mesh.area) * diagnose.vorticity(model.mesh, fields["u"], fields["v"])


def page(known: dict[str, Any]) -> list[str]:
    """The lines of the page."""
    columns = ["scene, mesh", "rk4", *(f"`{name}`" for name in NAMES), "ρ"]
    lines = [HEAD, f"| {' | '.join(columns)} |", "|---" * len(columns) + "|"]
    for key, found in known.items():
        if key != "slow":
            rates = ", ".join(f"{found[k]:.2e}" for k in ("start", "most", "told"))
            steps = " | ".join(cell(*found[name], found["rk4"]) for name in NAMES)
            lines.append(f"| {key} | {found['rk4']:.0f} | {steps} | {rates} |")
    lines += ["", SLOW, "| stepper | Δt [s] | time [s] | l2 of vorticity |", "|---|---|---|---|"]
    for name, step, seconds, error in known.get("slow", []):
        lines.append(f"| `{name}` | {step:.0f} | {seconds:.2f} | {error:.1e} |")
    return [*lines, "", f"{machine()}.", ""]


def cell(step: float, limit: float, explicit: float) -> str:
    """Automatic step and limit [s], their ratio, and the step over that of rk4."""
    return f"{step:.0f} of {limit:.0f} ({step / limit:.2f}; {step / explicit:.1f} × rk4)"


HEAD = f"""# What limits semi-implicit steps

Made by `python benchmarks/imex_steps.py`.

With gravity waves implicit, F − L is left to explicit steps.  Its largest eigenvalues, of advection
and the Coriolis force in one place, are not what breaks first: steppers blow up where their step
times ρ, the spectral radius of the advection of depth, −∇·(V h), at the *strongest wind of the
run*, exceeds their stability limit on the imaginary axis, over mountains as elsewhere.  In
williamson5 ρ more than doubles within six days, which its start does not tell: a limit from the
start is unsafe there and wasteful elsewhere.  So

* the limit is that of the advection at the strongest wind of a trial run with rk4 on a coarse mesh
  (six days), scaled to the mesh of the run; 0.85 of it is taken;
* on meshes so coarse that 1.25 · 2Ω exceeds ρ, inertial waves limit the step instead;
* the implicit waves run over the depth H from the bottom to the mean surface of the start (or 0.8
  of that to the highest surface, where that is more), so that little of them is left explicit over
  mountains too, however long the step.

The last has a reason that no limit by the wind can mend.  What is left explicit of a wave of
frequency ω where the depth deviates by δ = (h − H)/H is δ H div V, which does not commute with the
implicit part.  The step of `ark2` for the two unknowns of that wave amplifies it at δ = −0.32 from
ω Δt = 0.8 on, at −0.2 between 6 and 17, at 0.1 from 15 on, and not at all for −0.1 ≤ δ ≤ 0.05;
that of `ars343` not for −0.8 ≤ δ ≤ 0.1, that of leapfrog never.  With one H everywhere, δ is −0.32
over the mountain of williamson5: `ark2` blew up within two days at its automatic step in winds of
2 and 5 m/s, on stretched and on uniform meshes, while the other two did not.

For one wave in a constant wind, leapfrog with implicit gravity waves is stable up to an advective
Courant number ρ Δt of 1 (0.87 with the filter) whatever the deviation of the depth, and `ars343` up
to 2.8, but to 1.9 where explicit waves of the deviating depth are a third of the implicit ones:
that is taken.  No linear
multistep method exceeds 1 with one evaluation a step, so where the wind is a third of the wave
speed (williamson6) `semi-implicit` cannot have three times the step of rk4, whose limit is 2.83
over the sum of both.  `ars343` has more than that in all scenes.

Longer steps that were tried and left.  `ark2` with a32 = 0.8 for 0.97 is stable to ρ Δt = 1.14
(0.85: 1.40) for implicit waves of any speed, where it now has 0.89, and bears deviations of the
depth from −0.2 to 0.05.  At 0.8 automatic steps would be 1.28 times as long and 0.88, 0.60, 0.66,
0.58 and 0.38 of what bisection finds (williamson2, 5, 6, galewsky, lauter, 8x4); at 0.85 that of
williamson2 is 1.14 of it.  But at one step the error in time is 1.8 times as large in the wind and
1.35 times in the depth (lauter), so that the same error takes shorter steps.  `ars343` taken to
2.27 in the place of 1.9 blows up in galewsky (8x4) at day 5.3, when the jet has broken up, and does
not with 1.9 in ten days.

More of the waves implicit means a larger error in time, smoothly: of lauter (ne3, 900 s) the depth
of `semi-implicit` is wrong by 3.6e-5, 4.1e-5, 4.8e-5, 5.5e-5 where the reference depth is 0.4, 0.6,
0.8, 1.0 of that above, and by 3.9e-5 for one depth everywhere.  A shallower reference would leave
waves explicit of a depth that deviates upwards, which `ark2` bears worst.

Automatic step of the limit [s] (by bisection to 6 % over {DAYS:g} days, float64, no dissipation;
their ratio; the step over rk4's automatic one), and ρ [s⁻¹] at the start, at the strongest wind on
that mesh, and as the trial run tells it.  Behind @ is another wind than the scene's [m/s], behind
the mesh how often it is refined over the mountain:
"""

SLOW = f"""## What they save in a slow wind

williamson5 with a wind of {WIND:g} m/s, ne16 np4, {DAYS:g} days: time of the steps on one core, the
fastest of three, and the error of the vorticity against rk4 in steps of 200 s.  Steps
of rk4 are so cheap on a CPU that implicit gravity waves save no time on this mesh, though steps are
6 to 14 times as long; `leapfrog` costs least.  Taken on a busy machine: ratios are rough.
"""


if __name__ == "__main__":
    typer.run(main)
