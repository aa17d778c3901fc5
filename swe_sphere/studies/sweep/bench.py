"""A mesh in one precision with all that runs on it share, so that none of them makes it anew."""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from swe_sphere.equations.scene import Scene
from swe_sphere.fingerprints import code_fingerprint
from swe_sphere.io.integrals import integrals
from swe_sphere.mesh import Mesh
from swe_sphere.simulation.config import RunConfig
from swe_sphere.simulation.setup import identity, make_mesh, make_model, make_scene
from swe_sphere.simulation.stepping import stepper_options
from swe_sphere.simulation.warp_start import start_warp

if TYPE_CHECKING:
    from swe_sphere.equations.model import Model
    from swe_sphere.steppers import Stepper

__all__ = ["FIELDS", "Bench", "Fields", "Limits"]

Fields = dict[str, NDArray[np.float64]]

FIELDS = ("u", "v", "h", "vorticity")
"""What is kept of a state to take errors of it."""

BATCH = 0.01
"""Time of one batch of right-hand sides [s]."""


@dataclass(frozen=True)
class Limits:
    """Steps [s] that the start of a scene allows on a mesh."""

    gravity: float
    """Leapfrog's without filter: 1 over the spectral radius."""
    advective: float
    """The same, were there no gravity waves."""


class Bench:
    """A scene on a mesh: start, limits, fresh models, and the cost of a right-hand side.

    config: of any run on it; its stepper does not matter.  Raises ConfigError as the parts do.
    """

    def __init__(self, config: RunConfig) -> None:
        self.config = config
        self.scene: Scene = make_scene(config)
        self.mesh: Mesh = make_mesh(config, self.scene)
        self._radii: dict[object, tuple[float, float]] = {}
        self._batch: tuple[Model, Any, Any, int] | None = None

    @property
    def label(self) -> str:
        """The mesh and the precision in words."""
        return f"ne{self.mesh.ne} np{self.mesh.np} {self.config.precision}"

    @cached_property
    def token(self) -> dict[str, object]:
        """All that makes the runs on this bench differ from others: settings, files and code."""
        device, launch = self.config.device, self.config.launch
        same = identity(self.config, self.scene, self.mesh) | {"device": device, "launch": launch}
        same.pop("stepper")
        return same | {"code": code_fingerprint()}

    def model(self) -> Model:
        """A model of its own for each run: nothing of one run is left to the next."""
        return make_model(self.config, self.scene, self.mesh)

    @cached_property
    def start(self) -> Fields:
        """All fields at the start, each (N,)."""
        model = self.model()
        state = model.initial_state()
        derived = {
            "vorticity": model.vorticity(state),
            "divergence": model.divergence(state),
            "b": model.bottom,
            "f": model.coriolis,
        }
        return model.fields(state) | derived

    @cached_property
    def integrals(self) -> dict[str, float]:
        """Global integrals at the start."""
        return self.integrals_of(self.start)

    def integrals_of(self, fields: Fields) -> dict[str, float]:
        """Global integrals of a state."""
        moving = {name: fields[name] for name in ("u", "v", "h", "vorticity", "divergence")}
        start = self.start
        return integrals(self.mesh, self.scene.planet, b=start["b"], f=start["f"], **moving)

    @cached_property
    def limits(self) -> Limits:
        """The gravity and the advective limit at the start."""
        model = self.model()
        radius = model.spectrum(model.initial_state()).wave
        gravity = 1.0 / radius if radius > 0.0 else np.inf
        wind, wave = self.integrals["max_wind"], self.integrals["max_wave"]
        if self.scene.effect("pressure-gradient") is None:
            return Limits(gravity, gravity)
        return Limits(gravity, gravity * (wind + wave) / wind if wind > 0.0 else np.inf)

    def stable_dt(self, kind: type[Stepper]) -> float:
        """Largest stable step [s] of a stepper at the start, about; infinite if there is none."""
        how = kind.spectrum.__func__  # type: ignore[attr-defined]
        if how not in self._radii:
            model = self.model()
            spectrum = kind.spectrum(model, model.initial_state())
            self._radii[how] = (spectrum.wave, spectrum.dissipation)
        return kind.stable_dt(*self._radii[how])

    def options(self, config: RunConfig) -> dict[str, Any]:
        """What the stepper of a run is built with."""
        start_warp()
        from swe_sphere.steppers import get_stepper

        return stepper_options(get_stepper(config.stepper), config)

    def time_rhs(self) -> float:
        """Time of one right-hand side [s], the mean over a short batch."""
        if self._batch is None:
            model = self.model()
            state, out = model.initial_state(), model.zeros()
            model.tendency(state, 0.0, out)
            self._batch = (model, state, out, 1)
            once = min(self.time_rhs() for _ in range(3))
            self._batch = (model, state, out, max(3, round(BATCH / once)))
        model, state, out, count = self._batch
        began = time.perf_counter()
        for _ in range(count):
            model.tendency(state, 0.0, out)
        _synchronize(model.device)
        return (time.perf_counter() - began) / count


def _synchronize(device: str) -> None:
    import warp as wp

    wp.synchronize_device(device)
