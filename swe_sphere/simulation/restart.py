"""The files of a run: where it writes, and where it goes on from another one, bit for bit."""

from __future__ import annotations

import json
import os
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from swe_sphere.errors import ConfigError
from swe_sphere.files.fingerprints import code_fingerprint
from swe_sphere.planet import DAY
from swe_sphere.simulation.config import RunConfig, make_config

if TYPE_CHECKING:
    from swe_sphere.io.checkpoint import Checkpoint


PICTURES = (".png", ".pdf", ".svg")


def appends(config: RunConfig) -> bool:
    """Whether the run goes on in the file of frames that it restarts from."""
    out = config.out
    if out is None or config.restart is None or config.overwrite or not out.exists():
        return False
    from swe_sphere.io.checkpoint import checkpoint_path

    return any(_is_restart(place, config) for place in (out, checkpoint_path(out)))


def _is_restart(place: Path, config: RunConfig) -> bool:
    """Whether the run goes on from the file at that place."""
    restart = config.restart
    if restart is None or not (restart.exists() and place.exists()):
        return False
    return place.samefile(restart)


def check_paths(config: RunConfig) -> None:
    """Complain of a place that cannot be written to before anything is computed.

    Raises:
        ConfigError: a folder, a place without one, a picture of an unknown kind, or a file that
            would be replaced unasked.
    """
    for name, path in (("out", config.out), ("plot", config.plot)):
        if path is not None:
            _check_path(name, path)
    if config.plot is not None and config.plot.suffix.lower() not in PICTURES:
        raise ConfigError(f"plot: {config.plot} must end in {', '.join(PICTURES)}")
    _check_contents(config)


def _check_path(name: str, path: Path) -> None:
    if path.is_dir() and not _may_be_store(path):
        raise ConfigError(f"{name}: {path} is a folder: give the name of a file in it")
    if not path.parent.is_dir():
        raise ConfigError(f"{name}: there is no folder {path.parent}: make it first")
    target = path if path.exists() else path.parent
    if not os.access(target, os.W_OK):
        raise ConfigError(f"{name}: {target} cannot be written to: choose another place")


def _may_be_store(path: Path) -> bool:
    """Whether a folder is one that a run may replace or go on in."""
    from swe_sphere.io.zarr_store import SUFFIX, is_store

    return path.suffix == SUFFIX and is_store(path)


def _check_contents(config: RunConfig) -> None:
    """ConfigError if the run would replace a file that is there, unasked."""
    out = config.out
    if out is None or config.overwrite or appends(config):
        return
    if out.exists():
        raise ConfigError(f"out: {out} {_contents(config)}, or replace it with --overwrite")
    from swe_sphere.io.checkpoint import checkpoint_path

    checkpoint = checkpoint_path(out)
    if checkpoint.exists() and not _is_restart(checkpoint, config):
        raise ConfigError(
            f"out: {checkpoint} is there already, without its frames: choose another name, or"
            " replace it with --overwrite"
        )


def _contents(config: RunConfig) -> str:
    """What is in the file, and what to do about it."""
    from swe_sphere.io.runfile import RunFile

    assert config.out is not None
    try:
        run = RunFile(config.out)
        scene, day = run.attributes["scene"], run.nearest(None) / DAY
    except (ConfigError, KeyError):
        return "is there already and no whole file of a run: choose another name"
    if run.attributes.get("completed"):
        return f"holds a finished run of {scene}: choose another name"
    return (
        f"holds a run of {scene} that stopped at day {day:.4g}: go on with it"
        f" (--restart {config.out}), choose another name"
    )


INHERITED = frozenset({
    "stepper", "days", "every", "ne", "np", "stretch", "centre_lon", "centre_lat", "spin", "alpha",
    "device", "precision", "launch", "settings", "preconditioner", "tolerance",
    "adaptive", "adaptive_by", "fields", "tracer_steps",
})  # fmt: skip
"""What a restarted run takes from the file unless it is told."""

COUNTER = "counter_"


def read_restart(config: RunConfig) -> Checkpoint:
    """The checkpoint that the run is to go on from; ConfigError if it is missing or damaged."""
    from swe_sphere.io.checkpoint import read_checkpoint

    place = config.out if appends(config) else config.restart
    assert place is not None
    return read_checkpoint(place)


def configured(path: str | Path | None, checkpoint: Checkpoint) -> dict[str, object]:
    """The configuration that the run of a checkpoint had; ConfigError if it does not say it."""
    return _stored(path, checkpoint, "configuration")


def adopt(config: RunConfig, checkpoint: Checkpoint) -> RunConfig:
    """The configuration, with the file's values for what it leaves open.

    Raises:
        ConfigError: the file does not hold the configuration of its run.
    """
    before = configured(config.restart, checkpoint)
    names = INHERITED if checkpoint.steps else INHERITED | {"dt"}
    kept = {name: value for name, value in before.items() if name in names}
    return make_config(kept | config.given())


def check_identity(config: RunConfig, checkpoint: Checkpoint, identity: dict[str, object]) -> None:
    """ConfigError naming the first thing in which the run in the file differs from this one."""
    theirs = _stored(config.restart, checkpoint, "identity")
    plain = json.loads(json.dumps(identity))
    _check_sources(config, theirs.get("sources"), plain.pop("sources"))
    for name, ours in plain.items():
        if theirs.get(name) != ours:
            raise ConfigError(
                f"{config.restart} is of another run: {name} is {theirs.get(name)!r} there and"
                f" {ours!r} here"
            )


def _check_sources(config: RunConfig, theirs: object, ours: dict[str, str]) -> None:
    """ConfigError naming the first file of the user that is not known to be what it was."""
    before = theirs if isinstance(theirs, dict) else {}
    for name, contents in ours.items():
        if before.get(name) != contents:
            raise ConfigError(
                f"{name} is not what it was when {config.restart} was begun: it has been edited;"
                " run from the start, without restart"
            )


def code_warnings(config: RunConfig, checkpoint: Checkpoint | None) -> tuple[str, ...]:
    """What to warn of where the file was written by other code of this program."""
    if checkpoint is None or checkpoint.attributes.get("code") == code_fingerprint():
        return ()
    return (
        f"{config.restart} was written by other code of swe_sphere: the run goes on from it, but"
        " is not bit for bit the one that either code would have made alone",
    )


def check_step(config: RunConfig, checkpoint: Checkpoint) -> float:
    """The step [s] of the run in the file, which has taken some; ConfigError if another one is
    asked for."""
    dt = float(checkpoint.attributes.get("dt", 0.0))
    before = configured(config.restart, checkpoint).get("dt")
    if config.dt not in ("auto", dt, before) or not dt > 0.0:
        raise ConfigError(
            f"dt={config.dt} s: a restarted run goes on with the step of its file, {dt:g} s;"
            " leave dt out"
        )
    return dt


def steps_at_once(checkpoint: Checkpoint) -> int:
    """How many steps the run in the file takes for one of its tracers."""
    return int(checkpoint.attributes.get("steps_at_once", 1))


def carried_counts(checkpoint: Checkpoint) -> dict[str, float]:
    """The counters of the run so far, which are among the checkpoint's arrays."""
    arrays = checkpoint.state_dict
    names = [name for name in arrays if name.startswith(COUNTER)]
    return {name.removeprefix(COUNTER): np.asarray(arrays[name]).item() for name in names}


def _stored(path: str | Path | None, checkpoint: Checkpoint, name: str) -> dict[str, object]:
    with suppress(KeyError, ValueError):
        values = json.loads(str(checkpoint.attributes[name]))
        if isinstance(values, dict):
            return values
    raise ConfigError(f"{path} does not say its {name}: it cannot be restarted")
