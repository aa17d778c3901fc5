"""The catalogue of scenes: formula, source, parameters, effects, errors and picture of each."""

import inspect
import re
import textwrap
import tomllib
from pathlib import Path

import swe_sphere.studies.cases
from swe_sphere.testcases import SCENES, get_scene

GALLERY = Path(__file__).parent / "reference" / "gallery"
COMMANDS = tomllib.loads((GALLERY / "commands.toml").read_text())
CASES = Path(swe_sphere.studies.cases.__file__).with_name("verification")


def write_scene_sections(file):
    """Write a section for each scene; an unchanged file stays."""
    cases = _cases()
    sections = [_section(name, factory, cases.get(name, [])) for name, factory in SCENES.items()]
    text = "\n\n".join(sections) + "\n"
    if not file.exists() or file.read_text() != text:
        file.parent.mkdir(exist_ok=True)
        file.write_text(text)


def _section(name, factory, cases):
    scene = get_scene(name)
    described, arguments = _described(factory)
    effects = ", ".join(f"`{effect.name}`" for effect in scene.effects)
    length = f"{scene.days:g} day" + ("s" if scene.days != 1.0 else "")
    parts = [
        f"### {name}",
        _picture(name),
        described,
        f"* **Source**: {scene.reference}.\n"
        f"* **Effects**: {effects}; nothing else is compiled.\n"
        f"* **Recommended**: ne{scene.ne} np{scene.np}, {length}, the defaults of\n\n"
        f"      swe-sphere run {name}",
        _drawing(name),
        _parameters(factory, arguments),
        _expected(cases),
    ]
    return "\n\n".join(part for part in parts if part)


def _picture(name):
    return f"![{name}](gallery/{name}.png)" if (GALLERY / f"{name}.png").exists() else ""


def _drawing(name):
    """Return the commands that draw the picture of a scene."""
    if name not in COMMANDS:
        return ""
    arguments, look = COMMANDS[name]["run"], COMMANDS[name].get("plot", "")
    plot = " ".join(filter(None, (f"swe-sphere plot {name}.nc", look, "--no-panel")))
    run = f"swe-sphere run {name} {arguments} --out {name}.nc"
    return f"The picture is made by\n\n    {run}\n    {plot}"


def _described(factory):
    """Return the docstring without its section of arguments, and the arguments by name."""
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
    return "\n".join(("| `--set scene.NAME=VALUE` | default | meaning |\n|---|---|---|", *rows))


def _cases():
    """Return the cases of `swe-sphere verify` by scene."""
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
            "<details><summary>Errors that a correct model does not exceed</summary>\n",
            "The table shows relative norms l1 / l2 / linf: bounds of `swe-sphere verify`, a little"
            " above the measured errors ([Verification](../results/verification.md)).\n",
            "| run | h | v |\n|---|---|---|",
            *rows,
            "\n</details>",
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
