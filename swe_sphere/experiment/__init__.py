"""A whole run with all that goes with it: diagnostics, errors, files, restart, summary."""

from swe_sphere.experiment.prepare import Prepared
from swe_sphere.experiment.run import run
from swe_sphere.experiment.summary import Summary, failed_summary
from swe_sphere.experiment.watcher import Watcher

__all__ = ["Prepared", "Summary", "Watcher", "failed_summary", "run"]
