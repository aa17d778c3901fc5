"""A page for each scene, made of it: formula, source, parameters, effects, errors, picture."""

import inspect
import re
import textwrap
import tomllib
from pathlib import Path

import swe_sphere.studies.cases
from swe_sphere.testcases import SCENES, get_scene

GALLERY = Path(__file__).parent / "reference" / "gallery"
CASES = Path(swe_sphere.studies.cases.__file__).with_name("verification")
NORMS = ("l1", "l2", "linf")


def write_scene_pages(folder):
    """A page for each built-in scene; those that are there already and say the same stay."""
    folder.mkdir(exist_ok=True)
    cases = _cases()
    for name, factory in SCENES.items():
        page = folder / f"{name}.md"
        text = _page(name, factory, cases.get(name, []))
        if not page.exists() or page.read_text() != text:
            page.write_text(text)


def _page(name, factory, cases):
    scene = get_scene(name)
    described, arguments = _described(factory)
    effects = ", ".join(f"`{effect.name}`" for effect in scene.effects)
    parts = [
        f"# {name}: {scene.title}",
        _picture(name),
        described,
        f"Source: {scene.reference}.",
        f"    swe-sphere run {name}",
        f"* **Effects**: {effects}; nothing else is compiled.\n"
        f"* **Recommended**: ne{scene.ne} np{scene.np}, {scene.days:g} days.",
        _parameters(factory, arguments),
        _expected(cases),
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def _picture(name):
    picture = GALLERY / f"{name}.png"
    return f"![{name}](../gallery/{picture.name})" if picture.exists() else ""


def _described(factory):
    """The docstring without the section of arguments, and that section by name."""
    text, _, rest = inspect.getdoc(factory).partition("\nArgs:\n")
    section = textwrap.dedent(re.split(r"\n(?=\S)", rest, maxsplit=1)[0])
    found = re.findall(r"^(\w+): (.*?)(?=^\w+: |\Z)", section, re.DOTALL | re.MULTILINE)
    return text.strip(), {name: " ".join(words.split()) for name, words in found}


def _parameters(factory, arguments):
    parameters = inspect.signature(factory).parameters.values()
    if not parameters:
        return ""
    rows = [
        f"| `{each.name}` | `{each.default}` | {arguments.get(each.name, '')} |"
        for each in parameters
    ]
    head = "| `--set scene.NAME=VALUE` | default | |\n|---|---|---|"
    return "\n".join(("## Parameters\n", head, *rows))


def _cases():
    """The cases of `swe-sphere verify` by the scene that they run."""
    found = {}
    for path in sorted(CASES.glob("*.toml")):
        for case in tomllib.loads(path.read_text()).get("case", ()):
            found.setdefault(case.get("run", {}).get("scene"), []).append(case)
    return found


def _expected(cases):
    rows = [row for case in cases for row in _rows(case)]
    if not rows:
        return ""
    return "\n".join(
        (
            "## Errors that a correct model does not exceed\n",
            "l1 / l2 / linf, relative; bounds of `swe-sphere verify`, a little above what was"
            " measured: see [Verification](../../results/verification.md).\n",
            "| run | h | v |\n|---|---|---|",
            *rows,
        )
    )


def _rows(case):
    for level in case.get("levels", ()):
        if "h" in level or "v" in level:
            keys = [key for key in ("ne", "np", "dt") if key in level]
            at = ", ".join(f"{key} {level[key]:g}" for key in keys)
            run = ": ".join(filter(None, (case.get("title", case["name"]), at)))
            yield f"| {run} | {_norms(level, 'h')} | {_norms(level, 'v')} |"


def _norms(level, field):
    return " / ".join(f"{value:.1e}" for value in level.get(field, ()))
