"""Results on disk: those of a study that goes on a file each, of one at its end in one file."""

from __future__ import annotations

from pathlib import Path

from swe_sphere.durable import write_whole
from swe_sphere.errors import ConfigError
from swe_sphere.studies import store
from swe_sphere.studies.store import Record, read_record
from swe_sphere.studies.stress.page import page
from swe_sphere.studies.stress.result import Result

__all__ = ["Results", "Store"]


class Results(Record):
    """All results of a form, by name of trial."""

    quick: bool
    results: dict[str, Result]


class Store:
    """FILE.md and FILE.json, and a folder FILE.runs of what is not yet in FILE.json.

    Results of trials that are not run again stay.  Raises ConfigError where the place cannot be
    written to, or holds results of the other form.
    """

    def __init__(self, path: Path, quick: bool) -> None:
        if path.suffix != ".md":
            raise ConfigError(f"out: {path} must end in .md")
        if not path.parent.is_dir():
            raise ConfigError(f"out: there is no folder {path.parent}: make it first")
        self._page, self._numbers, self._quick = path, path.with_suffix(".json"), quick
        self._results: dict[str, Result] = {}
        if self._numbers.exists():
            earlier = read_record(self._numbers, Results)
            if earlier.quick != quick:
                form = "full" if quick else "quick"
                raise ConfigError(f"out: {self._numbers} is of the {form} form: take another name")
            self._results |= earlier.results
        self._runs = store.Store(path.with_suffix(".runs"), Result)
        self._results |= {result.name: result for result in self._runs.records}

    def has(self, name: str, fingerprint: str) -> bool:
        """Whether there is a result of just that trial."""
        found = self._results.get(name)
        return found is not None and found.fingerprint == fingerprint

    def add(self, result: Result) -> None:
        """Keep the result, and write the page; RunFailed if the disk refuses."""
        self._results[result.name] = self._runs.add(result)
        write_whole(self._page, page(self._results, self._quick))

    def write(self) -> None:
        """Write the page and all results into one file; RunFailed if the disk refuses."""
        write_whole(self._page, page(self._results, self._quick))
        results = Results(quick=self._quick, results=self._results)
        write_whole(self._numbers, results.as_text())
        self._runs.clear()
