"""Which module of the package imports which, read from the sources."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator, Mapping
from pathlib import Path

ROOT = Path(__file__).parents[1]
FOLDERS = {
    "swe_sphere": ROOT / "swe_sphere",
    "swe_sphere.kernels": ROOT / "kernels",
    "swe_sphere.testcases": ROOT / "testcases",
}

PRIVATE = re.compile("_(?!_)")

Graph = Mapping[str, set[str]]


def sources() -> dict[str, Path]:
    """Files of all modules by name."""
    found = {}
    for package, folder in FOLDERS.items():
        for path in sorted(folder.rglob("*.py")):
            parts = path.relative_to(folder).with_suffix("").parts
            found[".".join((package, *parts)).removesuffix(".__init__")] = path
    return found


def imports(text: str, modules: Mapping[str, object]) -> set[str]:
    """The modules that a source imports: anywhere, in functions and for types too."""
    found = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        if isinstance(node, ast.ImportFrom) and node.module:
            names = [f"{node.module}.{alias.name}" for alias in node.names]
            found |= {name if name in modules else node.module for name in names}
    return found & modules.keys()


def import_graph() -> dict[str, set[str]]:
    """The imports of each module."""
    files = sources()
    return {name: imports(path.read_text(), files) for name, path in files.items()}


def circles(graph: Graph) -> list[set[str]]:
    """Sets of modules that import each other, directly or by way of others."""
    above = {name: set(_reached(graph, name)) for name in graph}
    found: list[set[str]] = []
    for name in graph:
        circle = {other for other in above[name] if name in above[other]}
        if circle and circle not in found:
            found.append(circle)
    return found


def _reached(graph: Graph, name: str) -> Iterator[str]:
    """All that the module imports, directly or by way of others."""
    seen: set[str] = set()
    left = [*graph[name]]
    while left:
        module = left.pop()
        if module not in seen:
            seen.add(module)
            yield module
            left += graph[module]


def reaches_inside(text: str) -> list[str]:
    """Where a source takes a private attribute of what is neither itself nor of its own class."""
    tree, found = ast.parse(text), []
    classes = [node for node in ast.walk(tree) if isinstance(node, ast.ClassDef)]
    own: dict[ast.AST, set[str]] = {}
    for cls in classes:
        own |= dict.fromkeys(ast.walk(cls), _private_names(cls))
    for node in ast.walk(tree):
        if not isinstance(node, ast.Attribute) or not PRIVATE.match(node.attr):
            continue
        if ast.unparse(node.value) not in ("self", "cls", "super()"):
            found += [] if node.attr in own.get(node, ()) else [ast.unparse(node)]
    return found


def _private_names(cls: ast.ClassDef) -> set[str]:
    """What the class defines, and sets of itself."""
    nodes = [*ast.walk(cls)]
    methods = {node.name for node in nodes if isinstance(node, ast.FunctionDef)}
    return methods | {
        node.attr
        for node in nodes
        if isinstance(node, ast.Attribute) and ast.unparse(node.value) == "self"
    }
