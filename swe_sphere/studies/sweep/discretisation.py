"""A scene on a mesh in one precision, and what all runs on it share, made once."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property, reduce
from typing import TYPE_CHECKING

import numpy as np

from swe_sphere.equations.scene import Scene
from swe_sphere.files.fingerprints import code_fingerprint, fingerprint
from swe_sphere.planet import DAY
from swe_sphere.simulation.config import RunConfig
from swe_sphere.simulation.setup import identity, make_mesh
from swe_sphere.simulation.simulation import Simulation
from swe_sphere.simulation.snapshot import Fields, state_integrals
from swe_sphere.simulation.supplied import Supplied
from swe_sphere.simulation.time_plan import TimePlan, common_measure, time_plan
from swe_sphere.studies.sweep.sweep_plan import SweepPlan

if TYPE_CHECKING:
    from swe_sphere.equations.model import Model
    from swe_sphere.equations.spectrum import Spectrum
    from swe_sphere.steppers import Stepper

History = dict[float, Fields]
"""Fields by report day."""


class Discretisation:
    """A scene on a mesh: its initial state, limits, and fresh simulations.

    config: of any run on it; its stepper does not matter.  own: a scene in the place of the one
    that is named there.  Raises ConfigError where scene or mesh
    cannot be made.
    """

    def __init__(self, config: RunConfig, own: Scene | None = None) -> None:
        self.config, self._own = config, own
        self.scene = Supplied(own).scene_of(config)
        self.mesh = make_mesh(config, self.scene)
        self._radii: dict[object, Spectrum] = {}

    @property
    def label(self) -> str:
        """The mesh and the precision in words."""
        return f"ne{self.mesh.ne} np{self.mesh.np} {self.config.precision}"

    @cached_property
    def identity(self) -> str:
        """The same for all discretisations of the same settings, files and code."""
        device, launch = self.config.device, self.config.launch
        same = identity(self.config, self.scene, self.mesh) | {"device": device, "launch": launch}
        same |= {"stepper": None, "code": code_fingerprint()}
        if self._own is not None:  # its functions may hang on more than its parameters
            same |= {name: str(values.tobytes()) for name, values in self.start.items()}
        return fingerprint(same)

    def simulation(self, config: RunConfig) -> Simulation:
        """A simulation with a model of its own: nothing of one run is left to the next.

        Raises:
            ConfigError: the stepper does not suit the scene, or takes no such option.
        """
        return Simulation.from_config(config, Supplied(self._own, self.mesh))

    @cached_property
    def _sim(self) -> Simulation:
        return self.simulation(self.config)

    @property
    def model(self) -> Model:
        """A model at hand, with no stepper's traces; not that of any run."""
        return self._sim.model

    @cached_property
    def start(self) -> Fields:
        """All fields at the start, bottom and Coriolis parameter included; each (N,)."""
        return self._sim.start

    @cached_property
    def limits(self) -> dict[str, float]:
        """Steps [s] that the start allows.

        gravity_limit: leapfrog's without filter, 1 over the spectral radius; advective_limit: the
        same, were there no gravity waves.
        """
        gravity = self._sim.gravity_limit
        at_start = state_integrals(self.model, self.start)
        wind, wave = at_start["max_wind"], at_start["max_wave"]
        if self.scene.effect("pressure-gradient") is None:
            wave = 0.0
        advective = gravity * ((wind + wave) / wind) if wind > 0.0 else np.inf
        return {"gravity_limit": gravity, "advective_limit": advective}

    @property
    def gravity_limit(self) -> float:
        """The longest step of leapfrog [s], about."""
        return self.limits["gravity_limit"]

    def stable_dt(self, kind: type[Stepper]) -> float:
        """Largest stable step [s] of a stepper at the start, about; infinite if there is none."""
        how = kind.spectrum.__func__  # type: ignore[attr-defined]
        if how not in self._radii:
            spectrum = kind.spectrum(self.model, self.model.initial_state())
            self._radii[how] = spectrum
        return kind.limit(self._radii[how])


@dataclass(frozen=True)
class Schedule:
    """Length of the runs and times at which their errors are taken [days]; the last is the end."""

    days: float
    report_days: tuple[float, ...]

    @classmethod
    def of(cls, days: float, report_days: tuple[float, ...]) -> Schedule:
        """The schedule with the end among its report days."""
        return cls(days, tuple(sorted({*report_days, days})))

    @cached_property
    def interval(self) -> float:
        """The longest time [s] of which all report times are multiples, to the millisecond."""
        times = [Fraction(day * DAY).limit_denominator(1000) for day in self.report_days]
        return float(reduce(common_measure, times))

    def steps(self, dt: float) -> TimePlan:
        """Steps of at most dt [s] that meet all report times.

        Raises:
            ConfigError: no step near dt does.
        """
        return time_plan(self.days, self.interval / 3600.0, dt)


class Discretisations:
    """The meshes and precisions of a plan, each made when it is first asked for.

    own: a scene in the place of the one that the plan names.
    """

    def __init__(self, plan: SweepPlan, own: Scene | None = None) -> None:
        self.plan, self.own = plan, own
        self._known: dict[tuple[int, int, str], Discretisation] = {}
        self.scene = scene = Supplied(own).scene_of(plan.run_config())
        self.ne, self.np = plan.ne or (scene.ne,), plan.np or (scene.np,)
        days = scene.days if plan.days is None else plan.days
        self.schedule = Schedule.of(days, plan.report_days)

    def at(self, ne: int, np: int, precision: str = "float64") -> Discretisation:
        """The one of that mesh and precision."""
        key = (ne, np, precision)
        if key not in self._known:
            config = self.plan.run_config(ne=ne, np=np, precision=precision)
            self._known[key] = Discretisation(config, self.own)
        return self._known[key]

    def all(self) -> list[Discretisation]:
        """Those that the plan asks for."""
        precisions = self.plan.precision
        return [self.at(ne, np, of) for ne in self.ne for np in self.np for of in precisions]
