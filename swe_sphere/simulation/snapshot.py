"""The state between two steps, as those who watch a run see it."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

from swe_sphere.arrays import Array

if TYPE_CHECKING:
    import warp as wp

    from swe_sphere.equations.model import Model

Fields = dict[str, Array]


class Snapshot:
    """A state with its fields, each fetched from the device when first asked for."""

    def __init__(self, model: Model, state: wp.array, time: float, steps: int = 0) -> None:
        self._model, self._state = model, state
        self.time = time
        """[s] since the start."""
        self.steps = steps
        """Steps since the start."""

    @cached_property
    def fields(self) -> Fields:
        """u, v [m s-1] and h [m], of tracers hq_NAME [m] and q_NAME, each (N,)."""
        return self._model.fields(self._state, self.time)

    @cached_property
    def all_fields(self) -> Fields:
        """The fields with vorticity and divergence [s-1], each (N,)."""
        from swe_sphere.operators.diagnose import divergence, vorticity  # imports Warp

        mesh, u, v = self._model.mesh, self.fields["u"], self.fields["v"]
        return self.fields | {
            "vorticity": vorticity(mesh, u, v), "divergence": divergence(mesh, u, v),
        }  # fmt: skip

    @cached_property
    def with_constants(self) -> Fields:
        """All fields with bottom b [m] and Coriolis parameter f [s-1], each (N,)."""
        return self.all_fields | {"b": self._model.bottom, "f": self._model.coriolis}
