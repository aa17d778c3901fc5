"""Cases: runs of scenes with bounds decided beforehand, for `swe-sphere verify` and `stress`."""

from swe_sphere.errors import Interrupted
from swe_sphere.ranks.communicator import refuse_ranks
from swe_sphere.studies.cases.case import Case, choose, groups
from swe_sphere.studies.cases.measure import Measure
from swe_sphere.studies.cases.rows import Row, count_outcomes, measured_beside, page, run_cases
from swe_sphere.studies.jobs import checked_jobs

__all__ = [
    "Case", "Measure", "Row", "choose", "count_outcomes", "groups", "measured_beside", "page",
    "run_cases", "verify",
]  # fmt: skip


def verify(
    *scenes: str, quick: bool = False, launch: str | None = None, jobs: int = 1
) -> list[Row]:
    """Measure errors, orders and invariants of scenes, and compare each with its bound.

    Args:
        scenes: Names of groups, scenes or cases; without any, all cases are run.
        quick: Whether to run only the cases that take less than a second each.
        launch: Shape of kernel launches; "node" is the shape of GPUs; None: as the cases state.
        jobs: Number of processes that measure cases in parallel.

    Returns:
        A row for each case: its `quantities`, its `checks`, and whether it `passed`.

    Examples:
        >>> from swe_sphere import verify
        >>> rows = verify("lake-at-rest", quick=True)
        >>> all(row.passed for row in rows)
        True

    Raises:
        ConfigError: an unknown scene, case or shape, or no case remains in the quick form.
        RunFailed: one of several processes died.
        KeyboardInterrupt: on Ctrl-C.
    """
    refuse_ranks()
    cases = choose("verification", scenes, quick=quick, launch=launch)
    try:
        return list(run_cases(cases, jobs=checked_jobs(jobs)))
    except Interrupted as error:
        raise KeyboardInterrupt(str(error)) from None
