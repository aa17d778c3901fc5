"""What every stepper does: it owns its state and moves it forward by one step at a time."""

import itertools
from abc import ABC, abstractmethod
from typing import Any, ClassVar, Literal, get_args

import numpy as np
import warp as wp
from numpy.typing import NDArray

from swe_sphere.equations.model import Model
from swe_sphere.equations.spectrum import Spectrum
from swe_sphere.errors import ConfigError
from swe_sphere.files.user_file import users_code
from swe_sphere.kernels import combine_kernel
from swe_sphere.kernels.stages import mix_kernel
from swe_sphere.kernels.vectors import AT_ONCE
from swe_sphere.operators.replay import Replay
from swe_sphere.settings.registry import Registry
from swe_sphere.steppers.split_diffusion import Diffusion

RECOMMENDED = "tr-bdf2"
"""The fully implicit scheme that the measurements recommend."""

Family = Literal["explicit", "imex", "exponential", "implicit"]
"""What is stepped explicitly, implicitly or exactly: all is explicit, linear gravity waves are
implicit, the linear part is exact, all is implicit."""

Marker = str | tuple[int, Literal[1], int]
"""A marker of matplotlib: a letter, or a star's points, 1, and its turn [degrees]."""

STEPPERS: "Registry[Stepper]" = Registry(
    "stepper",
    order=lambda cls: (get_args(Family).index(cls.family), cls.order),
    aliases={"fully-implicit": RECOMMENDED},
)
"""All steppers by name, by family and order; a class with a `name` is entered where it is
defined."""


class Stepper(ABC):
    """Time integrator of a model with a fixed step dt [s].

    The stepper owns the state; `state_dict` returns all it needs to go on from there bit for bit.
    With `diffusion_apart` its `model` has no viscosity and no hyperviscosity: `diffusion` steps
    them, and `step` has it act after even steps and before odd ones, which is Strang's splitting of
    two steps and of second order.
    Raises ConfigError for a step that is not positive and finite.
    """

    name: ClassVar[str]
    """By which users call it; a class without a name of its own is a base of others."""
    order: ClassVar[int]
    family: ClassVar[Family] = "explicit"
    estimate_order: ClassVar[int | None] = None
    """The power of dt that its estimate of the error goes with; None where it has none."""
    style: ClassVar[tuple[str, Marker] | None] = None
    """Its colour and its marker in pictures; None: whatever is free."""
    expected_error: ClassVar[tuple[tuple[float, float, float], ...]] = ()
    """Time steps [s] with the l2 errors of height and wind in scene lauter, ne 3, after 3 hours,
    that `swe-sphere verify` holds it to."""
    vectors: ClassVar[int] = 50
    """State vectors that it and its solver hold, without the Krylov basis; rather too many here."""
    coupled_stages: ClassVar[int] = 1
    """Stages that are solved for together, each with a preconditioner and a Krylov basis."""
    diffusion_apart: bool = True
    """Whether viscosity and hyperviscosity are split off, so that they do not limit its step."""
    diffusion_steps: ClassVar[int | None] = None
    """Steps over which it has `diffusion` join its change itself; None: `step` sees to it."""
    diffusion_order: ClassVar[int] = 2
    """Of diffusion by itself; more than it has together with the rest costs, and gains nothing."""
    holds_damping: ClassVar[bool] = False
    """Whether it holds drag and relaxation over a step, which is of first order."""
    repeats_from: ClassVar[int | None] = None
    """The step from which on all launch the same kernels, on arrays that `_turn` exchanges, and so
    can be recorded; None: never.  A class that defines `_advance` says so itself."""
    safety: ClassVar[float] = 0.85
    """Part of the stability limit that an automatic step uses: winds grow during a run."""
    courant: ClassVar[float] = 2.0
    """Advective Courant number of an automatic step without a stability limit."""
    longest: ClassVar[float] = 3600.0
    """An automatic step without a stability limit is no longer than this [s]."""

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        if "_advance" in vars(cls) and "repeats_from" not in vars(cls):
            cls.repeats_from = None
        if "name" in vars(cls):
            if not hasattr(cls, "order"):
                raise ConfigError(f"stepper {cls.name} has no `order`: say it beside its name")
            STEPPERS.add(cls)

    def __init__(self, model: Model, dt: float) -> None:
        if not (np.isfinite(dt) and dt > 0.0):
            raise ConfigError(f"the time step must be positive and finite, not {dt} s")
        self.diffusion: Diffusion | None = None
        if model.diffusive and self.diffusion_apart:
            whole = dt * (self.diffusion_steps or 1)
            self.diffusion = Diffusion(model, whole, self.diffusion_order)
            model = model.inviscid
        self.model, self.dt = model, float(dt)
        self.state: wp.array = model.zeros()
        self.steps = 0
        self.counters: dict[str, int] = {}
        self._origin = 0.0
        repeats = self.repeats_from is not None and model.repeats
        self._replay = Replay(model.launch, model.counters) if repeats else None

    @property
    def time(self) -> float:
        """Time of `state` [s]."""
        return self._origin + self.steps * self.dt

    def start(self, state: wp.array, t: float = 0.0) -> None:
        """Begin from a copy of the state at time t [s]."""
        wp.copy(self.state, state)
        self._origin, self.steps = t, 0

    def step(self) -> None:
        """Move `state` forward by dt."""
        with users_code():
            if self._replay is None or self.steps < (self.repeats_from or 0):
                self._launch_step()
            elif self._replay(key := (self.state.ptr, self._apart is not None and self.steps % 2)):
                self._turn()
            else:
                with self._replay.record(key):
                    self._launch_step()
        self.steps += 1

    @property
    def _apart(self) -> Diffusion | None:
        return self.diffusion if self.diffusion_steps is None else None

    def _launch_step(self) -> None:
        apart = self._apart
        if apart and self.steps % 2:
            apart.act(self.state)
        self._advance()
        self._turn()
        if apart and not self.steps % 2:
            apart.act(self.state)
        if self.model.limiter is not None:
            self.model.limiter(self.state)

    @abstractmethod
    def _advance(self) -> None: ...

    def _turn(self) -> None:  # noqa: B027 - most have none that do
        """Let arrays exchange their roles after `_advance`, where they do; launches nothing."""

    @classmethod
    def spectrum(cls, model: Model, state: wp.array, t: float = 0.0) -> Spectrum:
        """Spectral radii [s-1] of what is stepped explicitly, which `stable_dt` asks for."""
        return model.inviscid.spectrum(state, t)

    @classmethod
    def limit(cls, spectrum: Spectrum) -> float:
        """Largest stable step [s] where the spectrum is what the method of that name returned."""
        return cls.stable_dt(spectrum.wave, spectrum.dissipation)

    @classmethod
    @abstractmethod
    def stable_dt(cls, wave: float, dissipation: float = 0.0) -> float:
        """Largest stable step [s] for spectral radii of waves and dissipation [s-1]."""

    @classmethod
    def order_in(cls, model: Model, **options: Any) -> int:
        """Its order for a model, if it is built with those options."""
        if cls.holds_damping and model.inviscid.dissipative:
            return 1
        apart = cls.diffusion_apart or options.get("diffusion") == "apart"
        return min(cls.order, cls.diffusion_order) if model.diffusive and apart else cls.order

    def costs(self) -> dict[str, float]:
        """What the steps so far have taken: counts, and seconds where the name says so."""
        return dict(self.counters)

    def state_dict(self) -> dict[str, NDArray[Any]]:
        """Copies of all arrays that a bitwise exact restart needs, in the precision of the run.

        Of the whole mesh, however many ranks share it, and on all of them.
        """
        mesh = self.model.device_mesh
        arrays = {name: mesh.collect(array).copy() for name, array in self._remembered().items()}
        return arrays | {"origin": np.array(self._origin)}

    def load_state_dict(self, state: dict[str, NDArray[Any]], steps: int) -> None:
        """Go on from what `state_dict` returned after that many steps.

        Raises ConfigError when the state is of another stepper or another size.
        """
        mesh = self.model.device_mesh
        for name, array in self._remembered().items():
            if name not in state or not mesh.matches(state[name], array):
                raise ConfigError(f"the restart data do not fit stepper {self.name}: {name}")
            wp.copy(array, mesh.scatter(state[name]))
        self._origin, self.steps = float(state["origin"]), steps

    def _remembered(self) -> dict[str, wp.array]:
        return {"state": self.state}

    @property
    def levels(self) -> tuple[wp.array, ...]:
        """The states among what it remembers: the present one, and those before."""
        return (self.state,)

    def untold_levels(self) -> list[str]:
        """Names of what may be states of times before, where a class does not say its `levels`."""
        if type(self).levels is not Stepper.levels:
            return []
        found = self._remembered().items()
        return [k for k, x in found if x.ptr != self.state.ptr and x.shape[-1:] == self.state.shape]


class Combiner:
    """out = x + sum_s c[s] stack[s], with coefficients fixed so that launches can be recorded."""

    def __init__(self, model: Model, stack: wp.array, coefficients: NDArray[np.float64]) -> None:
        self._model = model
        terms = [(stack[s], float(c)) for s, c in enumerate(coefficients) if c != 0.0]
        self._parts = [
            list(itertools.chain(*terms[i : i + AT_ONCE])) for i in range(0, len(terms), AT_ONCE)
        ]
        real = model.device_mesh.real
        self._kernels = [combine_kernel(real, len(part) // 2) for part in self._parts]
        model.launch.load(*self._kernels)

    def __call__(self, x: wp.array, out: wp.array) -> None:
        if not self._parts:
            wp.copy(out, x)
        for kernel, part in zip(self._kernels, self._parts, strict=True):
            self._model.launch(kernel, self._model.size, x, *part, out)
            x = out


class Mixer:
    """out = x + sum_k w_k (levels_k - x), fixed likewise; `out` is another array."""

    def __init__(self, model: Model, levels: wp.array, weights: NDArray[np.float64]) -> None:
        mesh, (used,) = model.device_mesh, np.nonzero(weights)
        first, last = (int(used[0]), int(used[-1]) + 1) if used.size else (0, 0)
        lanes = mesh.lanes if model.size >= mesh.lanes else 1
        self._launch, self._kernel = model.launch, mix_kernel(mesh.real, lanes)
        self._dim, self._size = -(-model.size // lanes), model.size
        self._given = levels, mesh.upload(weights), first, last
        model.launch.load(self._kernel)

    def __call__(self, x: wp.array, out: wp.array) -> None:
        self._launch(self._kernel, self._dim, self._size, x, *self._given, out)
