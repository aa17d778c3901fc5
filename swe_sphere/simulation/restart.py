"""Output file of a run, exact resumption of an earlier run, and identity of a run."""

import json
import math
import os
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from swe_sphere.equations.scene import Scene
from swe_sphere.errors import ConfigError, shown
from swe_sphere.files.fingerprints import SCENE_FILE, file_fingerprint
from swe_sphere.files.user_file import cause, check_trusted, file_contents, is_custom, is_user_file
from swe_sphere.mesh import Mesh
from swe_sphere.planet import DAY
from swe_sphere.settings.values import override
from swe_sphere.simulation.config import RunConfig, make_config
from swe_sphere.simulation.planning import RunPlan
from swe_sphere.testcases.user_scenes import scene_files

if TYPE_CHECKING:
    from swe_sphere.steppers import Trajectory

ENDINGS = (".png", ".pdf", ".svg")

OF_ONE_RUN = {
    "out": "run()", "overwrite": "run()", "plot": "plot()", "restart": "from_checkpoint()",
    "live": "swe-sphere run", "as_json": "swe-sphere run", "quiet": "swe-sphere run",
    "log": "swe-sphere run",
}  # fmt: skip
"""Fields of a configuration that belong to one run, and the method or command that accepts each."""

INHERITED = RunConfig.model_fields.keys() - {
    *OF_ONE_RUN, "scene", "reference", "time_limit", "trust",
}  # fmt: skip
"""Fields of the configuration that a resumed run inherits unless they are given."""


LONGEST_NAME = 247
"""Bytes that the name of a file may have, so that the names of the files beside it fit too."""


def appends(config: RunConfig) -> bool:
    """Return whether the run appends to the file of frames from which it resumes."""
    if (out := config.out) is None or config.overwrite or not out.exists():
        return False
    from swe_sphere.io.checkpoint import checkpoint_path  # scipy.io is slow to import

    return any(_is_same_file(path, config.restart) for path in (out, checkpoint_path(out)))


def lacks_end(config: RunConfig) -> bool:
    """Return whether the file that a run appends to does not state that its run was completed."""
    from swe_sphere.io.runfile import RunFile

    out = config.out
    return out is not None and appends(config) and not RunFile(out).attributes.get("completed")


def _is_same_file(path: Path, other: Path | None) -> bool:
    return other is not None and other.exists() and path.exists() and path.samefile(other)


def check_paths(config: RunConfig, read: Iterable[Path] = ()) -> None:
    """Check, before anything is computed, that the files of a run can be written.

    read: files that the run reads besides those that `config` names.  Raises ConfigError if a file
    to read is missing or would be written to, a path is a folder, has no folder or cannot be
    written to, a picture has an unknown ending, or a file would be replaced without `overwrite`.
    """
    sources = config.initial, config.reference, *config.diagnostics, *config.trust, *read
    for path in (config.restart, config.initial, config.reference, *config.trust):
        if path is not None and not path.exists():
            raise ConfigError(f"there is no file {path}")
    files = [("out", config.out), ("plot", config.plot), ("log", config.log)]
    files += [("output", output.path) for output in config.outputs]
    seen = set[Path]()
    for name, path in files:
        if path is None:
            continue
        from swe_sphere.io.checkpoint import checkpoint_path
        from swe_sphere.io.growing import check_place

        if path.resolve() in seen:
            raise ConfigError(f"{name}: {path} would be written twice: choose another name")
        seen |= {path.resolve(), checkpoint_path(path.resolve())}
        resumed = config.restart, config.restart and checkpoint_path(config.restart)
        known = sources if name == "out" else (*sources, *resumed)
        pair = path, checkpoint_path(path)
        if any(_is_same_file(each, source) for each in pair for source in known):
            raise ConfigError(f"{name}: {path} is a file that the run reads: choose another name")
        if len(path.name.encode()) > LONGEST_NAME:
            raise ConfigError(
                f"{name}: {shown(path.name)} is too long: take at most {LONGEST_NAME} bytes"
            )
        check_place(path, f"{name}: ")
        if not path.parent.is_dir():
            raise ConfigError(f"{name}: there is no folder {path.parent}: make it first")
        target = path if path.exists() else path.parent
        if not os.access(target, os.W_OK):
            raise ConfigError(f"{name}: {target} cannot be written to: choose another place")
    if config.plot is not None and config.plot.suffix.lower() not in ENDINGS:
        raise ConfigError(f"plot: {config.plot} must end in {', '.join(ENDINGS)}")
    if config.plot is not None and config.plot.exists() and not config.overwrite:
        also = "" if config.restart else ", or replace it with --overwrite"
        raise ConfigError(f"plot: {config.plot} exists: choose another name{also}")
    if (out := config.out) is None or config.overwrite or appends(config):
        return
    if out.exists():
        raise ConfigError(f"out: {out} {_contents(out)}, or replace it with --overwrite")
    checkpoint = checkpoint_path(out)
    if checkpoint.exists() and not _is_same_file(checkpoint, config.restart):
        raise ConfigError(
            f"out: {checkpoint} exists already, without its frames: choose another name, or"
            " replace it with --overwrite"
        )


def holds_run(path: Path, run_id: str | None) -> bool:
    """Return whether a file has frames of the run with that identifier."""
    from swe_sphere.io.runfile import RunFile

    with suppress(ConfigError):
        return run_id is not None and RunFile(path).attributes.get("run_id") == run_id
    return False


def _contents(out: Path) -> str:
    """Return what an existing file holds, and what to do about it."""
    from swe_sphere.io.runfile import RunFile

    try:
        run = RunFile(out)
        scene, day = run.attributes["scene"], run.frame_time(None) / DAY
    except (ConfigError, KeyError):
        return "exists and is not a complete file of a run: choose another name"
    if run.attributes.get("completed"):
        return f"holds a finished run of {scene}: choose another name"
    return (
        f"holds a run of {scene} that stopped at day {day:.4g}: resume it"
        f" (--restart {out}), choose another name"
    )


DIAGNOSTICS_PREFIX = "diagnostics of "
"""Beginning of the names of files with diagnostics among the sources of a run."""
COUNTER = "counter_"
"""Beginning of the names of counters among the arrays of a checkpoint."""
LENGTHS = "step_lengths"
"""Name of the array with the lengths of steps so far among the arrays of a checkpoint."""


class Restart:
    """The checkpoint that a run resumes from; ConfigError if it is missing or damaged.

    path: path of the checkpoint, or of the file of frames beside it.
    """

    def __init__(self, path: Path) -> None:
        from swe_sphere.io.checkpoint import read_checkpoint  # scipy.io is slow to import

        self.path, checkpoint = path, read_checkpoint(path)
        self.attributes, self.arrays = checkpoint.attributes, checkpoint.state_dict
        self.steps = checkpoint.steps

    def table(self, name: str = "configuration") -> dict[str, Any]:
        """Return a table among the attributes; ConfigError if there is none."""
        with suppress(KeyError, ValueError, RecursionError):
            values = json.loads(str(self.attributes[name]))
            if isinstance(values, dict):
                return values
        raise ConfigError(f"{self.path} does not state its {name}: it cannot be restarted")

    @property
    def diagnostics(self) -> set[str]:
        """Names of the user-defined diagnostics of the earlier run, as far as they are known."""
        with suppress(ConfigError):
            return {*self.table("user_diagnostics")}
        return set()

    def adopt(self, config: RunConfig) -> RunConfig:
        """Return the configuration, with the values of the earlier run for unset options."""
        kept = {name: value for name, value in self.table().items() if name in INHERITED}
        merged = make_config(override(kept, config.given()) | {"restart": self.path})
        for ours, theirs in (  # each may be a Python file
            (config.given().get("stepper"), merged.stepper),
            (config.chosen_preconditioner, merged.chosen_preconditioner),
        ):
            if ours != theirs:
                check_trusted(theirs, self.path, config.trust)
        if "outputs" not in config.model_fields_set:
            outputs = tuple(replace(each, path=self._beside(each.path)) for each in merged.outputs)
            merged = merged.model_copy(update={"outputs": outputs})
        if "diagnostics" not in config.model_fields_set:
            before = self.table("identity").get("sources")
            for file in merged.diagnostics:
                check_trusted(file, self.path, config.trust, is_code=True)
                file_contents(file, "diagnostic")  # a file that is missing is an error
                label, now = f"{DIAGNOSTICS_PREFIX}{file}", file_fingerprint(file)
                if isinstance(before, dict) and before.get(label, now) != now:
                    raise ConfigError(
                        f"{file} has been edited since {self.path} was begun: give it again"
                        f" (--diagnostics {file})"
                    )
        return merged

    def _beside(self, path: Path) -> Path:
        """Return the path of a further file: that beside the run's file if both were moved."""
        run, ours = self.attributes.get("run_id"), self.path.name.removesuffix(".restart")
        beside = self.path.absolute().with_name(path.name)
        moved = path.name != ours and (path.with_name(ours).exists() or not path.exists())
        return beside if moved and holds_run(beside, run) else path

    def check(self, identity: dict[str, object]) -> None:
        """Raise ConfigError with the first difference between a run and the earlier one."""
        theirs, ours = self.table("identity"), json.loads(json.dumps(identity))
        theirs.setdefault("own_functions", ours["own_functions"])  # older files lack them
        before = theirs.get("sources")
        for name, contents in ours.pop("sources").items():
            if name.startswith(DIAGNOSTICS_PREFIX):
                continue  # the numbers of the run do not depend on it
            if not isinstance(before, dict) or before.get(name) != contents:
                raise ConfigError(
                    f"{name} has been edited since {self.path} was begun: run from the start,"
                    " without restart"
                )
        for name, value in ours.items():
            if theirs.get(name) != value:
                hint = ": give the scene itself, not its name" if name == "own_functions" else ""
                raise ConfigError(
                    f"{self.path} is of another run: {name} is {theirs.get(name)!r} there and"
                    f" {value!r} here{hint}"
                )

    def plan(self, asked: float | str) -> RunPlan:
        """Return the steps so far; ConfigError if steps of another length [s] are requested."""
        dt = float(self.attributes.get("dt", 0.0))
        if asked not in ("auto", dt, self.table().get("dt")) or not dt > 0.0:
            raise ConfigError(
                f"dt={asked} s: a restarted run keeps the step of its file, {dt:g} s; leave dt out"
            )
        cycle = int(self.attributes.get("steps_at_once", 1))
        return RunPlan(dt, self.steps, self.steps, dt, "that of the restart file", cycle)

    def load_into(self, stepper: "Trajectory", before: int) -> None:
        """Load the arrays into a stepper, which then resumes; ConfigError if they do not fit.

        before: number of steps that were taken with other steppers.
        """
        try:
            stepper.load_state_dict(self.arrays, self.steps - before)
            for name, array in self.arrays.items():
                if not np.isfinite(array).all():
                    raise ValueError(f"{name} is not finite")
        except (LookupError, ValueError, TypeError, ArithmeticError, RuntimeError) as error:
            raise ConfigError(
                f"{self.path} is damaged, its arrays do not fit {stepper.name} ({cause(error)})"
            ) from error

    def lengths(self, dt: float) -> list[tuple[int, float, float]]:
        """Return the lengths of steps so far, the present one last.

        An item is the number of earlier steps, their time [s] and the length [s].  dt: the length
        [s] if the file states none, as in older files and before the first step.
        """
        if not self.steps or LENGTHS not in self.arrays:
            return [(0, 0.0, dt)]
        with suppress(TypeError, ValueError, OverflowError):
            rows = [(int(steps), now, dt) for steps, now, dt in self.arrays[LENGTHS].tolist()]
            if rows and all(0 <= n <= self.steps and 0.0 < dt < math.inf for n, _, dt in rows):
                return rows
        raise ConfigError(f"{self.path} is damaged: it lacks the lengths of steps")

    @property
    def counts(self) -> dict[str, float]:
        """Counters and seconds of the earlier run."""
        found = {k: np.asarray(x) for k, x in self.arrays.items() if k.startswith(COUNTER)}
        for name, x in found.items():
            if x.size != 1 or x.dtype.kind not in "iuf" or not np.isfinite(x):
                raise ConfigError(f"{self.path} is damaged, its arrays do not fit: {name}")
        return {name.removeprefix(COUNTER): x.item() for name, x in found.items()}


def read_restart(config: RunConfig) -> Restart | None:
    """Return the checkpoint from which a configuration resumes, if any."""
    if config.restart is None:
        return None
    return Restart(config.out if config.out and appends(config) else config.restart)


def identity(config: RunConfig, scene: Scene, mesh: Mesh) -> dict[str, object]:
    """Return all data that a run must share with another one to resume it."""
    from swe_sphere.steppers import get_stepper

    return {
        "scene": scene.name, "stepper": get_stepper(config.stepper).name, "ne": mesh.ne,
        "np": mesh.np, "stretch": mesh.stretch, "centre": [*mesh.centre], "spin": mesh.spin,
        "precision": config.precision, "tracer_steps": config.tracer_steps, **scene_identity(scene),
        "sources": run_sources(config, scene),
    }  # fmt: skip


def scene_identity(scene: Scene) -> dict[str, object]:
    """Return what `identity` states of the scene."""
    functions = {name: getattr(value, "function", None) for name, value in vars(scene).items()}
    own = ", ".join(name for name, each in functions.items() if each and is_custom(each))
    return {
        "scene": scene.name, "scene_parameters": dict(scene.parameters),
        "effects": {effect.name: asdict(effect) for effect in scene.effects},
        "planet": asdict(scene.planet), "own_functions": own,
    }  # fmt: skip


def run_sources(config: RunConfig, scene: Scene) -> dict[str, str]:
    """Return fingerprints of the files of a run: its scene, data, diagnostics and custom methods.

    Names of files on which a TOML scene builds (`base`) are relative to its own, so that the folder
    may be moved.  Files of data are those whose names are parameters of the scene; other files that
    a Python scene reads are not tracked.  A scene of the package without data adds no file.
    Raises ConfigError if a file has disappeared since it was loaded.
    """
    try:
        files = source_files(config, scene)
        return {label: file_fingerprint(path) for label, path in files.items()}
    except OSError as error:
        raise ConfigError(f"cannot read {error.filename}: {error.strerror}") from None


def source_files(config: RunConfig, scene: Scene) -> dict[str, Path]:
    """Return the files of `run_sources` by label."""
    methods = {"stepper": config.stepper, "preconditioner": config.chosen_preconditioner}
    files = scene_files(config.scene)
    labels = (SCENE_FILE, *(os.path.relpath(path, files[0].parent) for path in files[1:]))
    found = dict(zip(labels, files, strict=False))
    found |= {f"{DIAGNOSTICS_PREFIX}{path}": path for path in config.diagnostics}
    for what, file in methods.items():
        if file and is_user_file(file):
            found[f"the {what}'s file"] = Path(file)
    for value in scene.parameters.values():
        with suppress(OSError, ValueError):  # too long, or with characters that no name has
            if isinstance(value, str) and Path(value).is_file():  # not a word
                found[value] = Path(value)
    return found
