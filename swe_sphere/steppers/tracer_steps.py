"""Tracers on a step of their own: one for several steps of the flow that carries them."""

import math
from abc import ABC, abstractmethod
from typing import Any, ClassVar

import numpy as np
import warp as wp
from numpy.typing import NDArray

from swe_sphere.equations.model import Model
from swe_sphere.equations.spectrum import largest_modulus
from swe_sphere.errors import ConfigError, Unstable
from swe_sphere.kernels import combine_kernel
from swe_sphere.kernels.tracer_step import flux_kernel
from swe_sphere.operators.tracer_step_operator import Crossings, TracerStep
from swe_sphere.operators.tracers import TracerTransport
from swe_sphere.solvers.vector_space import VectorSpace
from swe_sphere.steppers.split_diffusion import Diffusion
from swe_sphere.steppers.stepper import Stepper, Trajectory

FLOW = "flow_"
"""In front of names of what the flow's stepper remembers."""
PARTS = 2
"""Parts that a tracer step has at the start, at most; it has more where the wind grows."""
MARGIN = 1.1
"""By how much the spectral radius may exceed what the one at the start makes us expect."""
_REACH: dict[float, tuple[float, ...]] = {
    2.8: (1 / 4, 1 / 3, 1 / 2, 1.0),
    4.6: (0.16904917667410368, 0.13380303671748228, 1 / 4, 1 / 3, 1 / 2, 1.0),
    6.2: (
        0.12480976664540724, 0.07662096184186656, 0.16667480464512058, 0.17018634951480482,
        1 / 4, 1 / 3, 1 / 2, 1.0,
    ),
    7.9: (
        0.09907015380844966, 0.04926610891320422, 0.12406549675252491, 0.10608279520348493,
        0.1659580170045138, 0.1832494363935329, 1 / 4, 1 / 3, 1 / 2, 1.0,
    ),
}  # fmt: skip
"""Stages by how far they reach: the largest stable tau times the spectral radius of A.

They are the f_i in m_i = m_0 + f_i tau A m_(i-1): explicit stages for waves alone, of fourth order,
and stable for nearly as long as there are any; `benchmarks/tracer_stages.py` derives the numbers.
"""
LONGEST = max(_REACH)
MOST_PARTS = 1000
"""So many even out that a wind has grown beyond all bounds."""


def stages_for(reach: float) -> tuple[int, tuple[float, ...]]:
    """Into how many equal parts to divide a step of that reach, and the stages of each.

    Raises Unstable for so many that no step would ever end, and for a reach that is NaN.
    """
    if not reach <= MOST_PARTS * LONGEST:
        raise Unstable(
            f"tracers would take {reach / LONGEST:.4g} parts in a step, more than {MOST_PARTS}: the"
            " solution blows up; take a smaller dt or smaller tracer-steps"
        )
    parts = max(1, math.ceil(reach / LONGEST))
    # rounded, the product may fall short of what it was divided from
    return parts, next((f for far, f in _REACH.items() if parts * far >= reach), _REACH[LONGEST])


def why_not(model: Model, kind: type[Stepper]) -> str | None:
    """Why tracers cannot take steps of their own, if they cannot."""
    scene = model.scene
    if not scene.tracers:
        return f"{scene.name} has no tracers"
    if kind.family not in ("explicit", "imex"):
        return f"{kind.name} takes tracers along in its solves"
    if scene.forcing is not None or any("mass" not in e.conserves for e in scene.effects):
        return f"{scene.name} has sources of depth"
    return None


class TransportRate:
    """Spectral radius [s-1] of tracer transport, from speeds across elements.

    They bound it, and are too large by a part that depends on the flow: Arnoldi iteration finds it
    at the start of the scene.
    """

    def __init__(self, model: Model) -> None:
        mesh = model.device_mesh
        self.crossings = Crossings(mesh, model.launch)
        model.set_time(0.0)
        wind = model.parameters.get("wind", model.initial_state())
        bound = self.crossings.bound(wind, mesh.upload(np.ones(mesh.size)))
        transport = TracerTransport(mesh, model.launch, 1)
        x, out = (mesh.upload(np.zeros(mesh.size)) for _ in "xy")

        def product(d: NDArray[np.floating]) -> NDArray[np.float64]:
            x.assign(mesh.restrict(d))
            transport(wind, x, 0, out, 0)
            rates: NDArray[np.float64] = mesh.collect(out).astype(np.float64)
            return rates

        start, found = np.random.default_rng(0).standard_normal(model.mesh.size), None
        if bound > 0.0:
            found = largest_modulus(product, start, 1e-2)
        self.start = bound if found is None else min(found, bound)
        """At the start of the scene [s-1], from above."""
        self._share = min(1.0, MARGIN * self.start / bound) if bound > 0.0 else 1.0

    def __call__(self, flux: wp.array, air: wp.array) -> float:
        """Return the radius [s-1] of q -> div(q flux) / air."""
        return self._share * self.crossings.bound(flux, air)


def tracer_limit(model: Model) -> float:
    """The longest step [s] of tracers in the wind of the start; infinite at rest."""
    radius = TransportRate(model).start
    return PARTS * LONGEST / (MARGIN * radius) if radius > 0.0 else math.inf


class TracerSteps(Trajectory, ABC):
    """Takes `every` steps of `dt` at once, and one step of tracers over all of them.

    Its state is whole, and observed, after those only.  Of second order at the most.  Diffusion of
    tracers is split off as that of the flow is.
    """

    pieces: ClassVar[int] = 1
    """Pieces of a step, with a flux each."""

    def __init__(self, model: Model, dt: float, every: int) -> None:
        super().__init__(model.inviscid, dt)
        assert model.tracers is not None
        self.every, self._length = every, every * dt / self.pieces
        self.diffusion = Diffusion(model, every * dt) if model.diffusive else None
        mesh, tracers = model.device_mesh, model.tracers
        self._old, rate = (mesh.upload(np.zeros(mesh.size)) for _ in "or")
        self._block = self.state[tracers.depth : tracers.depth + mesh.size]
        self._air = self._old, rate
        self._flux = mesh.upload(np.zeros(2 * mesh.size))
        self._rate = TransportRate(model)
        self._transport = TracerStep(
            mesh, model.launch, self._rate.crossings, tracers.count, tracers.first
        )
        self._add = combine_kernel(mesh.real, 1)
        model.launch.load(self._add)
        self.counters["tracer_stages"] = 0

    def step(self) -> None:
        launch, first = self.model.launch, self.steps // self.every % 2 == 1
        if self.diffusion and first:
            self.diffusion.act(self.state)
        for piece in range(self.pieces):
            wp.copy(self._old, self._block)
            self._move(self.time + piece * self._length)
            parts, fractions = stages_for(self._length * self._rate(self._flux, self._old))
            self.counters["tracer_stages"] += parts * len(fractions)
            self._transport.rate_of_air(self._flux, self._air[1])
            self._transport(self._flux, self._air, self.state, self._length, parts, fractions)
            launch(self._add, self._block.size, *self._air, self._length, self._block)
        if self.diffusion and not first:
            self.diffusion.act(self.state)
        self._finish()
        if self.model.limiter is not None:
            self.model.limiter(self.state)
        self.steps += self.every

    @abstractmethod
    def _move(self, t: float) -> None:
        """Move the flow forward from t [s], and put the mean mass flux meanwhile into `_flux`."""

    def _finish(self) -> None:
        """Take wind and depth of the flow's own stepper."""


class CarriedTracers(TracerSteps):
    """Tracers carried by the time-averaged mass flux of a stepper on `model.carrier`.

    q = 1 stays 1 and every tracer keeps its mass.  What else changes the depth (the residual of a
    solver, diffusion in steps of another length) takes tracers along, as in `TracerWaves`.  Raises
    ConfigError for a stepper that does not tell the states it remembers.
    """

    def __init__(self, model: Model, scheme: Stepper, every: int) -> None:
        scheme.check_names()
        arrays, shape = scheme.arrays().items(), scheme.state.shape
        others = [k for k, array in arrays if k != "state" and array.shape[-1:] == shape]
        if others and not scheme.levels:
            raise ConfigError(
                f"tracer-steps: {scheme.name} remembers {', '.join(others)}: its"
                " `levels` have to say which of them are states of times before"
            )
        self.scheme = scheme
        self.name, self.order = scheme.name, min(2, scheme.order)  # type: ignore[misc]
        super().__init__(model, scheme.dt, every)
        first = model.fluid_size
        self._fluid, self._crossed = slice(0, first), slice(first, first + self._flux.size)
        self._nothing = wp.zeros_like(self._flux)
        self._has_residual = model.diffusive or scheme.family == "imex"
        if self._has_residual:
            assert model.tracers is not None
            n, area = model.device_mesh.size, model.mesh.area
            self._ratio, self._before = model.tracers.mixing_ratio(), model.zeros()
            self._masses = [slice(i, i + n) for i in range(model.tracers.first, model.size, n)]
            self._space = VectorSpace(area / area.sum(), mesh=model.device_mesh)
            self._ones = model.device_mesh.upload(np.ones(n))

    def start(self, state: wp.array, t: float = 0.0) -> None:
        super().start(state, t)
        flow = self.scheme.model.zeros()
        wp.copy(flow, state, count=self._fluid.stop)
        self.scheme.start(flow, t)

    def _move(self, t: float) -> None:
        launch, scheme, size = self.model.launch, self.scheme, self._flux.size
        now = scheme.state[self._crossed]
        for name in (scheme.levels or ("state",))[::-1]:  # the present one becomes zero, at last
            past = getattr(scheme, name)[self._crossed]
            launch(self._add, size, past, now, -1.0, past)
        for _ in range(self.every):
            scheme.step()
        crossed = scheme.state[self._crossed]
        launch(self._add, size, self._nothing, crossed, 1.0 / self._length, self._flux)

    def _finish(self) -> None:
        if self._has_residual:  # tracers follow it, and keep their masses
            new, before, n = self.state, self._before, self._block.size
            wp.copy(before, new)
            self._ratio.set(before)
            wp.copy(self._block, self.scheme.state[self._fluid.stop - n : self._fluid.stop])
            self._ratio.follow(before, new)
            for mass in self._masses:
                self._space.match_mean(before[mass], new[mass], self._ones)
        wp.copy(self.state, self.scheme.state, count=self._fluid.stop)

    def costs(self) -> dict[str, float]:
        return self.scheme.costs() | super().costs()

    def state_dict(self) -> dict[str, NDArray[Any]]:
        flow = {f"{FLOW}{name}": array for name, array in self.scheme.state_dict().items()}
        return super().state_dict() | flow

    def load_state_dict(self, state: dict[str, NDArray[Any]], steps: int) -> None:
        super().load_state_dict(state, steps)
        flow = {k.removeprefix(FLOW): v for k, v in state.items() if k.startswith(FLOW)}
        self.scheme.load_state_dict(flow, steps)


class CarriedWithDepth(TracerSteps):
    """Depth and tracers carried by a prescribed wind, held in each of the pieces of one long step.

    There is no flow then whose own steps would have to be shorter.
    """

    pieces = PARTS

    def __init__(self, model: Model, scheme: type[Stepper], dt: float, every: int) -> None:
        """scheme: whose steps would be of dt [s]."""
        self.name, self.order = scheme.name, min(2, scheme.order)  # type: ignore[misc]
        super().__init__(model, dt, every)
        mesh = model.device_mesh
        self._stage, self._slope, self._part, self._mean = (
            mesh.upload(np.zeros(mesh.size)) for _ in range(4)
        )
        """Of the depth; the last one is its mean over a piece."""
        self._ones = mesh.upload(np.ones(mesh.size))
        self._transport_depth = TracerTransport(mesh, model.launch, 1)
        self._make_flux, self._plain = flux_kernel(mesh.real), mesh.stage
        model.launch.load(self._make_flux)

    def _move(self, t: float) -> None:
        model, n = self.model, self.model.device_mesh.size
        model.set_time(t + 0.5 * self._length)
        launch, wind = model.launch, model.parameters["wind"]
        parts, fractions = stages_for(self._length * self._rate(wind, self._ones))
        tau = self._length / parts
        wp.copy(self._part, self._old)
        self._mean.zero_()
        for _ in range(parts):
            wp.copy(self._stage, self._part)
            for i, fraction in enumerate(fractions):
                if i + 1 == len(fractions):
                    launch(self._add, n, self._mean, self._stage, 1.0 / parts, self._mean)
                self._transport_depth(wind, self._stage, 0, self._slope, 0)
                launch(self._add, n, self._part, self._slope, fraction * tau, self._stage)
            wp.copy(self._part, self._stage)
        launch(self._make_flux, n, wind, self._mean, 0, n, 0, self._plain, self._flux)
