"""Sections on the solvers of implicit steppers: iterations and cost."""

from __future__ import annotations

import numpy as np
import warp as wp
from implicit_common import interleaved, run
from sections import Section
from threadpoolctl import threadpool_limits

from swe_sphere.equations.model import Model
from swe_sphere.equations.scene import apply_settings
from swe_sphere.equations.spectrum import SpectralRadii
from swe_sphere.io.integrals import by_name, field_errors
from swe_sphere.mesh import Mesh
from swe_sphere.planet import DAY, HOUR
from swe_sphere.solvers.krylov import FlexibleGMRES
from swe_sphere.solvers.preconditioners import make_preconditioner
from swe_sphere.steppers import RECOMMENDED, get_stepper
from swe_sphere.steppers.stage_solver import energy_space
from swe_sphere.testcases import get_scene


def steady() -> Section:
    """Errors of an exact steady state with increasing time steps."""
    scene, mesh = get_scene("williamson2"), Mesh.build(8, 8)
    rows = []
    steps = [(RECOMMENDED, h * HOUR, "helmholtz") for h in (1, 6, 24)]
    steps += [(RECOMMENDED, h * HOUR, "jacobian-direct") for h in (24, 120)]
    for name, dt, kind in (("rk4", 400.0, ""), *steps):
        options = {"preconditioner": kind} if kind else {}
        result = run("williamson2", mesh, name, dt, 5.0, **options)
        sim = result.sim
        exact = dict(zip("uvh", scene.exact(mesh.lon, mesh.lat, 5.0 * DAY), strict=True))
        error = by_name(field_errors(mesh.area, sim.snapshot.fields, exact))
        rejected = str(sim.stepper.counters.get("rejected_steps", 0))
        rows.append(
            [name, kind, f"{dt:.0f}", f"{error['l2_h']:.2e}", f"{error['l2_v']:.2e}", result.counts,
             rejected, f"{sim.wall_seconds:.1f}"]
        )  # fmt: skip
        print(*rows[-1], sep=" | ", flush=True)  # noqa: T201 - a run takes a while
    return Section(
        "williamson2, ne8 np8, 5 days: the error of a steady state does not depend on the step",
        "A step that the solver cannot solve is rejected and divided into shorter steps.",
        ["stepper", "preconditioner", "Δt [s]", "l2(h)", "l2(V)", "Newton / Krylov a step",
         "rejected", "wall [s]"],
        rows,
    )  # fmt: skip


def counts() -> Section:
    """Krylov iterations of a Newton step by step size, mesh and preconditioner."""
    steps = (1800.0, 3600.0, 7200.0, 14400.0)
    rows = []
    for label, ne, settings, names in (
        ("ne16 np4", 16, (), ("none", "helmholtz", "helmholtz-direct")),
        ("ne32 np4", 32, (), ("helmholtz",)),
        (
            "ne16 np4, 30 × default hyperviscosity",
            16,
            ("hyperviscosity.factor=30",),
            ("helmholtz",),
        ),
    ):
        model, state = _spun_up(Mesh.build(ne, 4), "williamson5", *settings)
        for name in names:
            solves = [_newton_system(model, state, name, 0.5 * dt) for dt in steps]
            rows.append([label, name, *(str(count) for count, _ in solves)])
    return Section(
        "williamson5, 6 hours in: Krylov iterations of one Newton step to 1e-2, by Δt",
        "One Newton step to 1e-2 of williamson5 after 6 hours, with implicit part τ = Δt/2. The "
        "value 401 means no convergence in 400 iterations.",
        ["mesh", "preconditioner", *(f"{dt:.0f} s" for dt in steps)],
        rows,
    )


def price() -> Section:
    """Time of one application of each preconditioner, in units of one right-hand side."""
    rows = []
    for ne, np_ in ((16, 4), (32, 4), (8, 8)):
        model, state = _spun_up(Mesh.build(ne, np_), "williamson5")
        for name in ("helmholtz", "jacobian-direct", "helmholtz-direct"):
            if (ne, np_) != (16, 4) and name == "helmholtz-direct":
                continue
            solving, point = model.for_solves, _for_solves(model, state)
            made = make_preconditioner(name, solving)
            made.setup(point, 3600.0)
            out, image = model.zeros(), solving.zeros()
            jacobian = solving.jacobian().update(point, 0.0)
            rhs, tangent, apply = interleaved(
                lambda m=model, s=state, o=out: m.tendency(s, 0.0, o),
                lambda j=jacobian, s=point, o=image: j(s, o),
                lambda p=made, s=point, o=image: p.apply(s, o),
            )
            rows.append(
                [f"ne{ne} np{np_}", name, f"{1e3 * rhs:.3f}", f"{tangent / rhs:.2f}",
                 f"{apply / rhs:.2f}", f"{model.counters['setup_seconds']:.2f}"]
            )  # fmt: skip
    return Section(
        "Price of a Jacobian product and of a preconditioner application",
        "Medians of batches made in turns. Products and applications are those of linear systems "
        "in float32. The unit is a right-hand side in float64, timed with each row; it varies with "
        "the load of the machine. τ is 3600 s, for which `helmholtz` takes one cycle "
        "of 2 Chebyshev steps on ne16 np4, two cycles on ne32 np4 and one of 9 steps on ne8 np8.",
        ["mesh", "preconditioner", "right-hand side [ms]", "tangent", "application", "set-up [s]"],
        rows,
    )


def long_steps() -> Section:
    """Krylov iterations by the advective Courant number."""
    rows = []
    for scene in ("williamson2", "williamson5", "williamson6", "galewsky"):
        model, before = _spun_up(Mesh.build(8, 4), scene)
        state = _stepped(model, before, 2.0 * HOUR)
        fastest = float(np.hypot(*before.numpy().reshape(3, -1)[:2]).max())
        for courant in (2, 5, 10, 20, 40):
            tau = 0.5 * courant * _shortest(model.mesh) / fastest
            made = {name: state for name in ("helmholtz", "helmholtz-direct", "jacobian-direct")}
            counts = [_newton_system(model, state, name, tau, at)[0] for name, at in made.items()]
            counts.append(_newton_system(model, state, "jacobian-direct", tau, before)[0])
            rows.append([scene, f"{courant}", f"{2.0 * tau / HOUR:.1f}", *map(str, counts)])
    return Section(
        "ne8 np4, 8 hours in: Krylov iterations by the advective Courant number of a step",
        "One Newton step to 1e-2, τ = Δt/2; 401 means no convergence in 400 iterations. The "
        "Courant number is that of the fastest wind and the shortest distance of nodes. The "
        "last column uses factors of the state two hours earlier.",
        ["scene", "Courant number", "Δt [h]", "helmholtz", "helmholtz-direct", "jacobian-direct",
         "two hours old"],
        rows,
    )  # fmt: skip


def _shortest(mesh: Mesh) -> float:
    """Return the shortest distance of two nodes along coordinate lines of an element [m]."""
    points = mesh.radius * mesh.xyz[mesh.nodes]
    lines = (np.diff(points, axis=axis) for axis in (1, 2))
    return min(float(np.linalg.norm(line, axis=-1).min()) for line in lines)


def _spun_up(mesh: Mesh, scene: str, *settings: str) -> tuple[Model, wp.array]:
    """Return model and state of a scene after six hours, when initial gravity waves have spread."""
    model = Model(mesh, apply_settings(get_scene(scene), settings))
    return model, _stepped(model, model.initial_state(), 6.0 * HOUR)


def _stepped(model: Model, state: wp.array, duration: float) -> wp.array:
    """Return the state after `duration` [s], computed by rk4."""
    spectrum = model.spectral_radii(state)
    limit = get_stepper("rk4").stable_dt(SpectralRadii(spectrum.wave, spectrum.dissipation))
    steps = int(np.ceil(duration / (0.85 * limit)))
    stepper = get_stepper("rk4")(model, duration / steps)
    stepper.start(state)
    for _ in range(steps):
        stepper.step()
    return stepper.state


def _for_solves(model: Model, x: wp.array) -> wp.array:
    """Return a vector in the number type of the model's linear systems."""
    return energy_space(model.for_solves).converted(x)


def _newton_system(
    model: Model, state: wp.array, name: str, tau: float, made_at: wp.array | None = None
) -> tuple[int, float]:
    """Krylov iterations for (I - tau J) d = tau F to 1e-2, and the relative residual reached.

    The preconditioner is set up at the state `made_at`, by default the same.
    """
    solving, point = model.for_solves, _for_solves(model, state)
    space = energy_space(solving)
    gmres = FlexibleGMRES(space, 200)
    made = make_preconditioner(name, solving)
    if made is not None:
        made.setup(point if made_at is None else _for_solves(model, made_at), tau)

    jacobian = solving.jacobian().update(point, 0.0)

    def operator(d: wp.array, out: wp.array) -> None:
        jacobian(d, out)
        space.axpby(1.0, d, -tau, out)

    slope, d = model.zeros(), space.zeros()
    model.tendency(state, 0.0, slope)
    rhs = _for_solves(model, slope)
    space.scale(tau, rhs)
    with threadpool_limits(1, user_api="blas"):
        result = gmres.solve(
            operator, rhs, d, made.apply if made else None, rtol=1e-2, max_iterations=400
        )
    return (
        result.iterations if result.converged else 401,
        result.residual / result.history[0],
    )
