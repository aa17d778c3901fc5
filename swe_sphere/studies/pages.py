"""Pages of studies, in Markdown or HTML, from templates that lie in their packages."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from swe_sphere.errors import ConfigError, in_one_line
from swe_sphere.files.durable import clear_errors
from swe_sphere.studies import words

if TYPE_CHECKING:
    from jinja2 import Environment

MARK = "<!-- made by swe-sphere sweep -->"
"""In pages of sweeps, which tells them from the user's own of the same name."""


def rendered(package: str, template: str, *filters: Callable[..., object], **values: object) -> str:
    """A template of a study filled in.

    package: of the study.  filters: known to the template by their names.
    """
    made = _environment(package, template.endswith(".html.j2"))
    made.filters |= {each.__name__.lstrip("_"): each for each in filters}
    return made.get_template(template).render(values)


def prose(name: str, *values: object) -> str:
    """A sentence: the macro of that name in the templates of all studies."""
    sentences = _environment(__package__ or "", False).get_template("prose.j2").module
    return str(getattr(sentences, name)(*values)).strip()


@cache
def _environment(package: str, escape: bool) -> Environment:
    from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined

    places = [PackageLoader(of, "templates") for of in (package, __package__)]
    made = Environment(
        loader=ChoiceLoader(places), autoescape=escape, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True,
    )  # fmt: skip
    made.globals["mark"] = MARK
    made.filters |= {
        each.__name__: each for each in (
            anchor, in_table, words.number, words.error, words.level, words.seconds, words.step,
            words.times, words.percent,
        )
    }  # fmt: skip
    return made


def check_page(path: Path, title: str) -> None:
    """ConfigError where something would be replaced that is no page of that title."""
    with clear_errors(f"cannot write to {path}"):
        if path.exists() and not path.read_bytes().startswith(f"# {title}\n".encode()):
            raise ConfigError(f"out: {path} is no such page, and would be replaced: choose another")


def anchor(title: str) -> str:
    """What a link within the page calls the section of that title."""
    return "".join(c for c in title.lower().replace(" ", "-") if c.isalnum() or c == "-")


def in_table(text: str) -> str:
    """Text that does not end a cell of a Markdown table."""
    return in_one_line(text).replace("|", "\\|")
