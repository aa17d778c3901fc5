"""Where numbers come from: a short hash of the code, processor and versions of the machine."""

import hashlib
import json
import os
import platform
import re
from collections.abc import Iterator
from functools import cache
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from swe_sphere import __version__

NUMBERS = (
    "kernels", "testcases", "mesh", "operators", "equations", "solvers", "steppers", "simulation",
    "files", "io", "ranks", "settings", "studies", "studies.sweep",
)  # fmt: skip
"""Packages that make the numbers: all below the reports and the command line, which only show them.

Any change of their code counts. Comments, docstrings and blank lines do not.
"""
STRINGS_AND_COMMENTS = r"""
    ^(?P<indent>[ \t]*)r?"{3}(?P<docstring>[\s\S]*?)"{3}$
    | "{3}[\s\S]*?"{3} | '{3}[\s\S]*?'{3} | "(?:\\.|[^"\\\n])*" | '(?:\\.|[^'\\\n])*'
    | (?P<comment>[ \t]*\#[^\n]*)
"""
"""Regular expression for formatted sources, where a docstring begins and ends a line."""
TEXT = re.compile(STRINGS_AND_COMMENTS, re.MULTILINE | re.VERBOSE)
RUNNING = ("ended", "jobs", "peak_memory", "record_store")
"""Modules directly in `studies` that count: the others there show and explain numbers."""
SCENE_FILE = "the scene's file"
"""What the file that holds the scene is called among the sources of a run."""
LIBRARIES = ("warp-lang", "numpy", "scipy")
"""What else the numbers go through."""


def fingerprint(values: object) -> str:
    """A short name for plain values: equal for equal ones, in any process."""
    return _short(json.dumps(values, sort_keys=True, default=str).encode())


def file_fingerprint(path: Path) -> str:
    """A short name for the contents of a file; OSError if it cannot be read."""
    return _short(path.read_bytes())


@cache
def code_fingerprint(*more: str) -> str:
    """A short name for the code that makes the numbers, as this process found it.

    It is made of the code of all modules in `NUMBERS` and directly in swe_sphere, of `RUNNING`, and
    of the versions of `LIBRARIES`.  more: further packages of swe_sphere that count.
    """
    root = find_spec("swe_sphere")
    assert root is not None
    digest = hashlib.sha256(repr([version(name) for name in LIBRARIES]).encode())
    folders = [("", folder) for folder in root.submodule_search_locations or ()]
    folders += [(name, folder) for name in (*NUMBERS, *more) for folder in _folders(name)]
    for name, folder in folders:
        for path in _modules(name, Path(folder)):
            contents = code_of(path.read_text(encoding="utf-8")).encode()
            place = f"{name}/{path.relative_to(folder).as_posix()} {len(contents)} "
            digest.update(place.encode() + contents)
    return digest.hexdigest()[:16]


def _modules(name: str, folder: Path) -> list[Path]:
    """Return the modules that count of a package in a folder."""
    if name == "studies":
        return [folder / f"{module}.py" for module in RUNNING]
    return sorted(folder.glob("**/*.py" if name else "*.py"))


def code_of(source: str) -> str:
    """Return a Python source without its comments, docstrings and blank lines.

    Parsing would be exact for any source but takes half a second for the package. The expression
    serves sources as the formatter leaves them; a test compares it with the parser.
    """
    stripped = TEXT.sub(_without_text, source)
    return "\n".join(line for line in stripped.splitlines() if line.strip())


def _without_text(found: re.Match[str]) -> str:
    if found["docstring"] is not None:
        return f'{found["indent"]}""'
    return "" if found["comment"] else found[0]


def _folders(name: str) -> Iterator[str]:
    """Where a package of swe_sphere lies, which need not be inside of it."""
    spec = find_spec(f"swe_sphere.{name}")
    yield from (spec and spec.submodule_search_locations) or ()


def _short(contents: bytes) -> str:
    return hashlib.sha256(contents).hexdigest()[:16]


def processor(device: str = "cpu") -> str:
    """The name of the processor, or that of a GPU."""
    if device != "cpu":
        import warp as wp

        return str(wp.get_device(device).name)
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text().splitlines() if cpuinfo.exists() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def versions() -> dict[str, str]:
    """Versions of Python, of this package and of those that do its work."""
    import warp as wp

    return {
        "python": platform.python_version(),
        "warp": str(wp.__version__),
        "numpy": np.__version__,
        "swe_sphere": __version__,
    }


def machine() -> str:
    """Processor, cores, Python and Warp in a line."""
    found = versions()
    return f"{processor()}, {os.cpu_count()} cores; Python {found['python']}, Warp {found['warp']}"
