"""Outcomes of the runs of a study, and their records in a folder, each complete or absent."""

import os
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Generic, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError

from swe_sphere.errors import ConfigError, Interrupted, SweError, in_one_line
from swe_sphere.files.durable import contents_of, release, take_lock, translate_errors, write_whole
from swe_sphere.settings.values import place_and_complaint
from swe_sphere.simulation.loop import Interruption
from swe_sphere.simulation.observers import Observer
from swe_sphere.simulation.simulation import Simulation
from swe_sphere.simulation.summary import Summary

if TYPE_CHECKING:
    import xarray as xr

STOPPED = ("refused", "unstable", "solver-failed")
"""Outcomes of runs that stop themselves with a reason."""
STATUSES = ("completed", *STOPPED, "timed-out", "failed")
"""All outcomes of a run."""
UNEXPECTED = (ArithmeticError, AssertionError, AttributeError, LookupError, MemoryError, NameError,
              RuntimeError, TypeError, ValueError)  # fmt: skip
"""Unexpected errors: a run that ends with one of them has failed."""


def attempt(work: Callable[[], Summary]) -> Summary:
    """Return the result of `work`; a SweError or one of `UNEXPECTED` becomes an outcome too."""
    try:
        with np.errstate(all="ignore"):
            return work()
    except SweError as error:
        return Summary(error.status, in_one_line(error))
    except UNEXPECTED as error:
        return Summary("failed", f"{type(error).__name__}: {in_one_line(error)}")


def stepped(
    sim: Simulation, observers: Sequence[Observer] = (), time_limit: float | None = None,
    interruption: Interruption | None = None,
) -> Summary:  # fmt: skip
    """Step a simulation to its end or any error; raises Interrupted if the user asked to stop."""
    outcome = attempt(lambda: sim.run_plan(observers, time_limit, interruption))
    if outcome.status == "interrupted":
        raise Interrupted(outcome.reason)
    return Summary(outcome.status, in_one_line(outcome.reason or ""))


class Record(BaseModel):
    """Contents of a JSON file; values are not converted between types, and NaN is null."""

    model_config = ConfigDict(strict=True, frozen=True)

    def as_text(self) -> str:
        """Return the contents of the file."""
        return self.model_dump_json(indent=1) + "\n"


R = TypeVar("R", bound=Record)


class Store(Generic[R]):
    """Records of one form in numbered files, in the order in which they were written.

    A kill at any time leaves all of them complete. Raises ConfigError if a file is damaged. suffix:
    appended to the names of new files if several processes write records.
    """

    def __init__(self, folder: Path, form: type[R], suffix: str = "") -> None:
        self.folder, self._form, self._suffix = folder, form, suffix
        paths = sorted(self._paths())
        self._last = max((int(path.stem.partition("-")[0]) for path in paths), default=0)
        self.records: list[R] = [read_record(path, form) for path in paths]

    def _paths(self) -> list[Path]:
        """Return the files of the records; files of other names are ignored."""
        name = re.compile(r"\d+(-\d+)?\.json")
        return [path for path in self.folder.glob("*.json") if name.fullmatch(path.name)]

    def add(self, record: R) -> R:
        """Write a record to the disk, and return it as it is read; RunFailed if the disk fails."""
        text = record.as_text()
        write_whole(self.folder / f"{self._last + 1:06d}{self._suffix}.json", text)
        self._last += 1
        record = self._form.model_validate_json(text)
        self.records.append(record)
        return record

    @contextmanager
    def unfinished(self) -> Iterator[None]:
        """Lock the folder during a study.

        When the block ends without an error, the folder is removed, as its contents are written
        elsewhere. Raises ConfigError if another process holds it.
        """
        with locked(self.folder):
            try:
                yield
                for path in self._paths():
                    path.unlink()
            finally:
                with suppress(OSError):  # the folder still contains records
                    self.folder.rmdir()


def read_record(path: Path, form: type[R]) -> R:
    """Return the record in a file; ConfigError, in one line, if there is none of that form."""
    try:
        return form.model_validate_json(contents_of(path))
    except OSError as error:
        raise ConfigError(f"cannot read {path}: {error.strerror}") from None
    except ValidationError as error:
        raise ConfigError(
            f"{path} is not a record of this version ({place_and_complaint(error)}): delete it, and"
            " its run is repeated, or choose another folder"
        ) from None


def as_netcdf(dataset: "xr.Dataset") -> bytes:
    """Return the netCDF file of a dataset, built in memory: HDF5 does not survive a full disk."""
    from netCDF4 import Dataset
    from xarray.backends import NetCDF4DataStore

    file = Dataset("memory.nc", "w", memory=0)
    dataset.dump_to_store(NetCDF4DataStore(file))  # type: ignore[no-untyped-call]
    return bytes(file.close())


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Create a folder and lock it within the block; the system releases it when the process ends.

    Reading stays possible. On a file system without locks the function only creates the folder.
    Raises ConfigError if it is in use or cannot be created, RunFailed if the disk fails.
    """
    with translate_errors(f"out: {folder} cannot be created"):
        folder.mkdir(parents=True, exist_ok=True)
        file = os.open(folder, os.O_RDONLY)
    try:
        if not take_lock(file):
            raise ConfigError(
                f"out: another process is using {folder}: wait for its end, or choose another"
                " folder"
            )
        yield
    finally:
        release(file)
