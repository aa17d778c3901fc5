"""Other models, each in a process of its own with its own interpreter, and what they answer."""

from __future__ import annotations

import json
import math
import os
import subprocess
from collections.abc import Mapping, Set
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Self

import numpy as np

from swe_sphere.io.integrals import norms
from swe_sphere.io.reference_solution import SHIPPED, Reference
from swe_sphere.planet import DAY
from swe_sphere.testcases import get_scene
from swe_sphere.testcases.harmonics import GaussGrid, synthesis

HERE = Path(__file__).with_name("peers")
ALONE = {
    "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1",
    "NUMEXPR_NUM_THREADS": "1", "OMPI_MCA_ess_singleton_isolated": "1",
    "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false",
}  # fmt: skip
"""No threads, unless a peer is given several cores; Dedalus without the launcher of its MPI."""


@dataclass(frozen=True)
class Setting:
    """One line of settings.toml: a model at a resolution with a step [s]."""

    scene: str
    days: float
    model: str
    resolution: str
    stepper: str
    dt: float
    precision: str = "float64"

    @property
    def steps(self) -> int:
        """As many of no more than dt [s] as fill the days."""
        return math.ceil(self.days * DAY / self.dt - 1e-9)

    @property
    def step(self) -> float:
        """Length [s] of the steps that fill the days."""
        return self.days * DAY / self.steps

    @property
    def mesh(self) -> tuple[int, int]:
        """Return ne and np of a resolution such as "ne4 np8"."""
        ne, np_ = self.resolution.split()
        return int(ne[2:]), int(np_[2:])


@dataclass
class Measured:
    """What the runs of a setting gave."""

    setting: Setting
    error: float = math.nan
    """l2 of the free surface; NaN where the run blew up."""
    cpu: list[float] = field(default_factory=list)
    wall: list[float] = field(default_factory=list)
    failure: str = ""


class Peer:
    """A model in a process that waits for requests, bound to cores: a thread of OpenMP on each.

    Raises OSError where the interpreter or what the model is made of is not there.
    """

    def __init__(self, model: str, python: str, cores: Set[int], folder: Path) -> None:
        script = HERE / f"with_{model.replace('-', '_')}.py"
        self.model, self.folder, self.log = model, folder, folder / f"{model}.log"
        answers, ending = os.pipe()
        self.process = subprocess.Popen(
            [python, str(script), str(ending)], text=True, stdin=subprocess.PIPE,
            stdout=self.log.open("w"), stderr=subprocess.STDOUT,
            env=os.environ | ALONE | {"OMP_NUM_THREADS": str(len(cores))},
            pass_fds=(ending,), preexec_fn=partial(os.sched_setaffinity, 0, cores),
        )  # fmt: skip
        os.close(ending)
        self.answers = os.fdopen(answers)
        self.version = str(self._reply()["version"])

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.process.stdin.close()
        self.process.wait()

    def _reply(self) -> dict[str, Any]:
        line = self.answers.readline()
        if not line:
            told = self.log.read_text().strip().splitlines()
            raise OSError(told[-1] if told else "ended without a word")
        return json.loads(line)

    def run(self, measured: Measured, compare: bool = True) -> None:
        """Run a setting once more; compare the first run with the reference, if requested."""
        of, out = measured.setting, self.folder / f"{self.model}.npy"
        request = request_for(of, self.folder) | {"out": str(out)}
        self.process.stdin.write(json.dumps(request) + "\n")
        self.process.stdin.flush()
        reply = self._reply()
        measured.failure = reply.get("failed", "")
        if measured.failure:
            return
        measured.cpu.append(reply["cpu"])
        measured.wall.append(reply["wall"])
        if compare and len(measured.cpu) == 1:
            measured.error = surface_error(of, np.load(out))


def request_for(of: Setting, folder: Path) -> dict[str, Any]:
    """What the process of a model is asked for; the fields on its grid are left in the folder."""
    planet = get_scene(of.scene).planet
    request: dict[str, Any] = {
        "scene": of.scene, "stepper": of.stepper, "steps": of.steps, "dt": of.step,
        "radius": planet.radius, "rotation": planet.rotation, "gravity": planet.gravity,
        "precision": of.precision,
    }  # fmt: skip
    fields = folder / f"{of.scene}-{of.resolution}.npz"
    if of.resolution.startswith("T"):
        request["truncation"] = int(of.resolution[1:])
        made = initial_fields(of.scene, request["truncation"])
    else:
        ne, np_ = of.mesh
        request |= {"ne": ne, "np": np_}
        reference = reference_of(of)
        made = {"lat": reference.lat, "lon": reference.lon}
    np.savez(fields, **made)
    return request | {"fields": str(fields)}


def alias_free(truncation: int) -> GaussGrid:
    """The Gaussian grid, of even size, on which products of two fields have no aliases."""
    return GaussGrid(2 * math.ceil((3 * truncation + 1) / 4) - 1)


def initial_fields(scene: str, truncation: int) -> Mapping[str, np.ndarray]:
    """The initial state and the bottom on the alias-free grid of a truncation."""
    known = get_scene(scene)
    lon, lat = alias_free(truncation).points
    bottom = known.bottom(lon, lat) if known.bottom else 0.0 * lat
    state = dict(zip("uvh", known.initial(lon, lat), strict=True))
    fields = {name: np.broadcast_to(x, lon.shape) for name, x in (state | {"b": bottom}).items()}
    return fields | {"lat": lat[:, 0], "lon": lon[0]}


def reference_of(of: Setting) -> Reference:
    """The solution that comes with the package."""
    return Reference(SHIPPED / f"{of.scene}_day{of.days:g}.nc")


def surface_error(of: Setting, surface: np.ndarray) -> float:
    """l2 of a free surface [m] against the reference, at the reference's points.

    surface: at those points, or, from a model with a truncation, on its Gaussian grid, from which
    its harmonics follow exactly.
    """
    reference = reference_of(of)
    if of.resolution.startswith("T"):
        top = int(of.resolution[1:]) + 1
        coefficients = alias_free(top - 1).coefficients(surface)[:top, :top]
        surface = synthesis(coefficients, *reference.points)[0]
    return norms(reference.area, surface.ravel(), reference.values("surface"))["l2"]
