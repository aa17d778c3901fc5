"""Results of a sweep: a headline and a table, an HTML report, and a Markdown page of a recipe.

All of these need only the dataset of a sweep.
"""

from swe_sphere.studies.report.page import sweep_rankings, write_report
from swe_sphere.studies.report.ranking import Ranking

__all__ = ["Ranking", "sweep_rankings", "write_report"]
