"""The results of stability cases on disk, and the page that is made of them."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from swe_sphere.errors import ConfigError
from swe_sphere.files.durable import write_whole
from swe_sphere.studies.cases.families import all_cases
from swe_sphere.studies.cases.measure import Measure
from swe_sphere.studies.cases.page import stability_page
from swe_sphere.studies.cases.rows import Row
from swe_sphere.studies.record_store import Record, Store, read_record


class Results(Record):
    """Contents of FILE.json: measures of all cases of one form, by name of the case."""

    quick: bool
    results: dict[str, Measure]

    def rows(self) -> list[Row]:
        """Return the rows of the cases that still exist."""
        known = [case for case in all_cases("stability") if case.name in self.results]
        forms = [case.quick_form() if self.quick else case for case in known]
        return [Row(c, c.levels[0], self.results[c.name]) for c in forms if c.levels]


class StabilityStore(Store[Measure]):
    """FILE.md and FILE.json, and a folder FILE.runs of measures that are not yet in FILE.json.

    Measures of cases that are not run again stay.  Raises ConfigError where the files cannot be
    written, or hold results of the other form.
    """

    def __init__(self, page: Path, quick: bool) -> None:
        if page.suffix != ".md":
            raise ConfigError(f"out: {page} must end in .md")
        if not page.parent.is_dir():
            raise ConfigError(f"out: there is no folder {page.parent}: make it first")
        self._page, self._numbers, self._quick = page, page.with_suffix(".json"), quick
        super().__init__(page.with_suffix(".runs"), Measure)
        if self._numbers.exists():
            earlier = read_record(self._numbers, Results)
            if earlier.quick != quick:
                form = "full" if quick else "quick"
                raise ConfigError(f"out: {self._numbers} is of the {form} form: take another name")
            self.records = [*earlier.results.values(), *self.records]

    def add(self, record: Measure) -> Measure:
        """Store a measure and write the page; RunFailed if the disk refuses."""
        record = super().add(record)
        self._write_page()
        return record

    @contextmanager
    def unfinished(self) -> Iterator[None]:
        """Hold the folder, and write page and numbers at the end; RunFailed if the disk refuses."""
        with super().unfinished():
            yield
            rows = self._write_page()
            results = {r.case.name: r.as_result() | {"reason": r.measure.reason} for r in rows}
            told = {"quick": self._quick, "results": results}
            write_whole(self._numbers, json.dumps(told, indent=1, ensure_ascii=False) + "\n")

    def _write_page(self) -> list[Row]:
        results = {found.name: found for found in self.records}
        rows = Results(quick=self._quick, results=results).rows()
        write_whole(self._page, stability_page(rows, self._quick))
        return rows
