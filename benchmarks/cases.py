"""The runs of the validation page: what is run, and what is required of it.

Every row is one function without arguments that returns its checks; `ROWS` holds them by name.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
from rhs_cost import measure

from swe_sphere.mesh import Interpolator, build_mesh
from swe_sphere.model import Model, Scene
from swe_sphere.model.effects import Viscosity
from swe_sphere.output.diagnostics import drifts, integrals
from swe_sphere.output.norms import errors
from swe_sphere.output.reference import SHIPPED, Reference, reference_errors
from swe_sphere.planet import DAY
from swe_sphere.steppers import get_stepper
from swe_sphere.testcases import get_scene

MASS = 1e-13
"""Largest relative drift of mass in any run."""


@dataclass(frozen=True)
class Check:
    """One measured number: at most `limit`, at least `floor`; without either it is only told."""

    quantity: str
    obtained: float
    limit: float | None = None
    floor: float | None = None

    @property
    def passed(self) -> bool | None:
        """Whether the number is within its bounds; None where there are none."""
        if self.limit is None and self.floor is None:
            return None
        high = math.inf if self.limit is None else self.limit
        low = -math.inf if self.floor is None else self.floor
        return low <= self.obtained <= high


@dataclass
class Run:
    """A finished run: the setting in words, the fields at its end, and the drifts."""

    setting: str
    model: Model
    scene: Scene
    seconds: float
    drifts: dict[str, float]
    fields: dict[str, np.ndarray]

    @property
    def mass(self) -> Check:
        """The drift of mass, which every run must keep."""
        return Check("mass drift", abs(self.drifts["mass_drift"]), MASS)

    @property
    def energy(self) -> Check:
        """The drift of energy, told."""
        return Check("energy drift", self.drifts["energy_drift"])


@dataclass
class Result:
    """A row of the page."""

    setting: str
    checks: list[Check]
    seconds: float = 0.0
    notes: list[str] = field(default_factory=list)


def integrate(
    scene: Scene, ne: int, np_: int, days: float, dt: float | None = None, stepper: str = "rk4"
) -> Run:
    """Run a scene for some days with the step dt [s], or the stepper's own safe one."""
    mesh = build_mesh(ne, np_, scene.planet.radius)
    model = Model(mesh, scene)
    cls, state = get_stepper(stepper), model.initial_state()
    if dt is None:
        spectrum = model.spectrum(state)
        dt = cls.safety * cls.stable_dt(spectrum.wave, spectrum.dissipation)
    count = math.ceil(days * DAY / dt - 1e-9)
    moving = cls(model, days * DAY / count)
    moving.start(state)
    before = _integrals(model, state, 0.0)
    start = time.perf_counter()
    for _ in range(count):
        moving.step()
    seconds = time.perf_counter() - start
    after = _integrals(model, moving.state, moving.time)
    fields = model.fields(moving.state, moving.time) | {
        "b": model.bottom,
        "vorticity": model.vorticity(moving.state, moving.time),
    }
    setting = f"{scene.name}, ne{ne} np{np_}, {stepper}, Δt = {moving.dt:.4g} s, {days:g} days"
    return Run(setting, model, scene, seconds, drifts(before, after), fields)


def _integrals(model: Model, state: object, t: float) -> dict[str, float]:
    u, v, h = (model.fields(state, t)[name] for name in "uvh")
    return integrals(model.mesh, model.scene.planet, u, v, h, model.bottom, model.coriolis)


def _exact_errors(run: Run, days: float) -> dict[str, float]:
    mesh = run.model.mesh
    exact = dict(zip("uvh", run.scene.exact(mesh.lon, mesh.lat, days * DAY), strict=True))
    return errors(mesh, run.fields, exact)


def _against(run: Run, file: str, name: str = "surface") -> dict[str, float]:
    return reference_errors(SHIPPED / file, run.model.mesh, run.fields, name)


def _williamson2(alpha: float, ne: int, np_: int, limit: float) -> Callable[[], Result]:
    def row() -> Result:
        run = integrate(get_scene("williamson2", alpha=alpha), ne, np_, 5.0)
        error = _exact_errors(run, 5.0)
        checks = [Check("l2(h)", error["l2_h"], limit), Check("l2(V)", error["l2_v"])]
        setting = run.setting.replace(",", f" α = {'π/4' if alpha else '0'},", 1)
        return Result(setting, [*checks, run.mass, run.energy], run.seconds)

    return row


def _known(
    setting: str, scene: Scene, ne: int, np_: int, limit: float | None = None
) -> Callable[[], Result]:
    """Five days of a scene whose answer is known."""

    def row() -> Result:
        run = integrate(scene, ne, np_, 5.0)
        error = _exact_errors(run, 5.0)
        checks = [Check("l2(h)", error["l2_h"], limit), Check("l2(V)", error["l2_v"])]
        if scene.forcing is None:  # a forcing of the depth is no exact sum of zero
            checks += [run.mass, run.energy]
        return Result(run.setting.replace(",", f" {setting},", 1), checks, run.seconds)

    return row


def williamson1() -> Result:
    """Cosine bell once around, as HOMME's regression test runs it."""
    run = integrate(get_scene("williamson1"), 11, 4, 12.0, 360.0, "leapfrog")
    error = _exact_errors(run, 12.0)
    homme = {"l1": 0.3080, "l2": 0.09563, "linf": 0.04883}
    checks = [Check(f"{n}(h)", error[f"{n}_h"], 1.05 * value) for n, value in homme.items()]
    note = "HOMME's figures are l1 0.3080, l2 0.09563, linf 0.04883; required: within 5 % or better"
    return Result(run.setting, [*checks, run.mass], run.seconds, [note])


def _williamson5(ne: int, np_: int, dt: float, limit: float) -> Callable[[], Result]:
    def row() -> Result:
        run = integrate(get_scene("williamson5"), ne, np_, 15.0, dt)
        error = _against(run, "williamson5_day15.nc")
        checks = [Check("l2(h + b)", error["l2"], limit), Check("linf(h + b)", error["linf"])]
        return Result(run.setting, [*checks, run.mass, run.energy], run.seconds)

    return row


def _williamson6(ne: int, np_: int, dt: float, limit: float | None) -> Callable[[], Result]:
    def row() -> Result:
        run = integrate(get_scene("williamson6"), ne, np_, 14.0, dt)
        error = _against(run, "williamson6_day14.nc")
        energy = Check("energy drift", abs(run.drifts["energy_drift"]), limit and 1e-7)
        return Result(
            run.setting, [Check("l2(h)", error["l2"], limit), run.mass, energy], run.seconds
        )

    return row


def galewsky_viscous() -> Result:
    """The unstable jet with the viscosity of the paper's converged runs."""
    run = integrate(get_scene("galewsky").with_effect(Viscosity(1e5)), 12, 8, 6.0)
    file = "galewsky_viscous_day6.nc"
    height, vorticity = _against(run, file), _against(run, file, "vorticity")
    checks = [
        Check("l2(h)", height["l2"], 5e-4),
        Check("l2(vorticity)", vorticity["l2"], 0.1),
        Check("1 - correlation of vorticity", 1.0 - _correlation(run, file), 0.01),
    ]
    setting = run.setting.replace(",", " with ν = 1e5 m² s⁻¹,", 1)
    return Result(setting, [*checks, run.mass], run.seconds)


def _correlation(run: Run, file: str) -> float:
    """Correlation of vorticity with the reference's: the same picture, in one number."""
    reference = Reference(SHIPPED / file)
    ours = Interpolator(run.model.mesh, *reference.points)(run.fields["vorticity"])
    covariance = np.cov(ours, reference.values("vorticity"), aweights=reference.area)
    return float(covariance[0, 1] / np.sqrt(covariance[0, 0] * covariance[1, 1]))


def _imprint(ne: int, np_: int, prototype: float, limit: float | None) -> Callable[[], Result]:
    def row() -> Result:
        run = integrate(get_scene("galewsky", perturbed=False), ne, np_, 4.0)
        checks = [Check("largest northward wind, m/s", float(np.abs(run.fields["v"]).max()), limit)]
        setting = run.setting.replace(",", " without the perturbation,", 1)
        note = f"an independent prototype of the same formulation: {prototype} m/s"
        return Result(setting, [*checks, run.mass, run.energy], run.seconds, [note])

    return row


def energy_order() -> Result:
    """Energy drift of rk4 under halving of the step: dissipation falls with the fifth power."""
    scene, steps = get_scene("williamson6"), (600.0, 300.0, 150.0, 75.0)
    runs = [integrate(scene, 8, 4, 1.0, dt) for dt in steps]
    size = [abs(run.drifts["energy_drift"]) for run in runs]
    checks = [Check(f"drift at Δt = {dt:g} s", x) for dt, x in zip(steps, size, strict=True)]
    for dt, coarse, fine in zip(steps[1:], size, size[1:], strict=False):
        checks.append(Check(f"order at Δt = {dt:g} s", math.log2(coarse / fine), floor=3.9))
    mass = max(abs(run.drifts["mass_drift"]) for run in runs)
    setting = "williamson6, ne8 np4, rk4, 1 day"
    seconds = sum(run.seconds for run in runs)
    note = "rk4 damps an oscillation by |R(iz)| = 1 - z⁶/144 a step, so order 5 over a given time"
    return Result(setting, [*checks, Check("mass drift", mass, MASS)], seconds, [note])


def cost() -> Result:
    """One right-hand side with DSS on one core; the whole table is in rhs_cost.md."""
    (case,) = measure([(4, "element", "float64")])
    check = Check("ns per element node", case.nanoseconds, 25.0)
    return Result(f"right-hand side with DSS, {case.label}", [check])


def _rows() -> Iterator[tuple[str, Callable[[], Result]]]:
    grids = (
        (8, 4, 2e-5, 2.5e-5),
        (15, 4, 1.5e-6, 2.5e-6),
        (4, 8, 5e-9, 1e-8),
        (8, 8, 4e-11, 6e-11),
    )
    for ne, np_, straight, tilted in grids:
        yield f"williamson2-ne{ne}np{np_}", _williamson2(0.0, ne, np_, straight)
        yield f"williamson2-tilted-ne{ne}np{np_}", _williamson2(np.pi / 4, ne, np_, tilted)
    for name, alpha, limit in (("", 0.0, 2.5e-7), ("-tilted", np.pi / 3.0, 1.6e-7)):
        scene = get_scene("williamson3", alpha=alpha)
        yield (
            f"williamson3{name}-ne8np8",
            _known(f"α = {'π/3' if name else '0'}", scene, 8, 8, limit),
        )
    for u0, ne, limit in ((20.0, 6, 7.5e-5), (20.0, 8, 5e-6), (40.0, 8, None)):
        scene = get_scene("williamson4", u0=u0)
        yield f"williamson4-u{u0:g}-ne{ne}np8", _known(f"u0 = {u0:g} m/s", scene, ne, 8, limit)
    yield "williamson1", williamson1
    yield "williamson5-ne16np4", _williamson5(16, 4, 600.0, 1.6e-4)
    yield "williamson5-ne8np8", _williamson5(8, 8, 300.0, 5e-5)
    yield "williamson6-ne16np4", _williamson6(16, 4, 360.0, 4e-3)
    yield "williamson6-ne8np8", _williamson6(8, 8, 200.0, None)
    yield "galewsky-viscous", galewsky_viscous
    for ne, np_, prototype in ((8, 8, 15.0), (12, 8, 0.20), (15, 4, 43.0), (30, 4, 11.0)):
        limit = 0.3 if (ne, np_) == (12, 8) else None
        yield f"imprint-ne{ne}np{np_}", _imprint(ne, np_, prototype, limit)
    yield "energy-order", energy_order
    yield "cost", cost


ROWS: dict[str, Callable[[], Result]] = dict(_rows())
"""All rows by name."""
