"""The results of stability cases on disk, and the page that is made of them."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from swe_sphere.errors import ConfigError
from swe_sphere.files.durable import write_whole
from swe_sphere.studies.cases.families import cases_of, families
from swe_sphere.studies.cases.measure import Measure
from swe_sphere.studies.cases.page import stability_page
from swe_sphere.studies.cases.verdict import Row
from swe_sphere.studies.record_store import Record, Store, read_record


class Results(Record):
    """What is read of FILE.json: measures of all cases of one form, by name of the case."""

    quick: bool
    results: dict[str, Measure]

    def rows(self) -> list[Row]:
        """Return the rows of the cases that still exist."""
        cases = cases_of(families("stability").values())
        known = [(case, self.results[case.name]) for case in cases if case.name in self.results]
        forms = [(case.quick_form() if self.quick else case, found) for case, found in known]
        return [Row(case, case.levels[0], found) for case, found in forms if case.levels]


class StabilityStore:
    """FILE.md and FILE.json, and a folder FILE.runs of measures that are not yet in FILE.json.

    Measures of cases that are not run again stay.  Raises ConfigError where the files cannot be
    written, or hold results of the other form.
    """

    def __init__(self, path: Path, quick: bool) -> None:
        if path.suffix != ".md":
            raise ConfigError(f"out: {path} must end in .md")
        if not path.parent.is_dir():
            raise ConfigError(f"out: there is no folder {path.parent}: make it first")
        self._page, self._numbers, self._quick = path, path.with_suffix(".json"), quick
        self._measures: dict[str, Measure] = {}
        if self._numbers.exists():
            earlier = read_record(self._numbers, Results)
            if earlier.quick != quick:
                form = "full" if quick else "quick"
                raise ConfigError(f"out: {self._numbers} is of the {form} form: take another name")
            self._measures |= earlier.results
        self._runs = Store(path.with_suffix(".runs"), Measure)
        self._measures |= {found.name: found for found in self._runs.records}

    @property
    def known(self) -> dict[str, Measure]:
        """Measures by fingerprint."""
        return {found.fingerprint: found for found in self._measures.values()}

    def add(self, found: Measure) -> Measure:
        """Store a measure and write the page; RunFailed if the disk refuses."""
        self._measures[found.name] = self._runs.add(found)
        self._write_page()
        return self._measures[found.name]

    @contextmanager
    def unfinished(self) -> Iterator[None]:
        """Hold the files; both are written when the block begins and when it ends.

        Raises:
            RunFailed: the disk refuses.
        """
        with self._runs.unfinished():
            self._write()
            yield
            self._write()

    @property
    def _rows(self) -> list[Row]:
        return Results(quick=self._quick, results=self._measures).rows()

    def _write_page(self) -> None:
        write_whole(self._page, stability_page(self._rows, self._quick))

    def _write(self) -> None:
        self._write_page()
        own = {
            row.case.name: row.as_result() | {"reason": row.measure.reason} for row in self._rows
        }
        text = json.dumps({"quick": self._quick, "results": own}, indent=1, ensure_ascii=False)
        write_whole(self._numbers, text + "\n")
