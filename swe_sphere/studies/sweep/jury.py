"""All truths of a sweep, each made when it is first asked for."""

from __future__ import annotations

from functools import cached_property

from swe_sphere.studies.sweep.bench import Bench
from swe_sphere.studies.sweep.benches import Benches
from swe_sphere.studies.sweep.case import Case
from swe_sphere.studies.sweep.execute import Outcome
from swe_sphere.studies.sweep.judge import Exact, FinerRun, References, SameMesh, SlowFlow, Truth
from swe_sphere.studies.sweep.plan import SweepPlan
from swe_sphere.studies.sweep.record import Verdict
from swe_sphere.studies.sweep.standards import Standards
from swe_sphere.studies.sweep.truths import SHEDDING, TotalTruth

__all__ = ["Jury"]


class Jury:
    """Takes the errors of runs: in time, in total, and of the slow flow where that is asked for."""

    def __init__(
        self, plan: SweepPlan, benches: Benches, total: TotalTruth, standards: Standards
    ) -> None:
        self._plan, self._benches, self._standards = plan, benches, standards
        self._total = total
        scene = benches.first.scene
        self.slow = (scene.name in SHEDDING) if plan.slow is None else plan.slow
        self._same_mesh: dict[int, dict[str, Truth]] = {}

    @property
    def names(self) -> tuple[str, ...]:
        """What errors are taken against: part of the identity of a run that is judged."""
        plan = self._plan
        time = f"{plan.converged_stepper} at {plan.converged_part:g} of its limit"
        return (time, self._total.name, *(["slow flow"] if self.slow else []))

    def __call__(self, case: Case, outcome: Outcome) -> Verdict:
        """Errors of all kinds at the report days that the run reached."""
        truths = self.same_mesh(case.bench) | self.total_truths
        return _verdict(truths, case, outcome)

    def total(self, case: Case, outcome: Outcome) -> Verdict:
        """The total errors alone."""
        return _verdict(self.total_truths, case, outcome)

    def same_mesh(self, bench: Bench) -> dict[str, Truth]:
        """The truths that are runs on the mesh of the bench, in float64, by the kind of error."""
        exact = self._benches.in_float64(bench)
        if id(exact) not in self._same_mesh:
            self._same_mesh[id(exact)] = self._made(exact)
        return self._same_mesh[id(exact)]

    def _made(self, bench: Bench) -> dict[str, Truth]:
        plan = self._plan
        history = self._standards.converged(
            bench, plan.converged_stepper, plan.converged_part, self.total
        )
        if history is None:
            return {}
        truths: dict[str, Truth] = {"time": SameMesh(history)}
        return truths | ({"slow": SlowFlow(history)} if self.slow else {})

    @cached_property
    def total_truths(self) -> dict[str, Truth]:
        """The truth of the total error, if there is one."""
        if self._total.kind == "exact":
            return {"total": Exact()}
        if self._total.kind == "reference":
            return {"total": References(self._total.files)}
        if self._total.kind == "finer":
            bench = self._benches.at(self._total.finer, self._benches.largest_np, "float64")
            history = self._standards.finer(bench)
            return {} if history is None else {"total": FinerRun(bench.mesh, history)}
        return {}


def _verdict(truths: dict[str, Truth], case: Case, outcome: Outcome) -> Verdict:
    return {
        kind: {
            day: truth.errors(case.bench, day, fields) for day, fields in outcome.snapshots.items()
        }
        for kind, truth in truths.items()
    }
