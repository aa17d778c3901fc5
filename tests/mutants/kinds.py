"""How to plant a single fault, a swap in the running program or an edit of a source file.

Who is asked to notice it: cases of the quick verification, or tests.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any
from unittest import mock

from swe_sphere.studies.cases import choose, run_cases

ROOT = Path(__file__).parents[2]
SOURCES = ("swe_sphere", "kernels", "testcases", "tests")


@dataclass(frozen=True)
class Mutant:
    """A fault, and the cases (quick levels) or tests that are asked to notice it, in order."""

    name: str
    where: str
    """Of a swap "module:attribute[.attribute]"; of an edit the file, from the root."""
    cases: tuple[str, ...]


@dataclass(frozen=True)
class Swap(Mutant):
    """Something put in the place of an attribute of a module."""

    change: Callable[[Any], Any]
    """From what is there to what is put there."""

    @contextmanager
    def planted(self) -> Iterator[None]:
        """The fault is in the program in here."""
        module, path = self.where.split(":")
        *owners, name = path.split(".")
        owner: Any = import_module(module)
        for part in owners:
            owner = getattr(owner, part)
        with mock.patch.object(owner, name, self.change(getattr(owner, name))):
            yield

    def caught(self) -> str | None:
        """The first row that fails, and in what; None for a survivor."""
        cases = choose("verification", self.cases, quick=True)
        with self.planted():
            for row in run_cases(cases):
                if failed := [check.quantity for check in row.checks if not check.holds]:
                    return f"{row.case.name}: {', '.join(failed)}"
        return None


@dataclass(frozen=True)
class Edit(Mutant):
    """A piece of text that is replaced in a copy of the sources."""

    old: str
    new: str

    def anchored(self) -> bool:
        """Whether the text stands in the file, once."""
        return (ROOT / self.where).read_text(encoding="utf-8").count(self.old) == 1

    def caught(self, copy: Path) -> str | None:
        """The first check that fails in a copy of the sources; None for a survivor."""
        file = copy / self.where
        text = file.read_text(encoding="utf-8")
        file.write_text(text.replace(self.old, self.new), encoding="utf-8")
        try:
            return self.verdict(copy)
        finally:
            file.write_text(text, encoding="utf-8")

    def verdict(self, copy: Path) -> str | None:
        """What those that are asked object to in a copy of the sources."""
        return verdict_of(copy, self.cases)


@dataclass(frozen=True)
class Tested(Edit):
    """An edit that the verification cannot notice: its runs have fixed steps and tight solves.

    `cases` are files of tests, or single ones (file.py::test).
    """

    def verdict(self, copy: Path) -> str | None:
        """The first test that fails."""
        return verdict_of_tests(copy, self.cases)


def tested(kind: str, *edits: tuple[str, str, tuple[str, ...], str, str]) -> tuple[Tested, ...]:
    """Return edits of a kind, given as (name, where, tests, old, new)."""
    return tuple(Tested(f"{kind}: {name}", *rest) for name, *rest in edits)


def copy_sources(to: Path) -> Path:
    """A copy of the package, with its tests, that Python started in it finds before any other."""
    skip = shutil.ignore_patterns("__pycache__", "*.egg-info")
    for name in SOURCES:
        shutil.copytree(ROOT / name, to / name, ignore=skip)
    shutil.copy(ROOT / "pyproject.toml", to)
    return to


def verdict_of(copy: Path, cases: tuple[str, ...]) -> str | None:
    """What the quick verification of a copy of the sources objects to."""
    for name in cases:
        done = _python(copy, "swe_sphere", "verify", "--quick", "--json", "--scenes", name)
        if not done.stdout.startswith("{"):
            return f"{name}: {done.stderr.strip().splitlines()[-1]}"
        for row in json.loads(done.stdout)["rows"]:
            if failed := [c["quantity"] for c in row["checks"] if not c["passed"]]:
                return f"{row['case']}: {', '.join(failed)}"
    return None


def verdict_of_tests(copy: Path, tests: tuple[str, ...]) -> str | None:
    """The first test that fails in a copy of the sources."""
    files = [str(Path("tests", test)) for test in tests]
    done = _python(copy, "pytest", "-q", "-x", "-m", "", "-p", "no:cacheprovider", *files)
    if done.returncode == 0:
        return None
    if failed := re.search(r"^FAILED tests/(\S+)", done.stdout, re.MULTILINE):
        return failed[1]
    raise RuntimeError(f"the tests did not run: {done.stdout}{done.stderr}")


def _python(copy: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    # a module edited within a second keeps its time stamp, so that a cached one would be taken
    environment = os.environ | {"PYTHONDONTWRITEBYTECODE": "1"}
    command = [sys.executable, "-m", *arguments]
    return subprocess.run(command, cwd=copy, env=environment, capture_output=True, text=True)
