"""Separate tracer steps: one for several steps of the flow that carries the tracers."""

import math
from abc import ABC, abstractmethod
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from swe_sphere.equations.model import Model
from swe_sphere.equations.spectrum import spectral_radius
from swe_sphere.errors import ConfigError, Unstable
from swe_sphere.operators.tracers import CourantRate, MassSteps, TracerTransport
from swe_sphere.ranks.limits import check_stop
from swe_sphere.solvers.vector_space import Masses
from swe_sphere.steppers.split_diffusion import Diffusion
from swe_sphere.steppers.stepper import METHODS, Stepper, Trajectory, is_large

FLOW = "flow_"
"""Prefix of the names of the arrays that the flow's stepper keeps."""
TRACER_PARTS = 2
"""Largest number of parts of a tracer step in the initial wind; stronger winds require more."""
MARGIN = 1.1
"""Factor by which the spectral radius may exceed the value expected from the initial state."""
_REACH = {float(reach): stages for reach, stages in METHODS["TracerStages"].items()}
"""Stages by their reach: the largest stable tau times the spectral radius of A.

They are the f_i in m_i = m_0 + f_i tau A m_(i-1): explicit stages for waves alone, of fourth order,
with nearly the longest stable steps possible; `benchmarks/tracer_stages.py` derives the numbers.
"""
LONGEST = max(_REACH)
MOST_PARTS = 1000
"""Largest number of parts; more mean that the wind has become unstable."""


def stages_for(reach: float) -> tuple[int, tuple[float, ...]]:
    """Return the number of equal parts of a step of that reach, and the stages of each.

    Raises Unstable for more than `MOST_PARTS`, and for a reach that is NaN.
    """
    if not reach <= MOST_PARTS * LONGEST:
        raise Unstable(
            f"tracers would take {reach / LONGEST:.4g} parts in a step, more than {MOST_PARTS}: the"
            " solution becomes unstable; take a smaller dt or smaller tracer-steps"
        )
    parts = max(1, math.ceil(reach / LONGEST))
    # the rounded product may be smaller than the dividend
    return parts, next((f for far, f in _REACH.items() if parts * far >= reach), _REACH[LONGEST])


def why_not(model: Model, kind: type[Stepper], adaptive: float | None = None) -> str | None:
    """Return why tracers cannot take separate steps, or None; adaptive: as in `RunConfig`."""
    scene = model.scene
    if adaptive is not None:
        return "steps follow their error"
    if not scene.tracers:
        return f"{scene.name} has no tracers"
    if kind.family not in ("explicit", "imex"):
        return f"{kind.name} includes tracers in its solves"
    if scene.forcing is not None or scene.changes_depth:
        return f"{scene.name} has sources of depth"
    return None


class TransportRate:
    """Spectral radius [s-1] of tracer transport, from speeds across elements.

    The speeds bound the radius, but exceed it by a factor that depends on the flow: Arnoldi
    iteration finds this factor in the initial state of the scene.
    """

    def __init__(self, model: Model) -> None:
        mesh, state = model.device_mesh, model.initial_state()
        self._courant, depth = CourantRate(mesh), model.fluid_size - mesh.size
        model.set_time(0.0)
        wind = model.parameters.get("wind", state)
        bound = self._courant.bound(wind, mesh.upload(np.ones(mesh.size)))
        carry = TracerTransport(mesh, 1)
        radius = spectral_radius(model, state, lambda x, out: carry(wind, x, depth, out, depth))
        self.initial = min(bound, radius)
        """Estimate of the spectral radius at the initial state of the scene [s-1]."""
        self._share = min(1.0, MARGIN * self.initial / bound) if bound > 0.0 else 1.0

    def __call__(self, flux: wp.array, depth: wp.array) -> float:
        """Return the radius [s-1] of q -> div(q flux) / depth."""
        return self._share * self._courant.bound(flux, depth)


def tracer_limit(model: Model) -> float:
    """Return the longest step [s] of tracers in the initial wind; infinite at rest."""
    radius = TransportRate(model).initial
    return TRACER_PARTS * LONGEST / (MARGIN * radius) if radius > 0.0 else math.inf


class TracerSteps(Trajectory, ABC):
    """Takes `cycle` steps of `dt` at once, and one step of tracers over all of them.

    Its state is complete, and observed, only after all of them. The order is two at most.
    Diffusion of tracers is separate, like that of the flow.
    """

    def __init__(self, model: Model, kind: type[Stepper], dt: float, cycle: int) -> None:
        """Create the steps; `kind` is the class of the flow's stepper, with steps of dt [s]."""
        super().__init__(model.inviscid, dt)
        self.name, self.order = kind.name, min(2, kind.order)  # type: ignore[misc]
        self.cycle, self._length = cycle, cycle * dt
        self.can_give_up = is_large(model)
        self.diffusion = Diffusion(model, self._length) if model.diffusive else None
        self._rate, self._size = TransportRate(model), model.device_mesh.size
        self.counters["tracer_stages"] = 0

    def step(self) -> None:
        diffuses_first = self.steps // self.cycle % 2 == 1
        if self.diffusion and diffuses_first:
            self.diffusion.act(self.state)
        self._move()
        if self.diffusion and not diffuses_first:
            self.diffusion.act(self.state)
        self._finish()
        if self.model.limiter is not None:
            self.model.limiter(self.state)
        self.steps += self.cycle

    @abstractmethod
    def _move(self) -> None:
        """Advance `state` from `time` over all steps."""

    def _finish(self) -> None:
        """Copy wind and depth from the flow's own stepper."""

    def _move_tracers(self, steps: MassSteps, flow: wp.array, depth: wp.array, tau: float) -> None:
        """Carry masses of `state` for tau [s] by a flow, which moves with the wind flow / depth."""
        parts, fractions = stages_for(tau * self._rate(flow, depth))
        self.counters["tracer_stages"] += parts * len(fractions)
        steps(flow, self.state, tau, parts, fractions)


class CarriedTracers(TracerSteps):
    """Tracers carried by the time-averaged mass flux of a stepper on `model.flux_model`.

    q = 1 stays 1 and every tracer keeps its mass. Other changes of the depth (the residual of a
    solver, diffusion in steps of another length) change tracers in proportion, as in `TracerWaves`.
    Raises ConfigError for a stepper that does not name the states in its memory.
    """

    def __init__(self, model: Model, scheme: Stepper, cycle: int) -> None:
        scheme.check_names()
        arrays, shape = scheme.arrays().items(), scheme.state.shape
        others = [k for k, array in arrays if k != "state" and array.shape[-1:] == shape]
        if others and not scheme.levels:
            raise ConfigError(
                f"tracer-steps: {scheme.name} keeps {', '.join(others)} between steps:"
                " its `levels` must name the states of earlier times among them"
            )
        super().__init__(model, type(scheme), scheme.dt, cycle)
        self.scheme, tracers, n, first = scheme, model.tracers, self._size, model.fluid_size
        assert tracers is not None
        self._depth, self._crossed = slice(first - n, first), slice(first, first + 2 * n)
        self._steps = MassSteps(model.device_mesh, model.size, first, tracers.count, first - n)
        self._nothing, self._flux = model.zeros(2 * n), model.zeros(2 * n)
        self._has_residual = model.diffusive or scheme.family == "imex"
        if self._has_residual:
            self._ratio, self._before = tracers.mixing_ratio(), model.zeros()
            self._masses = Masses(model.device_mesh)

    def start(self, state: wp.array, t: float = 0.0) -> None:
        super().start(state, t)
        flow = self.scheme.model.zeros()
        wp.copy(flow, state, count=self._depth.stop)
        self.scheme.start(flow, t)

    def _move(self) -> None:
        combine, scheme = self.model.launch.combine, self.scheme
        now = scheme.state[self._crossed]
        for name in (scheme.levels or ("state",))[::-1]:  # the present one becomes zero last
            past = getattr(scheme, name)[self._crossed]
            combine(past, now, -1.0, out=past)
        for _ in range(self.cycle):
            check_stop()
            scheme.step()
        combine(self._nothing, scheme.state[self._crossed], 1.0 / self._length, out=self._flux)
        self._move_tracers(self._steps, self._flux, self.state[self._depth], self._length)

    def _finish(self) -> None:
        if self._has_residual:  # tracers follow the residual, and keep their masses
            new, before = self.state, self._before
            wp.copy(before, new)
            self._ratio.set(before)
            wp.copy(new[self._depth], self.scheme.state[self._depth])
            self._ratio.follow(before, new)
            for block in range(self._depth.stop // self._size, len(self.model.names)):
                self._masses.restore(before, new, block)
        wp.copy(self.state, self.scheme.state, count=self._depth.stop)

    def restart_arrays(self) -> dict[str, wp.array]:
        return super().restart_arrays() | _of_flow(self.scheme.restart_arrays())

    def numbers(self) -> dict[str, NDArray[Any]]:
        return super().numbers() | _of_flow(self.scheme.numbers())

    def load_numbers(self, saved: dict[str, NDArray[Any]], steps: int) -> None:
        super().load_numbers(saved, steps)
        flow = {k.removeprefix(FLOW): v for k, v in saved.items() if k.startswith(FLOW)}
        self.scheme.load_numbers(flow, steps)


def _of_flow(values: dict[str, Any]) -> dict[str, Any]:
    """Return the values of the flow's stepper by their names in checkpoints."""
    return {f"{FLOW}{name}": value for name, value in values.items()}


class CarriedWithDepth(TracerSteps):
    """Depth and tracers carried by a prescribed wind, constant in each 1/TRACER_PARTS of a step.

    No separate flow then requires shorter steps.
    """

    def __init__(self, model: Model, kind: type[Stepper], dt: float, cycle: int) -> None:
        super().__init__(model, kind, dt, cycle)
        mesh, masses = model.device_mesh, len(model.names)
        self._steps = MassSteps(mesh, model.size, 0, masses)
        self._ones = mesh.upload(np.ones(mesh.size))

    def _move(self) -> None:
        length = self._length / TRACER_PARTS
        for piece in range(TRACER_PARTS):
            self.model.set_time(self.time + (piece + 0.5) * length)
            self._move_tracers(self._steps, self.model.parameters["wind"], self._ones, length)
