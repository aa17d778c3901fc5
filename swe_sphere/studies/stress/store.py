"""Results on disk, written after every trial: a page, and beside it the numbers it is made of."""

from __future__ import annotations

from pathlib import Path

from swe_sphere.durable import write_whole
from swe_sphere.errors import ConfigError
from swe_sphere.studies.store import Record, read_record
from swe_sphere.studies.stress.page import page
from swe_sphere.studies.stress.result import Result

__all__ = ["Results", "Store"]


class Results(Record):
    """All results of a form, by name of trial."""

    quick: bool
    results: dict[str, Result]


class Store:
    """FILE.md and FILE.json; results of trials that are not run again stay.

    Raises:
        ConfigError: the place cannot be written to, or holds results of the other form.
    """

    def __init__(self, path: Path, quick: bool) -> None:
        if path.suffix != ".md":
            raise ConfigError(f"out: {path} must end in .md")
        if not path.parent.is_dir():
            raise ConfigError(f"out: there is no folder {path.parent}: make it first")
        self._page, self._numbers = path, path.with_suffix(".json")
        self._all = Results(quick=quick, results={})
        if self._numbers.exists():
            self._all = read_record(self._numbers, Results)
        if self._all.quick != quick:
            form = "full" if quick else "quick"
            raise ConfigError(f"out: {self._numbers} is of the {form} form: take another name")

    def has(self, name: str, fingerprint: str) -> bool:
        """Whether there is a result of just that trial."""
        found = self._all.results.get(name)
        return found is not None and found.fingerprint == fingerprint

    def add(self, result: Result) -> None:
        """Keep the result, and write both files; RunFailed if the disk refuses."""
        after = {**self._all.results, result.name: result}
        text = Results(quick=self._all.quick, results=after).as_text()
        write_whole(self._numbers, text)
        self._all = Results.model_validate_json(text)
        self.write_page()

    def write_page(self) -> None:
        """Write the page of all results; RunFailed if the disk refuses."""
        write_whole(self._page, page(self._all.results, self._all.quick))
