"""Pages in Markdown, as studies write them: prose from a file, and tables."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from importlib import resources

from swe_sphere.machine import versions

__all__ = ["anchor", "filled", "table"]


def filled(package: str, name: str, **values: object) -> str:
    """The prose of a file of a package, its {fields} filled in; {python} and {warp} by themselves.

    The fields are those of `str.format`.
    """
    text = resources.files(package).joinpath(name).read_text(encoding="utf-8")
    return text.format(**{**versions(), **values})


def table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> Iterator[str]:
    """The lines of a table, with an empty one after it."""
    yield _row(heads)
    yield "|" + "---|" * len(heads)
    yield from map(_row, rows)
    yield ""


def anchor(title: str) -> str:
    """What a link within the page calls the section of that title."""
    return "".join(c for c in title.lower().replace(" ", "-") if c.isalnum() or c == "-")


def _row(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"
