"""Results on disk, written after every trial: a page, and beside it the numbers it is made of."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict

from swe_sphere.durable import write_whole
from swe_sphere.errors import ConfigError
from swe_sphere.studies.stress.page import page
from swe_sphere.studies.stress.result import Result

__all__ = ["Store"]


class _Stored(BaseModel):
    """What there must be of a result."""

    model_config = ConfigDict(strict=True)

    stepper: str
    outcome: str
    reason: str
    numbers: dict[str, float | None]
    fingerprint: str


class _File(BaseModel):
    model_config = ConfigDict(strict=True)

    quick: bool
    results: dict[str, _Stored]


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
        """Keep the result, and write both files; RunFailed if the disk refuses."""
        self._results[result.name] = result.as_dict()
        whole = {"quick": self._quick, "results": self._results}
        write_whole(self._numbers, json.dumps(whole, indent=1, ensure_ascii=False) + "\n")
        self.write_page()

    def write_page(self) -> None:
        """Write the page of all results; RunFailed if the disk refuses."""
        write_whole(self._page, page(self._results, self._quick))

    def _read(self) -> dict[str, Mapping[str, Any]]:
        if not self._numbers.exists():
            return {}
        try:
            whole = json.loads(self._numbers.read_text(encoding="utf-8"))
            _File.model_validate(whole)
        except OSError as error:
            raise ConfigError(f"out: cannot read {self._numbers}: {error.strerror}") from None
        except (ValueError, RecursionError):
            raise ConfigError(
                f"out: {self._numbers} holds no results of trials: take another name"
            ) from None
        if whole["quick"] != self._quick:
            form = "quick" if whole["quick"] else "full"
            raise ConfigError(f"out: {self._numbers} is of the {form} form: take another name")
        return dict(whole["results"])
