"""Results on disk, written after every trial: a page, and beside it the numbers it is made of."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from swe_sphere.errors import ConfigError
from swe_sphere.stress.page import page
from swe_sphere.stress.result import Result

__all__ = ["Store"]


class Store:
    """FILE.md and FILE.json; results of trials that are not run again stay.

    Raises:
        ConfigError: the place cannot be written to, or holds results of the other form.
    """

    def __init__(self, path: Path, quick: bool) -> None:
        if path.suffix != ".md":
            raise ConfigError(f"out: {path} must end in .md")
        if not path.parent.is_dir():
            raise ConfigError(f"out: there is no folder {path.parent}: make it first")
        self._page, self._numbers, self._quick = path, path.with_suffix(".json"), quick
        self._results = self._read()

    def has(self, name: str, fingerprint: str) -> bool:
        """Whether there is a result of just that trial."""
        return self._results.get(name, {}).get("fingerprint") == fingerprint

    def add(self, result: Result) -> None:
        """Keep the result, and write both files."""
        self._results[result.name] = result.as_dict()
        whole = {"quick": self._quick, "results": self._results}
        _replace(self._numbers, json.dumps(whole, indent=1, ensure_ascii=False) + "\n")
        self.write_page()

    def write_page(self) -> None:
        """Write the page of all results."""
        _replace(self._page, page(self._results, self._quick))

    def _read(self) -> dict[str, Mapping[str, Any]]:
        if not self._numbers.exists():
            return {}
        try:
            whole = json.loads(self._numbers.read_text(encoding="utf-8"))
            quick, results = whole["quick"], dict(whole["results"])
        except (OSError, ValueError, KeyError, TypeError):
            raise ConfigError(
                f"out: {self._numbers} holds no results of trials: take another name"
            ) from None
        if quick != self._quick:
            form = "quick" if quick else "full"
            raise ConfigError(f"out: {self._numbers} is of the {form} form: take another name")
        return results


def _replace(path: Path, text: str) -> None:
    """Write the whole file or leave the old one."""
    beside = path.with_name(path.name + ".part")
    beside.write_text(text, encoding="utf-8")
    os.replace(beside, path)  # noqa: PTH105
