"""Fingerprints of results: short hashes of code, processor and library versions."""

import hashlib
import json
import platform
import re
from functools import cache
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from swe_sphere import __version__
from swe_sphere.files.durable import contents_of

NUMBERS = (
    "kernels", "testcases", "mesh", "operators", "equations", "solvers", "steppers", "simulation",
    "files", "io", "ranks", "settings", "studies.sweep", "studies.jobs", "studies.record_store",
    "analysis.regrid", "analysis.accessor",
)  # fmt: skip
"""Packages and modules that compute the numbers; reports and the command line only show them.

Any change of their code counts, except in comments, docstrings and blank lines of Python.
"""
TEXT = re.compile(r"""
    ^(?P<indent>[ \t]*)r?"{3}(?P<docstring>[\s\S]*?)"{3}$
    | "{3}[\s\S]*?"{3} | '{3}[\s\S]*?'{3} | "(?:\\.|[^"\\\n])*" | '(?:\\.|[^'\\\n])*'
    | (?P<comment>[ \t]*\#[^\n]*)
""", re.MULTILINE | re.VERBOSE)  # fmt: skip
"""Strings and comments of formatted sources, where a docstring begins and ends a line."""
SCENE_FILE = "the scene's file"
"""Key of the file of the scene among the sources of a run."""
LIBRARIES = ("warp-lang", "numpy", "scipy")
"""Libraries whose versions affect the numbers."""


def fingerprint(values: object) -> str:
    """Return a short name for plain values: equal values have equal names in any process."""
    return hashlib.sha256(json.dumps(values, sort_keys=True, default=str).encode()).hexdigest()[:16]


def file_fingerprint(path: Path) -> str:
    """Return a short name for the contents of a file; OSError if it cannot be read."""
    return hashlib.sha256(contents_of(path)).hexdigest()[:16]


@cache
def code_fingerprint(*more: str) -> str:
    """Return a short name for the code that computes the numbers, as it is at the first call.

    It covers the code of `NUMBERS` and of the modules directly in swe_sphere, and the versions of
    `LIBRARIES`. more: further packages of swe_sphere to include.
    """
    digest = hashlib.sha256(repr([version(name) for name in LIBRARIES]).encode())
    for name in ("", *NUMBERS, *more):
        for path in _sources(name):
            text = path.read_text(encoding="utf-8")
            contents = (code_of(text) if path.suffix == ".py" else text).encode()
            digest.update(f"{name} {path.stem} {len(contents)} ".encode() + contents)
    return digest.hexdigest()[:16]


def _sources(name: str) -> list[Path]:
    """Return the files of a package or module of swe_sphere, which may lie outside its folder.

    They are Python, C++ of kernels, and tables of methods, scenes and settings, but no recipes.
    """
    spec = find_spec(f"swe_sphere.{name}".rstrip("."))
    assert spec is not None
    if spec.submodule_search_locations is None:
        return [Path(str(spec.origin))]
    found = Path(spec.submodule_search_locations[0]).glob("**/*" if name else "*")
    kinds = ".py", ".cpp", ".toml"
    return sorted(p for p in found if p.suffix in kinds and p.parent.name != "recipes")


def code_of(source: str) -> str:
    """Return a Python source without its comments, docstrings and blank lines.

    Parsing would be exact for any source but takes half a second for the package. The expression
    handles sources as the formatter writes them; a test compares it with the parser.
    """
    return "\n".join(line for line in TEXT.sub(_without_text, source).splitlines() if line.strip())


def _without_text(found: re.Match[str]) -> str:
    if found["docstring"] is not None:
        return f'{found["indent"]}""'
    return "" if found["comment"] else found[0]


def processor(device: str = "cpu") -> str:
    """Return the name of the processor, or that of a GPU."""
    if device != "cpu":
        import warp as wp

        return str(wp.get_device(device).name)
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text().splitlines() if cpuinfo.exists() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def versions() -> dict[str, str]:
    """Return the versions of Python, Warp, NumPy and this package."""
    return {
        "python": platform.python_version(), "warp": version("warp-lang"), "numpy": np.__version__,
        "swe_sphere": __version__,
    }  # fmt: skip
