"""What numbers are made of: fingerprints of code and files, and restarts that look at them."""

import ast
from importlib.machinery import ModuleSpec
from pathlib import Path

import pytest
from imports import sources

from swe_sphere.errors import ConfigError
from swe_sphere.files import fingerprints
from swe_sphere.simulation.config import make_config
from swe_sphere.simulation.restart import run_sources
from swe_sphere.simulation.simulation import run_scene
from swe_sphere.testcases import get_scene

# --- fingerprints of sources


PACKAGES = ("studies.sweep", "studies.report")


def test_code_is_told_apart_by_the_contents_of_its_modules(tmp_path, monkeypatch):
    """Of those that make numbers; and it is the same as long as these are."""
    places = {name: tmp_path / name for name in (*fingerprints.NUMBERS, "studies.report")}
    places[""] = tmp_path / "swe_sphere"
    modules = [name for name in places if name.count(".") and name not in PACKAGES]
    for name, place in places.items():
        (place if name in modules else place / "a.py").parent.mkdir(exist_ok=True)
        (place if name in modules else place / "a.py").write_text("x = 1\n")

    def find(name):
        name = name.removeprefix("swe_sphere").removeprefix(".")
        found = ModuleSpec(name, None, origin=str(places[name]))
        found.submodule_search_locations = None if name in modules else [str(places[name])]
        return found

    monkeypatch.setattr(fingerprints, "find_spec", find)
    compute = fingerprints.code_fingerprint.__wrapped__
    first = compute()
    assert compute() == first != compute("studies.report")
    (places["studies.report"] / "a.py").write_text("x = 2\n")
    assert compute() == first
    found = {first}
    for name, place in places.items():
        if name != "studies.report":
            (place if name in modules else place / "b.py").write_text(f"x = {len(found)} + 1\n")
            found.add(compute())
    assert len(found) == 2 + len(fingerprints.NUMBERS)


def _without_docstrings(source):
    """The syntax tree as text, every expression that is a lone string left out."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        for field in ("body", "orelse", "finalbody"):
            statements = getattr(node, field, None)
            if isinstance(statements, list):
                kept = [each for each in statements if not _is_text(each)]
                setattr(node, field, kept)
    return ast.dump(tree)


def _is_text(node):
    lone = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    return lone and isinstance(node.value.value, str)


@pytest.mark.thorough
def test_comments_and_docstrings_are_no_code():
    """Of every module of the package the parser finds the same code with and without them."""
    for path in sources().values():
        text = path.read_text()
        code = fingerprints.code_of(text)
        assert _without_docstrings(code) == _without_docstrings(text), path
        documented = [
            node
            for node in ast.walk(ast.parse(code))
            if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef))
            and ast.get_docstring(node)
        ]
        assert not documented, path


def test_editing_a_comment_does_not_discard_runs():
    source = 'def f(x):\n    """Double it."""\n    return 2.0 * x  # exact\n'
    same = '# new\n\ndef f(x):\n    """Return 2x.\n\n    Exact.\n    """\n\n    return 2.0 * x\n'
    other = source.replace("2.0", "3.0")
    marks = 'name = "a # b"\ntext = """\n# define\n"""\n'
    assert fingerprints.code_of(source) == fingerprints.code_of(same)
    assert fingerprints.code_of(source) != fingerprints.code_of(other)
    assert "a # b" in fingerprints.code_of(marks) and "# define" in fingerprints.code_of(marks)


def test_the_code_of_the_package_is_found():
    """Kernels and scenes too, which lie beside it in a source tree, and nothing else there."""
    for name in ("", *fingerprints.NUMBERS):
        found = fingerprints._sources(name)
        assert found
        assert not {"conftest.py", "pyproject.toml"} & {path.name for path in found}


def test_files_of_a_scene_are_the_chain_of_its_bases_and_its_data(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "low").mkdir()
    (tmp_path / "top.toml").write_text('base = "low/middle.toml"')
    (tmp_path / "low" / "middle.toml").write_text('base = "flow.py"')
    (tmp_path / "low" / "flow.py").write_text(
        "from dataclasses import replace\n"
        "from swe_sphere.testcases import get_scene\n"
        "def scene():\n"
        "    return replace(get_scene('lauter'), parameters={'file': 'winds.nc', 'word': 'calm'})\n"
    )
    (tmp_path / "winds.nc").write_bytes(b"winds")
    scene = get_scene("top.toml")
    config = make_config({"scene": "top.toml"})
    before = run_sources(config, scene)
    assert [*before] == ["the scene's file", "low/middle.toml", "low/flow.py", "winds.nc"]
    for name, file in zip(before, ("top.toml", *[*before][1:]), strict=True):
        text = Path(file).read_bytes()
        Path(file).write_bytes(text + b" ")
        now = run_sources(config, scene)
        assert [other for other in before if now[other] != before[other]] == [name]
        Path(file).write_bytes(text)
    assert run_sources(make_config({"scene": "lauter"}), get_scene("lauter")) == {}


# --- restarts

SMALL = {"ne": 2, "np": 4, "dt": 3600.0}


@pytest.fixture
def part(tmp_path, monkeypatch):
    """A folder with the first half of a run of flow.toml, which builds on base.toml."""
    monkeypatch.chdir(tmp_path)
    Path("flow.toml").write_text('base = "base.toml"\n')
    Path("base.toml").write_text('base = "williamson6"\ndays = 1\n')
    run_scene(make_config({"scene": "flow.toml", "days": 0.25, "out": "part.nc", **SMALL}))
    return make_config({"scene": "flow.toml", "days": 0.5, "restart": "part.nc"})


@pytest.mark.parametrize(
    ("file", "name"), [("flow.toml", "the scene's file"), ("base.toml", "base.toml")]
)
def test_a_restart_of_an_edited_scene_is_refused(part, file, name):
    """Also where the edit cannot be seen in the names, parameters and effects of the scene."""
    assert run_scene(part)["days"] == 0.5
    Path(file).write_text(Path(file).read_text() + "# now all is different\n")
    with pytest.raises(ConfigError, match=f"^{name} has been edited since part.nc was begun"):
        run_scene(part)


def test_a_scene_may_be_moved_between_the_parts_of_a_run(part):
    Path("new").mkdir()
    for file in ("flow.toml", "base.toml"):
        Path(file).rename(Path("new") / file)
    moved = part.model_copy(update={"scene": "new/flow.toml"})
    assert run_scene(moved)["days"] == 0.5


def test_a_restart_with_other_code_is_told(part, monkeypatch):
    same, other = [], []
    run_scene(part, warn=same.append)
    monkeypatch.setattr("swe_sphere.simulation.simulation.code_fingerprint", lambda: "other")
    assert run_scene(part, warn=other.append)["days"] == 0.5
    assert same == []
    assert len(other) == 1 and "part.nc was written by other code" in other[0]
