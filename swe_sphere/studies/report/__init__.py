"""What a sweep says: an HTML report, a page of Markdown, figures and tables.

Needs nothing but the dataset of a sweep.
"""

from swe_sphere.studies.report.markdown import write_markdown
from swe_sphere.studies.report.page import write_report

__all__ = ["write_markdown", "write_report"]
