"""Base of all steppers, which advance their state by one step at a time."""

import inspect
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Iterator
from contextlib import nullcontext
from fractions import Fraction
from pathlib import Path
from typing import Any, ClassVar, Literal, TypeVar, get_args

import numpy as np
import warp as wp
from numpy.typing import NDArray

from swe_sphere.arrays import Array
from swe_sphere.equations.effects import as_float
from swe_sphere.equations.model import Model
from swe_sphere.equations.spectrum import SpectralRadii
from swe_sphere.errors import ConfigError, NotCopyable
from swe_sphere.files.user_file import is_custom
from swe_sphere.operators.replay import Replay
from swe_sphere.ranks.limits import one_thread
from swe_sphere.settings.registry import Registry
from swe_sphere.settings.values import read_toml
from swe_sphere.steppers.split_diffusion import Diffusion, SplitPenalty
from swe_sphere.steppers.stability import GROWTH_TIME, Complex, largest_step
from swe_sphere.steppers.stage_solver import StageSolver

RECOMMENDED = "tr-bdf2"
"""Recommended fully implicit scheme, according to measurements."""

Family = Literal["explicit", "imex", "exponential", "implicit"]
"""Family of a method, in this order: all terms are explicit; linear gravity waves are implicit;
the linear part is exact; all terms are implicit."""


STEPPERS: "Registry[Stepper]" = Registry(
    "stepper",
    order=lambda cls: (get_args(Family).index(cls.family), cls.order),
    aliases={"fully-implicit": RECOMMENDED},
)
"""All steppers by name, sorted by family and order; a class with a `name` registers itself."""


LARGE = 500_000
"""Number of nodes per rank above which a step of implicit waves, or of tracers, takes a second."""


def is_large(model: Model) -> bool:
    """Return whether steps take so long that a copy of the state before each is worth its time."""
    return model.mesh.size > LARGE * model.device_mesh.comm.size


class Trajectory(NotCopyable):
    """A state that advances in time, with all data that an exact restart needs.

    Steppers are trajectories, and so are controllers of the step size that contain one. Raises
    ConfigError for a step that is not positive and finite.
    """

    name: ClassVar[str]
    """Name that users type; a class without a name is a base of others."""
    order: ClassVar[int]
    memory: ClassVar[tuple[str, ...]] = ("state",)
    """Arrays that a method must keep between steps, by name; they are written to checkpoints."""
    solver: StageSolver | None = None
    """Solver of the equations in a step; None if there are none."""
    can_give_up: bool = False
    """True if steps are long and call `check_stop`, so that a step may be interrupted."""
    cycle: int = 1
    """Number of steps that `step` takes."""

    def __init__(self, model: Model, dt: float) -> None:
        """Create a trajectory of a model with the time step dt [s]."""
        if not (np.isfinite(dt) and dt > 0.0):
            raise ConfigError(f"the time step must be positive and finite, got {dt} s")
        self.model, self.dt = model, float(dt)
        self.state: wp.array = model.zeros()
        self.steps = 0
        """Number of steps of dt since the start."""
        self.counters = model.counters
        self.origin = 0.0
        """Time of the start [s]."""

    @property
    def time(self) -> float:
        """Time of `state` [s]."""
        return self.origin + self.steps * self.dt

    def start(self, state: wp.array, t: float = 0.0) -> None:
        """Start from a copy of the state at time t [s]."""
        wp.copy(self.state, state)
        self.origin, self.steps = t, 0

    def follow(self, earlier: "Trajectory", t: float) -> None:
        """Continue from the state of an earlier trajectory of the same method at time t [s].

        A multistep method starts again, or keeps its memory if its steps may vary.
        """
        self.start(earlier.state, t)

    def step(self) -> None:
        """Advance `state` by `cycle` steps."""
        raise NotImplementedError

    def take(self, most: int) -> None:
        """Take a step, or several that are faster together, at most `most`."""
        self.step()

    def arrays(self) -> dict[str, wp.array]:
        """Return the arrays in `memory`, by name."""
        return {name: getattr(self, name) for name in self.memory}

    def restart_arrays(self) -> dict[str, wp.array]:
        """Return the device arrays that an exact restart needs, those of the solver included."""
        return self.arrays() | ({} if self.solver is None else self.solver.arrays())

    def numbers(self) -> dict[str, NDArray[Any]]:
        """Return the numbers that an exact restart needs in addition to `restart_arrays`."""
        solver = {} if self.solver is None else self.solver.numbers()
        return {"origin": np.array(self.origin)} | solver

    def load_numbers(self, saved: dict[str, NDArray[Any]], steps: int) -> None:
        """Load the result of `numbers` after that many steps."""
        self.origin, self.steps = float(saved["origin"]), steps
        if self.solver is not None:
            self.solver.load_numbers(saved)

    def restore_point(self) -> Callable[[], None]:
        """Return a function that restores the present state; arrays are kept on the device."""
        kept = {name: wp.clone(array) for name, array in self.restart_arrays().items()}
        numbers, steps = self.numbers(), self.steps

        def restore() -> None:
            for name, array in self.restart_arrays().items():
                wp.copy(array, kept[name])
            self.load_numbers(numbers, steps)

        return restore

    def state_dict(self) -> dict[str, NDArray[Any]]:
        """Return copies of all arrays that a bitwise exact restart needs, in the run's precision.

        They are those of the whole mesh, on all ranks that share it.
        """
        collect, arrays = self.model.device_mesh.collect, self.restart_arrays()
        return {name: collect(array).copy() for name, array in arrays.items()} | self.numbers()

    def load_state_dict(self, saved: dict[str, NDArray[Any]], steps: int) -> None:
        """Resume from the result of `state_dict` after that many steps.

        Raises ConfigError if the arrays are those of another stepper or of another size.
        """
        mesh, misfit = self.model.device_mesh, f"the restart data do not fit stepper {self.name}"
        for name, array in self.restart_arrays().items():
            shape = *array.shape[:-1], array.shape[-1] // mesh.size * mesh.mesh.size
            if name not in saved or saved[name].shape != shape:
                raise ConfigError(f"{misfit}: {name}")
            wp.copy(array, mesh.scatter(saved[name]))
        try:
            self.load_numbers(saved, steps)
        except KeyError as lacking:
            raise ConfigError(f"{misfit}: {lacking.args[0]}") from None


class Stepper(Trajectory, ABC):
    """Time integrator of a model with a fixed step dt [s].

    A method defines `advance`, which changes `state` in place, and `amplification`, from which its
    longest stable step follows. With `splits_penalty` its `model` has no edge penalty: `penalty`
    acts in the middle of every `penalty.every` steps, or its rate is held over a step. With
    `splits_diffusion` the model has no viscosity and no hyperviscosity: `diffusion` steps them,
    after even steps and before odd ones: Strang's splitting of two steps, of second order.
    """

    family: ClassVar[Family] = "explicit"
    estimate_order: ClassVar[int | None] = None
    """Power of dt to which the error estimate is proportional; None without an estimate."""
    splits_diffusion: bool = True
    """True if diffusion is applied separately, so that it limits no step."""
    diffusion_steps: ClassVar[int | None] = None
    """Steps over which `advance` includes `diffusion` in its change; None: `step` splits it off.
    The split penalty acts on as many successive levels, by Euler steps."""
    splits_penalty: ClassVar[bool] = True
    """True if the stages are without the penalty: `SplitPenalty`, or `HeldPenalty` if implicit."""
    diffusion_order: ClassVar[int] = 2
    """Order of separate diffusion; one above the order of the splitting gains nothing."""
    levels: ClassVar[tuple[str, ...]] = ()
    """Names of states in `memory`, the present one first; empty for `state` alone."""
    holds_damping: ClassVar[bool] = False
    """True if drag and relaxation are held constant over a step, which is of first order."""
    repeats_from: ClassVar[int | None] = None
    """Number of the step from which `advance` launches only the same kernels on arrays that `swap`
    exchanges, so that it can be recorded; None: never. Another `advance` does not inherit it."""
    fused_steps: ClassVar[int] = 1
    """Most steps launched as a whole on large meshes: about eight evaluations (`strips.py`)."""
    safety: ClassVar[float] = 0.85
    """Fraction of the stability limit that an automatic step uses: winds grow during a run."""
    long_run_factor: ClassVar[float] = 1.0
    """Factor of `safety` in runs of more than `planning.LONG_RUN`, in which winds grow more."""
    courant: ClassVar[float] = 2.0
    """Advective Courant number of an automatic step without a stability limit."""
    longest: ClassVar[float] = 3600.0
    """Longest automatic step without a stability limit [s]."""
    reach: ClassVar[float] = 20.0
    """Longest step that `stable_dt` considers, times the sum of the spectral radii."""
    default_tolerance: ClassVar[float] = 1e-3
    """Default of the option `tolerance` of methods that solve equations."""
    error_constant: ClassVar[float]
    """C in the truncation error C dt^(order + 1) d^(order + 1)x/dt^(order + 1) of a step."""

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        if "advance" in vars(cls) and "repeats_from" not in vars(cls):
            cls.repeats_from = None
        if "name" in vars(cls):
            if not hasattr(cls, "order"):
                raise ConfigError(f"stepper {cls.name} has no `order`: define it beside its name")
            if cls.family not in (known := get_args(Family)):
                raise ConfigError(
                    f"stepper {cls.name}: `family` must be {' or '.join(known)}, got {cls.family!r}"
                )
            try:
                cls.complete()
            except (AttributeError, TypeError, ValueError) as error:
                raise ConfigError(f"stepper {cls.name}: invalid coefficients: {error}") from None
            for name in ("safety", "long_run_factor", "courant", "longest", "reach"):
                if not 0.0 < as_float(x := getattr(cls, name)) < math.inf:
                    raise ConfigError(f"stepper {cls.name}: {name} must be above 0, got {x!r}")
            for name, x in [*inspect.signature(cls).parameters.items()][2:]:
                named = x.kind not in (x.VAR_POSITIONAL, x.VAR_KEYWORD)
                if named and x.empty in (x.annotation, x.default):
                    raise ConfigError(f"stepper {cls.name}: option {name} lacks type or default")
            STEPPERS.add(cls)

    @classmethod
    def complete(cls) -> None:
        """Check the coefficients of a new method, and set the attributes that follow from them."""

    def __init__(self, model: Model, dt: float) -> None:
        super().__init__(model, dt)
        self.can_give_up |= self.family == "imex" and is_large(model)
        self.diffusion: Diffusion | None = None
        self.penalty: SplitPenalty | None = None
        self.wind_changed: Callable[[wp.array], None] | None = None  # called with the change (2N,)
        if self.splits_diffusion and model.diffusive:
            whole = dt * (self.diffusion_steps or 1)
            self.diffusion = Diffusion(model, whole, self.diffusion_order)
        if model.penalised and self.splits_penalty:
            self.penalty = SplitPenalty(model, dt, self.diffusion_steps)
        self.model = self.stage_model(model)
        self._split_diffusion = self.diffusion if self.diffusion_steps is None else None
        self._replay: Replay | None = None
        if self.repeats_from is not None and model.scene.autonomous:
            custom = is_custom(type(self))
            self._replay = CheckedReplay(self) if custom else Replay(model.launch, model.counters)

    def stage_model(self, model: Model) -> Model:
        """Return the model without effects that are split from the stages."""
        if self.splits_penalty:
            return model.inviscid if self.splits_diffusion else model.unpenalised()
        return model.without(lambda effect: effect.diffuses) if self.splits_diffusion else model

    def start(self, state: wp.array, t: float = 0.0) -> None:
        self.check_names()
        super().start(state, t)
        if self.solver is not None:
            self.make_guesses(self.solver.start(self.state, t, self.dt))

    def check_names(self) -> None:
        """Raise ConfigError if a name in `memory` or `levels` is not that of an array."""
        for names in (self.memory, self.levels):
            if not isinstance(names, tuple) or not all(
                isinstance(getattr(self, str(name), None), wp.array) for name in names
            ):
                raise ConfigError(
                    f"stepper {self.name}: `memory` and `levels` must be tuples of names of"
                    f" attributes with arrays, got {names!r}"
                )

    def allocate(self) -> None:
        """Allocate the arrays of a method with a solver; model and solver exist already."""

    def make_guesses(self, slope: wp.array) -> None:
        """Make the first guesses of a method with a solver from the initial slope."""

    def _is_penalised(self, steps: int) -> bool:
        """Return whether the penalty is due after that many steps; periods count from time 0."""
        return self.penalty is not None and self.penalty.is_due(steps, round(self.origin / self.dt))

    def step(self) -> None:
        apart, limiter = self._split_diffusion, self.model.limiter
        with nullcontext() if self.solver is None else one_thread():
            if self.penalty is not None and self._is_penalised(self.steps):
                self.penalty.act(self.state, self.wind_changed)
            if apart is not None and self.steps % 2:
                apart.act(self.state)
            if self._replay is None or self.steps < (self.repeats_from or 0):
                self.advance()
            else:
                self._replay(self.state.ptr, self.advance)
            self.swap()
            if apart is not None and not self.steps % 2:
                apart.act(self.state)
            if limiter is not None:
                limiter(self.state)
        self.steps += 1

    def take(self, most: int) -> None:
        repeats = type(self._replay) is Replay and self.steps >= (self.repeats_from or 0)
        alone = self._split_diffusion is None and self.model.limiter is None
        is_cut = self.model.device_mesh.is_cut
        count = min(self.fused_steps if repeats and alone and is_cut else 1, most)
        while any(map(self._is_penalised, range(self.steps, self.steps + count))):
            count //= 2
        if self._replay is None or count <= 1:
            self.step()
            return
        swaps = iter(range(count))
        self._replay((self.state.ptr, count), self._advance_all, swaps)
        for _ in swaps:
            self.swap()
        self.steps += count

    def _advance_all(self, swaps: Iterator[int]) -> None:
        """Take a step for each of the swaps, which are consumed."""
        for _ in swaps:
            self.advance()
            self.swap()

    @abstractmethod
    def advance(self) -> None:
        """Advance `state` from `time` by dt."""

    def swap(self) -> None:
        """Exchange the roles of arrays after `advance`; launches nothing."""

    @classmethod
    def spectral_radii(cls, model: Model, state: wp.array, t: float = 0.0) -> SpectralRadii:
        """Return the spectral radii [s-1] of the explicit part of the method, for `stable_dt`."""
        in_stages = model.inviscid if cls.splits_diffusion else model.unpenalised()
        return in_stages.spectral_radii(state, t)

    @classmethod
    def stable_dt(cls, radii: SpectralRadii) -> float:
        """Return the largest stable step [s] for the result of `spectral_radii`."""
        largest = radii.wave, radii.dissipation
        return largest_step(cls.amplification, *largest, cls.reach, growth_time=GROWTH_TIME)

    @classmethod
    def amplification(cls, z_wave: Complex, z_dissipation: Complex) -> Array:
        """Return the largest modulus of amplification factors, given eigenvalues times dt."""
        raise ConfigError(
            f"stepper {cls.name} defines no `amplification(cls, z_wave, z_dissipation)`, from"
            " which its stability limit follows"
        )

    @classmethod
    def order_in(cls, model: Model, **options: Any) -> int:
        """Return the order of the method for a model, if it is built with those options."""
        if cls.holds_damping and model.inviscid.dissipative:
            return 1
        if model.penalised and cls.diffusion_steps:
            return 1
        apart = cls.splits_diffusion or options.get("diffusion") == "apart"
        limited = (model.penalised and cls.splits_penalty) or (apart and model.diffusive)
        return min(cls.order, cls.diffusion_order) if limited else cls.order

    def solver_tolerance(self, tolerance: float | None) -> float:
        """Return the given tolerance of the solver, or the default of the method."""
        return self.default_tolerance if tolerance is None else tolerance


S = TypeVar("S", bound=Stepper)


def read_methods(family: type[S], *names: str) -> list[type[S]]:
    """Define methods of a family in methods.toml: classes with the attributes in their tables."""
    own, tables = {"__module__": family.__module__}, METHODS[family.__name__]
    return [type(name, (family,), own | tables[name]) for name in names]


def _constant(value: Any) -> Any:
    """Convert lists to tuples, and fractions in strings to numbers, also in tables."""
    if isinstance(value, dict):
        return {key: each if key == "__doc__" else _constant(each) for key, each in value.items()}
    if isinstance(value, list):
        return tuple(map(_constant, value))
    return float(Fraction(value)) if isinstance(value, str) and "/" in value else value


METHODS = _constant(read_toml(Path(__file__).with_name("methods.toml")))
"""The tables of methods.toml, with tuples for lists and numbers for fractions."""


class CheckedReplay(Replay):
    """A replay that compares the first repetition of a step with the step itself, bit for bit.

    Recordings do not contain work on the host, nor numbers that change from step to step. Raises
    ConfigError if the repetition differs.
    """

    def __init__(self, stepper: "Stepper") -> None:
        super().__init__(stepper.model.launch, stepper.model.counters)
        self._stepper = stepper
        self._checked: set[Hashable] = set()

    def __call__(self, key: Hashable, block: Callable[..., None], *arguments: Any) -> None:
        """Launch the recording of a step, or run the step."""
        if key in self._checked or self._known.get(key) is None:
            super().__call__(key, block, *arguments)
            return
        arrays, counted = self._stepper.arrays(), dict(self._counters)
        restore = self._stepper.restore_point()
        super().__call__(key, block, *arguments)
        self._checked.add(key)
        repeated = [array.numpy().copy() for array in arrays.values()]
        self._counters.update(counted)
        restore()
        self._stepper.advance()
        for (name, array), values in zip(arrays.items(), repeated, strict=True):
            if not np.array_equal(array.numpy(), values, equal_nan=True):
                raise ConfigError(
                    f"stepper {self._stepper.name}: a recorded step gives another {name} than the"
                    " step itself: `advance` does work on the host, depends on the time or changes"
                    " arrays that `memory` does not name; leave out `repeats_from`"
                )
