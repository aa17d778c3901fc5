"""Pages of studies, in Markdown or HTML, from templates that lie in their packages."""

from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from swe_sphere.errors import ConfigError, in_one_line
from swe_sphere.files.durable import contents_of, translate_errors, write_whole
from swe_sphere.studies import words

if TYPE_CHECKING:
    from jinja2 import Environment

MARK = "<!-- made by swe-sphere sweep -->"
"""Mark in pages of sweeps, which distinguishes them from pages of the user."""


def rendered(package: str, template: str, *filters: Callable[..., object], **values: object) -> str:
    """Return a filled-in template of a package; filters: functions for it, by their names."""
    made = _environment(package, template.endswith(".html.j2"))
    made.filters |= {each.__name__.lstrip("_"): each for each in filters}
    return made.get_template(template).render(values)


def prose(name: str, *values: object) -> str:
    """Return the text of a macro of prose.j2, called with these values."""
    sentences = _environment(__package__ or "", False).get_template("prose.j2").module
    return str(getattr(sentences, name)(*values)).strip()


@cache
def _environment(package: str, escape: bool) -> "Environment":
    from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined

    places = [PackageLoader(of, "templates") for of in (package, __package__)]
    made = Environment(
        loader=ChoiceLoader(places), autoescape=escape, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True,
    )  # fmt: skip
    made.globals["mark"] = MARK
    texts = words.number, words.error, words.level, words.seconds, words.step, words.times
    made.filters |= {each.__name__: each for each in (in_table, words.percent, *texts)}
    return made


def check_ours(path: Path, *marks: str, what: str = "is not of a sweep") -> None:
    """Raise ConfigError if a file would be replaced that has none of the marks of its kind.

    marks: by default `MARK`. what: text of the error after the path.
    """
    with translate_errors(f"cannot write to {path}"):
        old = contents_of(path) if path.exists() else None
    if old is not None and not any(mark.encode() in old for mark in marks or (MARK,)):
        raise ConfigError(f"out: {path} {what}, and would be replaced: choose another")


def write_made(out: Path, files: Mapping[str, str]) -> None:
    """Write the pages of sweeps and their figures by name into a folder.

    Raises ConfigError if the folder cannot be created, or a file would be replaced that no sweep
    wrote, and RunFailed if the disk fails; each file remains whole, either old or new.
    """
    with translate_errors(f"cannot write the report to {out}"):
        out.mkdir(parents=True, exist_ok=True)
    made = {out / name: text if MARK in text else f"{text}{MARK}\n" for name, text in files.items()}
    for path in made:
        check_ours(path)
    for path, text in made.items():
        write_whole(path, text)


def in_table(text: str) -> str:
    """Return text that does not end a cell of a Markdown table."""
    return in_one_line(text).replace("|", "\\|")
