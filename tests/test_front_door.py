"""What `import swe_sphere` offers: everything a notebook needs, found lazily, with examples."""

import doctest
import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

import swe_sphere

WITH_EXAMPLES = {
    "Mesh", "Output", "Scene", "Simulation", "diagnostic", "every", "list_scenes", "list_steppers",
    "open_run", "sweep", "verify",
}  # fmt: skip
TO_DERIVE_FROM = {
    "DiagonallyImplicit", "Effect", "ImexRungeKutta", "Observer", "PointwiseEffect",
    "Preconditioner", "RungeKutta", "Stepper",
}  # fmt: skip
PARTS = {
    "ConfigError", "DYNAMICS", "EARTH", "MASSES", "Orography", "Planet", "Rotation", "Tracers",
    "get_scene", "get_stepper",
}  # fmt: skip
NAMES = WITH_EXAMPLES | TO_DERIVE_FROM | PARTS
EXAMPLES = (
    *(f"swe_sphere:{name}" for name in sorted(WITH_EXAMPLES)),
    "swe_sphere.analysis.accessor:Analysis",
)


def test_the_names_are_those_and_no_others():
    assert set(dir(swe_sphere)) == NAMES and swe_sphere.__version__
    assert all(getattr(swe_sphere, name).__doc__ for name in NAMES)
    with pytest.raises(AttributeError, match="attribute Simulacrum"):
        _ = swe_sphere.Simulacrum


def test_what_has_no_docstring_is_listed_too():
    class Undocumented(swe_sphere.RungeKutta):
        name, order, a, b = "undocumented", 1, (), (1.0,)

    assert swe_sphere.list_steppers()["undocumented"] == ""


def test_import_loads_nothing_heavy():
    code = (
        "import sys, swe_sphere; dir(swe_sphere);"
        "print(*{'warp', 'numpy', 'xarray', 'matplotlib', 'scipy', 'netCDF4'} & set(sys.modules))"
    )
    assert subprocess.check_output([sys.executable, "-c", code], text=True).split() == []


@pytest.mark.parametrize("place", EXAMPLES)
def test_every_docstring_has_an_example_that_holds(place, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    module, _, name = place.partition(":")
    thing = getattr(import_module(module), name)
    parser = doctest.DocTestParser()
    examples = parser.get_doctest(thing.__doc__ or "", {}, place, None, None)
    assert examples.examples, f"{place} has no example"
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE)
    assert runner.run(examples).failed == 0


PAGE = (Path(__file__).parents[1] / "docs/reference/api.md").read_text()
BLOCKS = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)


def test_the_examples_of_the_page_run(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    exec("\n".join(BLOCKS), {})
    first, *_, last = capsys.readouterr().out.splitlines()
    assert first.startswith("completed ") and "must be a positive number" in last


def test_every_name_is_on_the_page_and_in_an_example():
    """Examples are those of docstrings, of the reference and of the page on extensions."""
    extending = (Path(__file__).parents[1] / "docs/howto/extending.md").read_text()
    examples = "\n".join([*BLOCKS, *re.findall(r"```python\n(.*?)```", extending, re.DOTALL)])
    for name in NAMES:
        assert f"swe_sphere.{name}\n" in PAGE or name == "ConfigError", name
        assert name in WITH_EXAMPLES or re.search(rf"\b{name}\b", examples), name
