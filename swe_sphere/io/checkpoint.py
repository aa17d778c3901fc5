"""Checkpoints: the data that resume a run, in a separate file beside that of its frames.

The file is a NumPy archive (.npz: a zip archive, with check sums) of the stepper's arrays and a
header in JSON. Each checkpoint replaces the previous one by a rename, so that a complete
one always exists. The run's `run_id` identifies the file of frames to which it belongs.
"""

import json
import os
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from swe_sphere.errors import ConfigError
from swe_sphere.files.durable import building, translate_errors
from swe_sphere.io.runfile import CheckpointHeader, RunFile

HEADER = "header"
ARRAYS = "arrays"
"""Entry of the header that lists the arrays: the check sums cover each array alone."""
ARRAY = "array:"
"""Prefix of the names of arrays in the file."""


@dataclass(frozen=True)
class Checkpoint:
    """The arrays of a restart, the number of steps of its run, and the attributes of the run."""

    state_dict: dict[str, NDArray[np.generic]]
    steps: int
    attributes: dict[str, Any]
    """Attributes of the file of frames, including its run_id."""


def checkpoint_path(path: Path) -> Path:
    """Return the path of the checkpoint of a file of frames."""
    return Path(f"{path}.restart")


def write_checkpoint(path: Path, checkpoint: Checkpoint) -> None:
    """Replace the file at the path by this checkpoint; an OSError leaves the file unchanged."""
    values = vars(checkpoint) | {ARRAYS: [*checkpoint.state_dict]}
    arrays = {ARRAY + k: array for k, array in values.pop("state_dict").items()}
    arrays[HEADER] = np.array(json.dumps(values, default=lambda numbers: numbers.tolist()))
    with building(path) as part, part.open("wb") as file:
        np.savez(file, **arrays)


def is_checkpoint(path: Path) -> bool:
    """Return whether `write_checkpoint` has written a file."""
    if not (path.is_file() and zipfile.is_zipfile(path)):
        return False
    with zipfile.ZipFile(path) as archive:
        return f"{HEADER}.npy" in archive.namelist()


def read_checkpoint(path: str | os.PathLike[str]) -> Checkpoint:
    """Return the checkpoint of a file of frames, or the one in a separate file.

    Raises ConfigError, in one line, if a file is missing or damaged, or if the checkpoint beside
    the file of frames belongs to another run.
    """
    path = Path(path)
    with translate_errors(f"cannot read {path}"):
        if path.is_file() and zipfile.is_zipfile(path):
            return _read(path)
    run_id, beside = RunFile(path).attributes.get("run_id"), checkpoint_path(path)
    if not beside.exists():
        raise ConfigError(f"{path} has no checkpoint: there is no file {beside} beside it")
    checkpoint = _read(beside)
    if checkpoint.attributes.get("run_id") != run_id:
        raise ConfigError(
            f"{beside} is the checkpoint of another run than {path}: restart from another file,"
            f" or resume that other run (restart={beside})"
        )
    return checkpoint


def _read(path: Path) -> Checkpoint:
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        values = json.loads(arrays.pop(HEADER).item())
        CheckpointHeader.model_validate(values)
        state_dict = {name: arrays[ARRAY + name] for name in values.pop(ARRAYS)}
        return Checkpoint(state_dict, values["steps"], values["attributes"])
    except (OSError, EOFError, ValueError, LookupError, TypeError, AttributeError, SyntaxError,
            RuntimeError, zipfile.BadZipFile, zlib.error) as error:  # fmt: skip
        raise ConfigError(
            f"the checkpoint {path} is damaged, cut short, or not a file of this kind: start"
            " again, or from another file"
        ) from error
