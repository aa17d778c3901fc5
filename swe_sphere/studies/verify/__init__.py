"""Verification: errors, orders and invariants of every scene, each held against a bound."""

from swe_sphere.ranks.parallel import refuse_ranks
from swe_sphere.simulation.interrupt import Interrupted
from swe_sphere.studies.jobs import checked_jobs
from swe_sphere.studies.verify.case import Case, Level, Published, all_cases, choose, families
from swe_sphere.studies.verify.case_page import page
from swe_sphere.studies.verify.measure import Measure
from swe_sphere.studies.verify.verdict import Row, measured_beside, run_cases

__all__ = [
    "Case", "Level", "Measure", "Published", "Row", "all_cases", "choose", "families",
    "measured_beside", "page", "run_cases", "verify",
]  # fmt: skip


def verify(
    *scenes: str, quick: bool = False, launch: str | None = None, jobs: int = 1
) -> list[Row]:
    """Measure errors, orders and invariants of scenes, each held against its bound.

    Args:
        scenes: names of scenes, or of cases; none: all there are.
        quick: only the levels that take less than a second each.
        launch: shape of kernel launches; "node" is that of GPUs.
        jobs: how many processes measure levels beside each other.

    Returns:
        A row for each level: its `quantities`, its `checks`, and whether they all `passed`.

    Examples:
        >>> from swe_sphere import verify
        >>> rows = verify("lake-at-rest", quick=True)
        >>> all(row.passed for row in rows)
        True

    Raises:
        ConfigError: there is no scene or case of that name, or no such shape.
        RunFailed: one of several processes has died.
        KeyboardInterrupt: on Ctrl-C.
    """
    refuse_ranks()
    changes = {"launch": launch} if launch else {}
    cases = [case.changed(changes) for case in choose(scenes)]
    try:
        known = measured_beside(jobs, cases, quick) if checked_jobs(jobs) > 1 else ()
        return list(run_cases(cases, quick, known=known))
    except Interrupted as error:
        raise KeyboardInterrupt(str(error)) from None
