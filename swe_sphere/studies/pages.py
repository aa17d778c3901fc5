"""Pages of studies, in Markdown or HTML, from templates that lie in their packages."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from swe_sphere.errors import ConfigError, in_one_line
from swe_sphere.files.durable import clear_errors

MARK = "<!-- made by swe-sphere sweep -->"
"""In pages of sweeps, which tells them from the user's own of the same name."""


def rendered(package: str, template: str, *filters: Callable[..., object], **values: object) -> str:
    """A template of a study filled in.

    package: of the study.  filters: known to the template by their names.
    """
    from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined

    places = [PackageLoader(of, "templates") for of in (package, __package__)]
    made = Environment(
        loader=ChoiceLoader(places), autoescape=template.endswith(".html.j2"),
        undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True,
    )  # fmt: skip
    made.globals["mark"] = MARK
    made.filters |= {each.__name__.lstrip("_"): each for each in (anchor, in_table, *filters)}
    return made.get_template(template).render(values)


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
