"""What a sweep says: a headline and a table, an HTML report, a page of Markdown, figures.

Needs nothing but the dataset of a sweep.
"""

from swe_sphere.studies.report.page import (
    search_rankings,
    sweep_rankings,
    write_markdown,
    write_report,
)
from swe_sphere.studies.report.ranking import Ranking
from swe_sphere.studies.report.table import Metric
from swe_sphere.studies.sweep.sweep_plan import Claim

__all__ = [
    "Claim", "Metric", "Ranking", "search_rankings", "sweep_rankings", "write_markdown",
    "write_report",
]  # fmt: skip
