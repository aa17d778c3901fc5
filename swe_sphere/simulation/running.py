"""A simulation as it stands: its state, the numbers taken of it, and what it has cost."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from functools import cached_property
from typing import TYPE_CHECKING

from swe_sphere.errors import ConfigError
from swe_sphere.files.user_file import users_code
from swe_sphere.planet import DAY
from swe_sphere.simulation.config import RunConfig
from swe_sphere.simulation.diagnostics import DIAGNOSTICS, Diagnostic, OwnDiagnostics
from swe_sphere.simulation.prepared import Prepared
from swe_sphere.simulation.restart import carried_counts, check_step, steps_at_once
from swe_sphere.simulation.snapshot import Evaluator, Fields, Snapshot
from swe_sphere.simulation.summary import Outcome
from swe_sphere.simulation.supplied import Supplied
from swe_sphere.simulation.time_plan import TimePlan, continued_plan, time_plan

if TYPE_CHECKING:
    from swe_sphere.io.checkpoint import Checkpoint
    from swe_sphere.steppers import Stepper


class Running(Prepared):
    """What can be seen of a simulation, whose stepper `begin` makes when it is first needed."""

    def __init__(
        self, config: RunConfig, supplied: Supplied, checkpoint: Checkpoint | None = None
    ) -> None:
        super().__init__(config, supplied, checkpoint)
        self.wall_seconds = self.cpu_seconds = 0.0
        """Time spent stepping [s], without compiling, observing and writing; that of processors,
        all threads and compiling included."""
        self.outcome = Outcome("not begun")
        self.dt_rule = "as given"
        """How the step was chosen, in words."""
        self._stepper: Stepper | None = None
        self._plan: TimePlan | None = None
        self._carried: dict[str, float] = {}
        self._before: dict[str, int] = {}
        self._own = OwnDiagnostics(lambda text: None)
        self._snapshot: Snapshot | None = None
        self._numbers: dict[str, float] | None = None
        self._own_found: tuple[dict[str, float], Fields] | None = None
        self._own_registered: dict[str, Diagnostic] = {}
        """Those that have been found."""
        before = self._checkpoint
        self.run_id = "" if before is None else str(before.attributes.get("run_id", ""))
        """That of the file of frames that was written last, or that a restart goes on from."""

    def begin(self, plan: TimePlan | None = None, also: Sequence[Fraction] = ()) -> None:
        """Plan the steps up to the end; what has been stepped already keeps its length of steps.

        plan: the steps to take, in the place of those that the configuration asks for.
        also: further times [s] whose multiples fall on steps.

        Raises:
            ConfigError: step, length, frames and further times do not go together.
        """
        self._plan = self._planned(also) if plan is None else self._in_cycles(plan)
        if self._stepper is None or self._stepper.steps == 0:
            self._make_stepper(self._plan.dt, self._plan.cycle)

    def _planned(self, also: Sequence[Fraction]) -> TimePlan:
        days, every = self.days, self.config.every
        stepper = self._stepper or self._supplied.instance
        if stepper is not None and (stepper.steps or self._supplied.instance):
            cycle = self._plan.cycle if self._plan else 1
            return continued_plan(days, every, stepper.dt, stepper.steps, also, cycle)
        if self._checkpoint is not None and self._checkpoint.steps:
            dt, done = check_step(self.config, self._checkpoint), self._checkpoint.steps
            self.dt_rule = "that of the restart file"
            return continued_plan(days, every, dt, done, also, steps_at_once(self._checkpoint))
        choice = self._choice()
        self.dt_rule = choice.rule
        asked = self.config.tracer_steps
        return time_plan(
            days, every, choice.dt, also, self._tracer_steps(choice.dt), asked == "auto"
        )

    def _in_cycles(self, plan: TimePlan) -> TimePlan:
        """The same steps, as many of them at once as the configuration says or allows."""
        if self._checkpoint is not None:
            return plan
        most, both = self._tracer_steps(plan.dt), math.gcd(plan.steps, plan.frame_steps)
        if self.config.tracer_steps == "auto":
            most = max(k for k in range(1, most + 1) if both % k == 0)
        if both % most:
            raise ConfigError(
                f"tracer-steps={most}: {both} steps between frames are no multiple of it"
            )
        return replace(plan, cycle=most)

    def _make_stepper(self, dt: float, cycle: int) -> None:
        """Build the stepper, and put it at the start or where the restart stands."""
        supplied, checkpoint = self._supplied, self._checkpoint
        state = self.model.initial_state()
        self._before = dict(self.model.counters)
        self.forget()
        with users_code():
            self._stepper = stepper = supplied.instance or self._new_stepper(dt, cycle)
            if checkpoint is not None:
                self._carried = carried_counts(checkpoint)
                stepper.load_state_dict(checkpoint.state_dict, checkpoint.steps)
            elif stepper.steps == 0:
                stepper.start(state)

    @property
    def stepper(self) -> Stepper:
        """The stepper, which stands at the start of the scene or of the restart at first."""
        if self._stepper is None and self._checkpoint is not None and self._checkpoint.steps:
            dt, done = check_step(self.config, self._checkpoint), self._checkpoint.steps
            self.begin(TimePlan(dt, done, done, dt, steps_at_once(self._checkpoint)))
        elif self._stepper is None:
            self.begin()
        assert self._stepper is not None
        return self._stepper

    @property
    def plan(self) -> TimePlan:
        """The steps up to the end of the run."""
        _ = self.stepper  # which is planned for first
        assert self._plan is not None
        return self._plan

    @property
    def steps(self) -> int:
        """Steps since the very start."""
        return self.stepper.steps

    @property
    def time(self) -> float:
        """Simulated time since the very start [s]."""
        return self.plan.time(self.stepper.steps)

    @property
    def snapshot(self) -> Snapshot:
        """The state as it stands, with its fields as arrays (N,)."""
        if self._snapshot is None or self._snapshot.steps != self.steps:
            self._snapshot = Snapshot(self.model, self.stepper.state, self.time, self.steps)
            self._numbers = self._own_found = None
        return self._snapshot

    @cached_property
    def _evaluator(self) -> Evaluator:
        return Evaluator(self.model, self.start, self._step_length)

    def _step_length(self) -> float:
        """The present step [s], which follows its error in an adaptive run."""
        return float(getattr(self.stepper, "next_dt", self.plan.dt))

    def forget(self) -> None:
        """Let go of the fields of the state, which take room while steps are taken."""
        self._snapshot = None

    @property
    def diagnostics(self) -> dict[str, float]:
        """All numbers of the state: integrals, drifts, Courant numbers, errors, the user's own.

        Raises RunFailed where a diagnostic of the user's own fails.
        """
        snapshot = self.snapshot
        if self._numbers is None:
            self._numbers = self._evaluator(snapshot)
        return self._numbers | self._own_now()[0]

    @property
    def own_fields(self) -> Fields:
        """Fields (N,) that diagnostics of the user's own make of the state."""
        return self._own_now()[1]

    def _own_now(self) -> tuple[dict[str, float], Fields]:
        _ = self.snapshot  # a new one forgets what the last one came to
        if self._own_found is None or self._own_registered != DIAGNOSTICS:
            self._own_found, self._own_registered = ({}, {}), dict(DIAGNOSTICS)
            try:  # those that ask for the whole state find none of these in it
                self._own_found = self._own(self)
            except BaseException:
                self._own_found = None
                raise
        return self._own_found

    def reference_errors(self) -> dict[str, float]:
        """Errors of the state against the reference of the configuration, if it has one."""
        return {} if self._reference is None else self._reference(self.model, self.snapshot)

    def counts(self) -> dict[str, float]:
        """Counters and seconds of the run, with those before a restart."""
        counts: dict[str, float] = {
            name: n - self._before.get(name, 0) for name, n in self.model.counters.items()
        }
        counts |= self.stepper.costs() | {"wall_seconds": self.wall_seconds}
        return {name: n + self._carried.get(name, 0) for name, n in counts.items()}

    def method(self) -> dict[str, object]:
        """How it is stepped, and on what: for summaries and files."""
        return {
            "title": self.scene.title,
            "stepper": self.config.stepper,
            "scheme": self.stepper.name,
            "dt": self.plan.dt,
            "steps_at_once": self.plan.cycle,
            "dt_rule": self.dt_rule,
            "stable_dt": self.stable_dt,
            "device": self.model.device,
            "launch": self.model.shape,
        }

    def own_attributes(self) -> dict[str, dict[str, str]]:
        """Attributes of the variables that diagnostics of the user's own make, in files."""
        numbers, fields = self._own_now()
        return {name: DIAGNOSTICS[name].attributes for name in (*numbers, *fields)}

    def __repr__(self) -> str:
        where = f"day {self.time / DAY:.4g}" if self._stepper is not None else "not begun"
        return (
            f"Simulation({self.scene.name!r}, ne={self.mesh.ne}, np={self.mesh.np},"
            f" stepper={self.config.stepper!r}: {where} of {self.days:g} days)"
        )
