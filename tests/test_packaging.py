"""What is installed is what is there."""

import ast
import importlib
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import yaml
from imports import circles, import_graph, imports, reaches_inside, sources

import swe_sphere

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())


def test_every_package_is_listed():
    listed = set(PROJECT["tool"]["setuptools"]["packages"])
    inside = {path.parent for path in (ROOT / "swe_sphere").rglob("__init__.py")}
    found = {".".join(path.relative_to(ROOT).parts) for path in inside}
    beside = {"swe_sphere.kernels", "swe_sphere.kernels.simd", "swe_sphere.testcases"}
    assert listed == found | beside


def test_files_of_data_are_installed_with_their_packages():
    """Tables of studies, recipes, templates, references."""
    patterns = PROJECT["tool"]["setuptools"]["package-data"]
    listed = {
        path
        for package, globs in patterns.items()
        for glob in globs
        for path in (ROOT / package.replace(".", "/")).glob(glob)
    }
    files = {path for path in (ROOT / "swe_sphere").rglob("*") if path.is_file()}
    there = {path for path in files if path.suffix not in (".py", ".pyc")}
    assert there == {path for path in listed if path.is_file()} != set()


def test_only_the_name_of_the_distribution_is_offered_to_pip():
    """`swe-sphere` is the name of another project on the package index."""
    kept = subprocess.check_output(["git", "ls-files"], text=True, cwd=ROOT).split()
    texts = {name: (ROOT / name).read_text("utf-8", "ignore") for name in kept}
    offers = {
        (name, found)
        for name, text in texts.items()
        for found in re.findall(r"([\w-]*swe[-_]sphere)\[(?:mpi|films|analysis|docs|tools)", text)
    }
    assert {found for _, found in offers} == {PROJECT["project"]["name"]}, offers


def test_the_conda_recipe_requires_what_the_project_requires():
    text = (ROOT / "conda" / "meta.yaml").read_text()
    recipe = yaml.safe_load(text.replace("{{ PYTHON }}", "python"))
    names = {"netCDF4": "netcdf4", "matplotlib": "matplotlib-base"}
    split = [
        re.fullmatch(r"([\w-]+)(.*)", one).groups() for one in PROJECT["project"]["dependencies"]
    ]
    needed = [f"{names.get(name, name)} {bound}" for name, bound in split]
    python = f"python {PROJECT['project']['requires-python']}"
    assert recipe["requirements"]["run"] == [python, *needed]
    assert recipe["package"] == {key: PROJECT["project"][key] for key in ("name", "version")}
    assert recipe["about"]["summary"] == PROJECT["project"]["description"]


def test_the_stub_has_the_names_of_the_package():
    stub = ast.parse((ROOT / "swe_sphere" / "__init__.pyi").read_text())
    imported = {
        alias.name: f"swe_sphere.{node.module}"
        for node in stub.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    (exported,) = (
        ast.literal_eval(node.value) for node in stub.body if isinstance(node, ast.Assign)
    )
    assert sorted(exported) == sorted(imported) == sorted(swe_sphere.__all__) == dir(swe_sphere)
    for name, module in imported.items():
        assert getattr(swe_sphere, name) is getattr(importlib.import_module(module), name)


def test_python_started_in_the_source_tree_finds_all_of_the_package():
    code = (
        "import swe_sphere.kernels as k, swe_sphere.testcases as t; print(k.__file__, t.__file__)"
    )
    found = subprocess.check_output([sys.executable, "-c", code], text=True, cwd=ROOT).split()
    assert found == [str(ROOT / name / "__init__.py") for name in ("kernels", "testcases")]


LAYERS = (
    "kernels", "mesh", "operators", "equations", "testcases", "solvers", "steppers", "io",
    "pictures", "analysis", "simulation", "studies", "cli",
)  # fmt: skip
"""Packages from the ground up; what lies in no package is below all of them."""
FRONT = ("swe_sphere", "swe_sphere.__main__")
"""Import what they are asked for, from anywhere."""


def layer(module: str) -> int:
    package = [*module.split("."), ""][1]
    return LAYERS.index(package) if package in LAYERS else -1


def test_imports_go_only_downwards():
    """Also those within functions and for types alone."""
    upwards = [
        f"{module} imports {other}"
        for module, others in import_graph().items()
        for other in others
        if module not in FRONT and layer(other) > layer(module)
    ]
    assert not upwards


def test_no_module_imports_itself_by_way_of_others():
    graph = import_graph() | {"swe_sphere": set()}
    assert [sorted(circle) for circle in circles(graph)] == []


def test_a_circle_is_found():
    graph = {"a": {"b"}, "b": {"c"}, "c": {"b"}, "d": {"a"}}
    assert circles(graph) == [{"b", "c"}]
    text = "def f():\n    from a import b\nif TYPE_CHECKING:\n    from a.c import D\nimport e"
    assert imports(text, dict.fromkeys(("a", "a.b", "a.c", "e"))) == {"a.b", "a.c", "e"}


def test_nothing_reaches_into_the_private_parts_of_another_class():
    found = {name: reaches_inside(path.read_text()) for name, path in sources().items()}
    assert {name: places for name, places in found.items() if places} == {}


def test_who_reaches_inside_is_found():
    text = """
class A:
    def __init__(self, other):
        self._a, other._a, other._b = 1, 2, 3
        other.__dict__
    @classmethod
    def f(cls):
        cls._c, super()._d
def g(a):
    return a.b._a
"""
    assert sorted(reaches_inside(text)) == ["a.b._a", "other._b"]
