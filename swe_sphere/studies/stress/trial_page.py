"""The page of the stress trials, in Markdown, and the results on disk that it is made of."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from swe_sphere.errors import ConfigError
from swe_sphere.files.durable import write_whole
from swe_sphere.files.fingerprints import versions
from swe_sphere.studies import record_store
from swe_sphere.studies.pages import anchor, rendered
from swe_sphere.studies.record_store import Record, read_record
from swe_sphere.studies.stress.trial import OUTCOMES, Group, Result, Trial, groups

Told = Sequence[tuple[Trial, Result]]


def page(results: Mapping[str, Result], quick: bool) -> str:
    """The page of these results, by name of trial, in the order of the groups."""
    told = [
        (group, [(trial, results[trial.name]) for trial in group.trials if trial.name in results])
        for group in groups().values()
    ]
    shown = [(group, trials) for group, trials in told if trials]
    return rendered(
        "swe_sphere.studies.stress", "page.md.j2", _line, _reasons, **versions(), quick=quick,
        seconds=sum(result.numbers.get("seconds") or 0.0 for result in results.values()),
        outcomes=[*OUTCOMES, "not run"], summary=[_summary(*each) for each in shown], told=shown,
    )  # fmt: skip


def _summary(group: Group, told: Told) -> list[str]:
    """How many trials of a group came to which outcome."""
    counts = Counter(result.outcome for _, result in told)
    left = len(group.trials) - len(told)
    numbers = [*(counts[name] for name in OUTCOMES), left]
    return [f"[{group.title}](#{anchor(group.title)})", *map(str, numbers)]


def _line(told: tuple[Trial, Result]) -> list[str]:
    """A line of the table of a group."""
    trial, result = told
    numbers, outcome = result.numbers, result.outcome
    names = dict.fromkeys([*(bound.quantity for bound in trial.all_bounds), *trial.report])
    texts = [f"{name} {_short(numbers[name], name)}" for name in names if name in numbers]
    if outcome != "passed" and numbers.get("last_day") is not None:
        texts.append(f"last_day {_short(numbers['last_day'])}")
    marked = f"**{outcome}**" if outcome in ("broke", "failed") else outcome
    steps = [_short(numbers[x]) if x in numbers else "" for x in ("dt", "dt_over_gravity")]
    return [trial.name, *steps, marked, ", ".join(texts)]


def _reasons(told: Told) -> list[tuple[str, list[str]]]:
    """Each reason once, with the names of the trials that it is of."""
    reasons: dict[str, list[str]] = {}
    for trial, result in told:
        if result.reason:
            reasons.setdefault(f"{result.outcome}: {result.reason}", []).append(trial.name)
    return [*reasons.items()]


def _short(value: float | None, name: str = "") -> str:
    if value is None:
        return "none" if name == "symmetry_day" else "–"
    if value and not 1e-3 <= abs(value) < 1e5:
        return f"{value:.1e}"
    return f"{value:.4g}"


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
        self._runs = record_store.Store(path.with_suffix(".runs"), Result)
        self._results |= {result.name: result for result in self._runs.records}

    def known(self, name: str, fingerprint: str) -> Result | None:
        """The result of just that trial, if there is one."""
        found = self._results.get(name)
        return found if found is not None and found.fingerprint == fingerprint else None

    def add(self, result: Result) -> None:
        """Keep the result, and write the page; RunFailed if the disk refuses."""
        self._results[result.name] = self._runs.add(result)
        write_whole(self._page, page(self._results, self._quick))

    @contextmanager
    def unfinished(self) -> Iterator[None]:
        """Hold the place; page and numbers are written when the block begins and when it ends.

        Raises:
            RunFailed: the disk refuses.
        """
        with self._runs.unfinished():
            self._write()
            yield
            self._write()

    def _write(self) -> None:
        write_whole(self._page, page(self._results, self._quick))
        results = Results(quick=self._quick, results=self._results)
        write_whole(self._numbers, results.as_text())
