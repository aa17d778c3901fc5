"""What a sweep says: a headline and a table, an HTML report, a page of Markdown, figures.

Needs nothing but the dataset of a sweep.
"""

from swe_sphere.studies.report.answer import Ranking
from swe_sphere.studies.report.claims import Claim
from swe_sphere.studies.report.content import search_rankings, sweep_rankings
from swe_sphere.studies.report.rows import Metric
from swe_sphere.studies.report.sweep_page import write_markdown, write_report

__all__ = [
    "Claim", "Metric", "Ranking", "search_rankings", "sweep_rankings", "write_markdown",
    "write_report",
]  # fmt: skip
