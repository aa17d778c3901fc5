"""What loop, files and diagnostics need to know of a simulation: all but how it is set up."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

from swe_sphere.equations.scene import Scene
from swe_sphere.mesh import Mesh
from swe_sphere.simulation.config import RunConfig
from swe_sphere.simulation.snapshot import Fields, Snapshot
from swe_sphere.simulation.time_plan import TimePlan

if TYPE_CHECKING:
    from swe_sphere.equations.model import Model
    from swe_sphere.steppers import Stepper

__all__ = ["Running"]


class Running(Protocol):
    """A simulation on its way; see `Simulation`."""

    config: RunConfig
    scene: Scene
    mesh: Mesh
    model: Model
    options: dict[str, Any]
    warnings: tuple[str, ...]
    dt_rule: str
    wall_seconds: float
    cpu_seconds: float

    @property
    def days(self) -> float: ...
    @property
    def stepper(self) -> Stepper: ...
    @property
    def plan(self) -> TimePlan: ...
    @property
    def steps(self) -> int: ...
    @property
    def time(self) -> float: ...
    @property
    def stable_dt(self) -> float: ...
    @property
    def identity(self) -> dict[str, object]: ...
    @property
    def initial(self) -> Snapshot: ...
    @property
    def snapshot(self) -> Snapshot: ...
    @property
    def diagnostics(self) -> dict[str, float]: ...
    @property
    def own_fields(self) -> Fields: ...
    def own_attributes(self) -> dict[str, dict[str, str]]: ...
    def reference_errors(self) -> dict[str, float]: ...
    def forget(self) -> None: ...
    def counts(self) -> dict[str, float]: ...
