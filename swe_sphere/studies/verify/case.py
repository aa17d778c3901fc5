"""What a verification run is, as data: a scene, a ladder of resolutions, and a bound for each."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from swe_sphere.equations.effects import Effect
from swe_sphere.equations.scene import Scene
from swe_sphere.testcases import get_scene

__all__ = ["Case", "Figure", "Rung", "Setting"]

Norms = tuple[float, float, float]
"""l1, l2 and linf."""

CONVERGED = "converged"
"""In the place of a reference: a run on the same mesh with a step so short that it has no error."""


@dataclass(frozen=True)
class Figure:
    """A published number beside ours."""

    quantity: str
    value: float
    source: str


@dataclass(frozen=True)
class Setting:
    """One run."""

    scene: str | Callable[..., Scene]
    """Name of a scene, or a function that makes one."""
    parameters: Mapping[str, Any] = field(default_factory=dict)
    """Of the scene."""
    effects: tuple[Effect, ...] = ()
    """Added to those of the scene."""
    ne: int = 8
    np: int = 4
    mesh: Mapping[str, Any] = field(default_factory=dict)
    """Further arguments of `build_mesh`: stretch, centre, spin."""
    days: float = 5.0
    """Length of the run [days]; 0 for a look at the initial state."""
    dt: float | None = None
    """Time step [s]; None: the safe one of the stepper."""
    stepper: str = "rk4"
    options: Mapping[str, Any] = field(default_factory=dict)
    """Of the stepper."""
    precision: str = "float64"
    launch: str | None = None
    """Shape of kernel launches, "element" or "node"; None: as the device likes it."""

    def make_scene(self) -> Scene:
        """The scene with its parameters and the added effects."""
        make = self.scene
        scene = (
            get_scene(make, **self.parameters) if isinstance(make, str) else make(**self.parameters)
        )
        for effect in self.effects:
            scene = scene.with_effect(effect)
        return scene


@dataclass(frozen=True)
class Rung:
    """One resolution of a case, and what is asked of it."""

    at: float
    """The ne, np or time step [s] of this rung."""
    h: Norms | None = None
    """Upper bounds of l1, l2, linf of the height."""
    v: Norms | None = None
    """Upper bounds of l1, l2, linf of the wind."""
    limits: Mapping[str, float] = field(default_factory=dict)
    """Upper bounds of other quantities; of a drift, of its size."""
    floors: Mapping[str, float] = field(default_factory=dict)
    """Lower bounds; of an order, where the rung is not the first one run."""
    values: Mapping[str, float] = field(default_factory=dict)
    """Numbers to be met to within `Case.tolerance`."""
    figures: tuple[Figure, ...] = ()
    """Published numbers."""
    quick: bool = False
    """Whether the quick form runs it too."""
    changes: Mapping[str, Any] = field(default_factory=dict)
    """What else differs from the setting of the case."""

    def upper(self) -> dict[str, float]:
        """All upper bounds by quantity."""
        pairs = (("h", self.h), ("v", self.v))
        norms = [
            (f"{norm}_{name}", bound)
            for name, bounds in pairs
            for norm, bound in zip(("l1", "l2", "linf"), bounds or (), strict=False)
        ]
        return dict(norms) | dict(self.limits)


@dataclass(frozen=True)
class Case:
    """A scene run at one or more resolutions."""

    name: str
    title: str
    setting: Setting
    rungs: tuple[Rung, ...]
    along: Literal["ne", "np", "dt"] = "ne"
    """What differs from rung to rung; the observed order is in terms of it."""
    against: str | Setting | None = None
    """What to compare with: a shipped reference "scene_dayD", a setting (a run on a finer mesh), or
    `CONVERGED`; None: the exact solution."""
    tolerance: float = 1e-3
    """Relative, of the `values` of the rungs."""
    mass: float | None = 1e-13
    """Largest relative drift of mass; None where mass is not conserved."""
    note: str = ""

    def at(self, rung: Rung) -> Setting:
        """The setting of a rung."""
        level = rung.at if self.along == "dt" else int(rung.at)
        return replace(self.setting, **{self.along: level, **rung.changes})

    @property
    def scene(self) -> str:
        """Name of the scene."""
        return self.setting.make_scene().name
