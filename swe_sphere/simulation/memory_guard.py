"""What a run will take of the machine's memory, told before it takes any.

The numbers are bytes by what allocates them, counted in the code and, for the work room of the
libraries, measured (docs/memory.md); a test holds their sum against runs.
"""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from swe_sphere.errors import ConfigError
from swe_sphere.simulation.config import RunConfig

if TYPE_CHECKING:
    from swe_sphere.equations.scene import Scene

GROUPS = Path("/sys/fs/cgroup")

PROGRAM = 2.5e8
"""Interpreter, libraries and compiled kernels."""
SPECTRUM = 25
"""Vectors of wind and depth, in float64, while the stability limit is found."""
KRYLOV = 14
"""Vectors of an ordinary Krylov basis, preconditioned ones included."""
EXPONENTIAL_KRYLOV = 50
"""Vectors of one at an automatic step."""


class _Size:
    """The counts that bytes go with."""

    def __init__(self, config: RunConfig, scene: Scene, ne: int, np: int) -> None:
        self.np = np
        self.element = 6.0 * (ne * np) ** 2
        """Element nodes."""
        self.unique = 6.0 * (ne * (np - 1)) ** 2 + 2.0
        """Nodes counted once."""
        self.real = 8 if config.precision == "float64" else 4
        self.tracers = len(scene.tracers or ())
        self.fluid = 3 if scene.wind is None else 1

    @property
    def vector(self) -> float:
        """Bytes of a state."""
        return self.real * (self.fluid + self.tracers) * self.unique


def needed_memory(config: RunConfig, scene: Scene, ne: int, np: int) -> float:
    """Most memory [bytes] that a run on a CPU holds, to about a third, the program included.

    A Krylov basis that grows beyond the ordinary takes more: see docs/memory.md.
    """
    from swe_sphere.solvers.preconditioners import PRECONDITIONERS
    from swe_sphere.solvers.preconditioners.preconditioner import elimination_memory
    from swe_sphere.steppers import get_stepper

    kind, size = get_stepper(config.stepper), _Size(config, scene, ne, np)
    stepping = kind.vectors * size.vector + _sampling(size)
    preconditioner = PRECONDITIONERS.find(config.preconditioner or "helmholtz")
    if kind.family == "imex":
        stepping += elimination_memory(ne, np, 8) + preconditioner.memory_estimate(ne, np)
    elif kind.family == "exponential":
        stepping += EXPONENTIAL_KRYLOV * size.vector
    elif kind.family == "implicit":
        one = KRYLOV * size.vector
        one += preconditioner.memory_estimate(ne, np) if scene.wind is None else 0.0
        stepping += kind.coupled_stages * one
    spectrum = SPECTRUM * 8 * size.fluid * size.unique
    return PROGRAM + _model(size, scene) + max(spectrum, stepping)


def _model(size: _Size, scene: Scene) -> float:
    """The mesh, its copy in the order of the kernels, local tendencies, fields of the scene."""
    has = {effect.name for effect in scene.effects}
    parts = 1 + 2 * any(effect.dissipation for effect in scene.effects)
    parts += 2 * ("hyperviscosity" in has)
    apart = 6 * any(effect.diffuses for effect in scene.effects)  # vectors of its stages
    mesh = 48 * size.element + 100 * size.unique
    ordered = (4 + 5 * size.real) * size.element + (16 + size.real) * size.unique
    local = size.fluid * size.real * (parts * size.element + apart * size.unique)
    tracers = size.tracers * size.real * (2 * size.element + 3 * size.unique)
    return mesh + ordered + local + tracers + 60 * size.unique


def _sampling(size: _Size) -> float:
    """Vorticity, divergence and the integrals."""
    return 60 * size.element + 100 * size.unique


def check_memory(config: RunConfig, scene: Scene, ne: int, np: int) -> None:
    """Refuse what would otherwise be killed by the system without a word.

    Raises:
        ConfigError: the run needs more memory than there is.
    """
    needed, there = needed_memory(config, scene, ne, np), available_memory()
    if there is not None and needed > there:
        raise ConfigError(
            f"ne={ne} with np={np} and {config.stepper} needs about {needed / 2**30:.3g} GiB of"
            f" memory, and {there / 2**30:.3g} GiB are free: take a smaller ne"
        )


def available_memory() -> float | None:
    """Memory [bytes] that this process may still take; None where nothing tells."""
    known = [left for left in (_machine(), _group()) if left is not None]
    return min(known, default=None)


def _machine() -> float | None:
    """What the machine has to give without swapping, or else what is installed."""
    with suppress(OSError, StopIteration):
        lines = Path("/proc/meminfo").read_text().splitlines()
        return 1024.0 * float(next(ln for ln in lines if ln.startswith("MemAvailable:")).split()[1])
    with suppress(AttributeError, ValueError, OSError):
        return float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    return None


def _group() -> float | None:
    """What the limits of a container or a batch system leave, pages of files not counted."""
    with suppress(OSError):
        lines = Path("/proc/self/cgroup").read_text().splitlines()
        left = [_left(*place) for line in lines for place in _places(*line.split(":", 2)[1:])]
        return min((known for known in left if known is not None), default=None)
    return None


def _places(controllers: str, path: str) -> list[tuple[Path, str, str]]:
    """Folders of a control group and those above it, with the names of limit and usage there."""
    if controllers == "":  # the second version of Linux control groups
        base, limit, usage = GROUPS, "memory.max", "memory.current"
    elif "memory" in controllers.split(","):
        base, limit, usage = GROUPS / "memory", "memory.limit_in_bytes", "memory.usage_in_bytes"
    else:
        return []
    inside = Path(path.lstrip("/"))
    return [(base / part, limit, usage) for part in (inside, *inside.parents)]


def _left(folder: Path, limit: str, usage: str) -> float | None:
    with suppress(OSError, ValueError):
        largest, used = (float((folder / name).read_text()) for name in (limit, usage))
        lines = (folder / "memory.stat").read_text().splitlines()
        cached = dict(line.split() for line in lines)
        return largest - used + float(cached.get("inactive_file", 0))
    return None
