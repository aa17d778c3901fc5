"""The files that a run writes to, where there is one of that name already, or none can be."""

import os
from pathlib import Path

from swe_sphere.errors import ConfigError
from swe_sphere.planet import DAY
from swe_sphere.simulation.config import RunConfig

PICTURES = (".png", ".pdf", ".svg")


def appends(config: RunConfig) -> bool:
    """Whether the run goes on in the file of frames that it restarts from."""
    out, restart = config.out, config.restart
    if out is None or restart is None or config.overwrite or not out.exists():
        return False
    from swe_sphere.io.checkpoint import checkpoint_path

    places = (place for place in (out, checkpoint_path(out)) if place.exists())
    return restart.exists() and any(place.samefile(restart) for place in places)


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
