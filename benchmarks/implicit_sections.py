"""The sections of the page on implicit steppers: one function each, which returns a table."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from threadpoolctl import threadpool_limits

from swe_sphere.errors import RunFailed
from swe_sphere.linear import FlexibleGMRES, VectorSpace
from swe_sphere.linear.preconditioners import make_preconditioner
from swe_sphere.mesh import Mesh, build_mesh
from swe_sphere.model import Model
from swe_sphere.output.diagnostics import drifts, integrals
from swe_sphere.output.norms import errors, l2
from swe_sphere.output.reference import SHIPPED, Reference, reference_errors
from swe_sphere.planet import DAY, HOUR
from swe_sphere.steppers import RECOMMENDED, get_stepper
from swe_sphere.steppers.implicit import energy_weights
from swe_sphere.testcases import get_scene

DAYS = 15.0
MOUNTAIN = (1.5 * np.pi, np.pi / 6.0)


@dataclass
class Section:
    """One table of the page."""

    title: str
    note: str
    columns: list[str]
    rows: list[list[str]]


@dataclass
class Run:
    """What one run cost and where it ended."""

    model: Model
    stepper: Any
    seconds: float
    fields: dict[str, np.ndarray]
    energy_drift: float
    mass_drift: float

    @property
    def counts(self) -> str:
        """Newton and Krylov iterations a step."""
        steps, counters = self.stepper.steps, self.stepper.counters
        newton = counters.get("newton_iterations", 0) / steps
        return f"{newton:.1f} / {counters.get('krylov_iterations', 0) / steps:.1f}"


def run(model: Model, name: str, dt: float, days: float, **options: Any) -> Run:
    """Run a stepper from the scene's initial state."""
    stepper = get_stepper(name)(model, dt, **options)
    start = model.initial_state()
    stepper.start(start)
    began = time.perf_counter()
    for _ in range(round(days * DAY / dt)):
        stepper.step()
    seconds = time.perf_counter() - began
    drift = drifts(_integrals(model, start), _integrals(model, stepper.state))
    return Run(
        model, stepper, seconds, model.fields(stepper.state), drift["energy_drift"],
        drift["mass_drift"],
    )  # fmt: skip


def steady() -> Section:
    """An exact steady state at ever larger steps."""
    scene, mesh = get_scene("williamson2"), build_mesh(8, 8)
    rows = []
    for name, dt in (("rk4", 400.0), *((RECOMMENDED, h * HOUR) for h in (1, 6, 24, 120))):
        result = run(Model(mesh, scene), name, dt, 5.0)
        exact = dict(zip("uvh", scene.exact(mesh.lon, mesh.lat, 5.0 * DAY), strict=True))
        error = errors(mesh, result.fields, exact)
        rejected = str(result.stepper.counters.get("rejected_steps", 0))
        rows.append(
            [name, f"{dt:.0f}", f"{error['l2_h']:.2e}", f"{error['l2_v']:.2e}", result.counts,
             rejected, f"{result.seconds:.1f}"]
        )  # fmt: skip
        print(*rows[-1], sep=" | ", flush=True)  # noqa: T201 - a run takes a while
    return Section(
        "williamson2, ne8 np8, 5 days: the error of a steady state does not depend on the step",
        "A step that the solver cannot take at once is taken in parts (rejected).",
        ["stepper", "Δt [s]", "l2(h)", "l2(V)", "Newton / Krylov a step", "rejected", "wall [s]"],
        rows,
    )


def counts() -> Section:
    """Krylov iterations of a Newton step by step size, mesh and preconditioner."""
    steps = (1800.0, 3600.0, 7200.0, 14400.0)
    rows = []
    for ne, names in (
        (16, ("none", "jacobi", "helmholtz-schwarz", "helmholtz", "helmholtz-direct")),
        (32, ("helmholtz",)),
    ):
        model, state = _spun_up(build_mesh(ne, 4))
        for name in names:
            solves = [_newton_system(model, state, name, 0.5 * dt) for dt in steps]
            rows.append([f"ne{ne} np4", name, *(str(count) for count, _ in solves)])
    return Section(
        "williamson5, 6 hours in: Krylov iterations of one Newton step to 1e-2, by Δt",
        "Implicit step τ = Δt/2.  Required of `helmholtz`: 3, 4, 6, 10, the same within 30 % at "
        "ne32.  401 stands for no convergence in 400.",
        ["mesh", "preconditioner", *(f"{dt:.0f} s" for dt in steps)],
        rows,
    )


def price() -> Section:
    """Time of one preconditioner application in right-hand sides."""
    rows = []
    for ne, np_ in ((16, 4), (32, 4), (8, 8)):
        model, state = _spun_up(build_mesh(ne, np_))
        for name in ("jacobi", "helmholtz-schwarz", "helmholtz", "helmholtz-direct"):
            if (ne, np_) != (16, 4) and name in ("helmholtz-direct", "helmholtz-schwarz"):
                continue
            made = make_preconditioner(name, model)
            made.setup(state, 3600.0)
            out = model.zeros()
            rhs, tangent, apply = _interleaved(
                lambda m=model, s=state, o=out: m.tendency(s, 0.0, o),
                lambda m=model, s=state, o=out: m.tangent(s, o),
                lambda p=made, s=state, o=out: p.apply(s, o),
            )
            rows.append(
                [f"ne{ne} np{np_}", name, f"{1e3 * rhs:.3f}", f"{tangent / rhs:.2f}",
                 f"{apply / rhs:.2f}", f"{made.setup_seconds:.2f}"]
            )  # fmt: skip
    return Section(
        "Price of a Jacobian product and of a preconditioner application",
        "Medians of interleaved batches, in right-hand sides; required of `helmholtz`, np 4: 2.5.",
        ["mesh", "preconditioner", "right-hand side [ms]", "tangent", "application", "set-up [s]"],
        rows,
    )


def race() -> Section:
    """Time to 15 days of williamson5 on a uniform and on a stretched mesh."""
    uniform = [("semi-implicit", 1200.0), ("ars343", 3600.0)]
    uniform += [("bdf2", 3600.0), ("bdf2", 7200.0), ("bdf2", 14400.0)]
    uniform += [("tr-bdf2", 7200.0), ("tr-bdf2", 14400.0), ("tr-bdf2", 21600.0)]
    refined = [("bdf2", 1800.0), ("bdf2", 3600.0), ("tr-bdf2", 3600.0), ("tr-bdf2", 7200.0)]
    rows = _race_on("ne16 np4", build_mesh(16, 4), uniform)
    stretched = build_mesh(16, 4, stretch=4.0, centre=MOUNTAIN)
    rows += _race_on("ne16 np4, stretched 4", stretched, refined)
    return Section(
        "williamson5, 15 days: what accuracy costs in time",
        "Explicit steppers at 0.85 of their stability limit.  The gravity limit is that of "
        "leapfrog without filter, 1/ρ.  l2 near the mountain: within 30° of it.",
        ["mesh", "stepper", "Δt [s]", "Δt / gravity limit", "l2", "l2 near the mountain",
         "l2 vorticity", "Newton / Krylov a step", "wall [s]", "wall / rk4",
         "right-hand-side equivalents"],
        rows,
    )  # fmt: skip


def _race_on(label: str, mesh: Mesh, implicit: list[tuple[str, float]]) -> list[list[str]]:
    scene = get_scene("williamson5")
    model = Model(mesh, scene)
    wave = model.spectrum(model.initial_state()).wave
    explicit = [(name, 0.85 * get_stepper(name).stable_dt(wave)) for name in ("rk4", "leapfrog")]
    rows, rk4 = [], 0.0
    for name, dt in explicit + implicit:
        dt = DAYS * DAY / np.ceil(DAYS * DAY / dt)
        model = Model(mesh, scene)
        head = [label, name, f"{dt:.0f}", f"{dt * wave:.1f}"]
        try:
            result = run(model, name, dt, DAYS)
        except RunFailed as failure:
            rows.append([*head, str(failure).split(":")[0] + " failed", *[""] * 6])
            continue
        rk4 = rk4 or result.seconds
        rows.append([*head, *_outcome(result, rk4)])
        print(*rows[-1], sep=" | ", flush=True)  # noqa: T201 - a run takes a while
    return rows


def _outcome(result: Run, rk4: float) -> list[str]:
    """Errors and cost of a finished run of williamson5."""
    model, mesh, out = result.model, result.model.mesh, result.model.zeros()
    (rhs,) = _interleaved(lambda: model.tendency(result.stepper.state, 0.0, out))
    fields = result.fields | {"b": model.bottom}
    file = SHIPPED / "williamson5_day15.nc"
    depth = reference_errors(file, mesh, fields, field="surface")["l2"]
    fields["vorticity"] = model.vorticity(result.stepper.state)
    vorticity = reference_errors(file, mesh, fields, field="vorticity")["l2"]
    return [
        f"{depth:.2e}", f"{_near(mesh, fields):.2e}", f"{vorticity:.2e}", result.counts,
        f"{result.seconds:.1f}", f"{result.seconds / rk4:.2f}", f"{result.seconds / rhs:.0f}",
    ]  # fmt: skip


def drift() -> Section:
    """What each scheme does to the energy, by step."""
    mesh, scene = build_mesh(8, 4), get_scene("williamson5")
    names = (
        "implicit-midpoint", "gauss-legendre", "average-vector-field", "crank-nicolson", "bdf2",
        "tr-bdf2", "sdirk3", "esdirk4", "rosenbrock-w", "implicit-euler",
    )  # fmt: skip
    steps = (1800.0, 3600.0, 7200.0)
    rows = []
    for name in names:
        results = [run(Model(mesh, scene), name, dt, 15.0, tolerance=1e-6) for dt in steps]
        rows.append([name, *(f"{result.energy_drift:+.1e}" for result in results)])
    return Section(
        "williamson5, ne8 np4, 15 days: relative change of energy by Δt",
        "Solver tolerance 1e-6.  The schemes without damping keep the energy to the solver "
        "tolerance or to their order; the others dissipate the gravity waves of the start.",
        ["stepper", *(f"{dt:.0f} s" for dt in steps)],
        rows,
    )


def long_steps() -> Section:
    """How the Krylov count behaves as the step grows to five days."""
    model, state = _spun_up(build_mesh(8, 4))
    rows = []
    for hours in (1, 2, 4, 8, 12, 24, 48, 120):
        row = [f"{hours}"]
        for name in ("helmholtz", "helmholtz-direct"):
            count, residual = _newton_system(model, state, name, 0.5 * hours * HOUR)
            row += [str(count), f"{residual:.0e}"]
        rows.append(row)
    return Section(
        "williamson5, ne8 np4: Krylov iterations as Δt goes to five days",
        "To 1e-2, at most 400, τ = Δt/2.  Advection is not preconditioned.",
        ["Δt [h]", "helmholtz", "residual", "helmholtz-direct", "residual"],
        rows,
    )


SECTIONS: dict[str, Callable[[], Section]] = {
    "counts": counts,
    "price": price,
    "race": race,
    "steady": steady,
    "drift": drift,
    "long-steps": long_steps,
}
"""All sections by name."""


def _spun_up(mesh: Mesh) -> tuple[Model, wp.array]:
    """williamson5 six hours in, by rk4, where the start has shed its gravity waves."""
    model = Model(mesh, get_scene("williamson5"))
    limit = get_stepper("rk4").stable_dt(model.spectrum(model.initial_state()).wave)
    steps = int(np.ceil(6.0 * HOUR / (0.85 * limit)))
    stepper = get_stepper("rk4")(model, 6.0 * HOUR / steps)
    stepper.start(model.initial_state())
    for _ in range(steps):
        stepper.step()
    model.linearise(stepper.state, 0.0)
    return model, stepper.state


def _newton_system(model: Model, state: wp.array, name: str, tau: float) -> tuple[int, float]:
    """Krylov iterations for (I - tau J) d = tau F to 1e-2, and the relative residual reached."""
    space = VectorSpace(energy_weights(model))
    gmres = FlexibleGMRES(space, 200)
    made = make_preconditioner(name, model)
    if made is not None:
        made.setup(state, tau)

    def operator(d: wp.array, out: wp.array) -> None:
        model.tangent(d, out)
        space.axpby(1.0, d, -tau, out)

    rhs, d = space.zeros(), space.zeros()
    model.tendency(state, 0.0, rhs)
    space.scale(tau, rhs)
    with threadpool_limits(1, user_api="blas"):
        result = gmres.solve(
            operator, rhs, d, made.apply if made else None, rtol=1e-2, max_iterations=400
        )
    return (
        result.iterations if result.converged else 401,
        result.residual / result.history[0],
    )


def _interleaved(*calls: Callable[[], None], rounds: int = 15, batch: int = 10) -> list[float]:
    """Median seconds of each call, measured in turns."""
    seconds: list[list[float]] = [[] for _ in calls]
    with threadpool_limits(1, user_api="blas"):
        for _ in range(rounds):
            for times, call in zip(seconds, calls, strict=True):
                call()
                began = time.perf_counter()
                for _ in range(batch):
                    call()
                times.append((time.perf_counter() - began) / batch)
    return [float(np.median(times)) for times in seconds]


def _integrals(model: Model, state: wp.array) -> dict[str, float]:
    fields = model.fields(state)
    return integrals(
        model.mesh, model.scene.planet, fields["u"], fields["v"], fields["h"], model.bottom
    )


def _near(mesh: Mesh, fields: dict[str, np.ndarray]) -> float:
    """l2 of the surface height within 30 degrees of the mountain."""
    reference = Reference(SHIPPED / "williamson5_day15.nc")
    lon, lat = MOUNTAIN
    centre = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    area = mesh.area * (mesh.xyz @ centre > np.cos(np.radians(30.0)))
    exact = reference.at("surface", mesh.lon, mesh.lat)
    return l2(area, fields["h"] + fields["b"], exact)
