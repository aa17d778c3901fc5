"""One simulation: a scene on a mesh with a stepper, from its start to wherever it is taken."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from swe_sphere.equations.scene import Scene
from swe_sphere.errors import ConfigError
from swe_sphere.mesh import Mesh
from swe_sphere.simulation.callbacks import Callback, intervals, scheduled
from swe_sphere.simulation.config import RunConfig, make_config
from swe_sphere.simulation.execution import execute
from swe_sphere.simulation.observed import Observed
from swe_sphere.simulation.output import check_out
from swe_sphere.simulation.progress import Notebook, Watcher
from swe_sphere.simulation.restart import (
    carried_counts,
    check_step,
    configured,
    save,
)
from swe_sphere.simulation.setup import check_paths
from swe_sphere.simulation.summary import Summary
from swe_sphere.simulation.supplied import Supplied, supply
from swe_sphere.simulation.time_plan import TimePlan, continued_plan, time_plan
from swe_sphere.user_file import users_code

if TYPE_CHECKING:

    from swe_sphere.equations.effects import Effect

__all__ = ["Simulation"]

PER_RUN = ("out", "plot", "overwrite")
"""Fields of a configuration that are those of one run of a simulation."""


class Simulation(Observed):
    """A scene, a mesh and a stepper, set up and stepped.

    Args:
        scene: the name of a scene, the path of a .py or .toml file with one, or a `Scene`.
        stepper: the name of a stepper, the path of a .py file with one, a class, or an instance
            on a model of its own (which then is the model of the simulation).
        mesh: in the place of ne, np, stretch, centre_lon, centre_lat and spin.
        preconditioner: of an implicit stepper, by name, path or class.
        effects: parameters {"viscosity.nu": 1e5}, or effects to add.
        parameters: of the scene, {"alpha": 0.8}.
        options: of the stepper, {"tolerance": 1e-6}.
        settings: further fields of `RunConfig`: ne, np, dt [s], days, every [h], device,
            precision, tolerance, adaptive, ...

    Examples:
        >>> from swe_sphere import Simulation
        >>> sim = Simulation("williamson2", ne=3, np=4, stepper="rk4", dt=1800)
        >>> summary = sim.run(days=1)
        >>> summary.status, summary["steps"], summary["l2_h"] < 1e-3
        ('completed', 48, True)
        >>> sim.step()
        >>> sim.time
        88200.0

    Raises:
        ConfigError: whatever cannot be done as asked for, in one line.
    """

    _out: Path | None = None
    """The file that the last run wrote."""

    def __init__(
        self,
        scene: str | Path | Scene,
        *,
        stepper: Any = "rk4",
        mesh: Mesh | None = None,
        preconditioner: Any = None,
        effects: Mapping[str, object] | Iterable[Effect] = (),
        parameters: Mapping[str, object] | None = None,
        options: Mapping[str, object] | None = None,
        **settings: Any,
    ) -> None:
        for name in (*PER_RUN, "restart", "as_json", "quiet"):
            if name in settings:
                raise ConfigError(f"{name} is no setting of a simulation: see run()")
        names, supplied = supply(scene, stepper, mesh, preconditioner, effects, parameters, options)
        super().__init__(_merged(names, settings), supplied)

    @classmethod
    def from_config(cls, config: RunConfig, supplied: Supplied | None = None) -> Self:
        """The simulation that a configuration asks for, also one that goes on from a restart.

        supplied: objects that stand behind its names.
        """
        sim = cls.__new__(cls)
        Observed.__init__(sim, config, supplied or Supplied())
        return sim

    @classmethod
    def from_checkpoint(cls, path: str | Path, scene: Any = None, **settings: Any) -> Self:
        """Go on from a checkpoint, or from the last frame of a run's file, bit for bit.

        scene: needed if it was given as an object.  settings: as for the class; a run that goes on
        has the stepper, the mesh and the effects it had.

        Raises:
            ConfigError: the file is missing or damaged, or of another run than what is asked for.
        """
        objects = {name: settings.pop(name, None) for name in ("mesh", "preconditioner")}
        names, supplied = supply(
            scene or str(configured(Path(path))["scene"]), settings.pop("stepper", None),
            **objects, effects=settings.pop("effects", ()),
            parameters=settings.pop("parameters", None), options=settings.pop("options", None),
        )  # fmt: skip
        return cls.from_config(_merged(names, {**settings, "restart": Path(path)}), supplied)

    def begin(self, plan: TimePlan | None = None, callbacks: Sequence[Callback] = ()) -> None:
        """Plan the steps up to the end; what has been stepped already keeps its length of steps.

        plan: the steps to take, in the place of those that the configuration asks for.

        Raises:
            ConfigError: step, length, frames and calls do not go together.
        """
        self._plan = plan or self._planned(intervals(callbacks))
        if self._stepper is None or self._stepper.steps == 0:
            self._make_stepper(self._plan.dt)

    def _planned(self, also: list[Fraction]) -> TimePlan:
        days, every = self.days, self.config.every
        stepper = self._stepper or self._supplied.instance
        if stepper is not None and (stepper.steps or self._supplied.instance):
            return continued_plan(days, every, stepper.dt, stepper.steps, also)
        if self._checkpoint is not None:
            dt, done = check_step(self.config, self._checkpoint), self._checkpoint.steps
            self.dt_rule = "that of the restart file"
            return continued_plan(days, every, dt, done, also)
        choice = self._choice()
        self.dt_rule = choice.rule
        return time_plan(days, every, choice.dt, also)

    def _make_stepper(self, dt: float) -> None:
        """Build the stepper, and put it at the start or where the restart stands."""
        supplied, checkpoint = self._supplied, self._checkpoint
        state = self.model.initial_state()
        self._before, self._seen = dict(self.model.counters), None
        with users_code():
            self._stepper = stepper = supplied.instance or self._new_stepper(dt)
            if checkpoint is not None:
                self._carried = carried_counts(checkpoint)
                stepper.load_state_dict(checkpoint.state_dict, checkpoint.steps)
            elif stepper.steps == 0:
                stepper.start(state)

    def step(self) -> None:
        """Take one step.

        Raises:
            RunFailed: it cannot be taken.
        """
        self.stepper.step()

    def run(
        self,
        days: float | None = None,
        *,
        out: str | Path | None = None,
        every: float | None = None,
        callbacks: Sequence[Any] = (),
        time_limit: float | None = None,
        overwrite: bool = False,
        progress: bool | None = None,
        watcher: Watcher | None = None,
    ) -> Summary:
        """Step to the end of the run, or until something comes in the way.

        Args:
            days: length of the run from its very start [days].
            out: a file to write frames, series of diagnostics and checkpoints to; the one that this
                simulation wrote before is gone on with.
            every: time between frames [h].
            callbacks: functions of the simulation: called after every step, or when
                `callbacks.every` says.
            time_limit: wall time that the steps may take [s].
            overwrite: replace the file `out` if it is there already.
            progress: whether to show a bar; None: in a notebook or on a terminal.

        Returns:
            How it went, also where it stopped early: see `Summary.status` and `reason`.

        Raises:
            ConfigError: it cannot be run as asked for; nothing was stepped.
        """
        asked = {"days": days, "every": every, "time_limit": time_limit}
        asked["overwrite"] = overwrite or None
        kept = {k: v for k, v in self.config.given().items() if k not in PER_RUN}
        kept |= {name: value for name, value in asked.items() if value is not None}
        if out is not None:
            kept |= {"out": Path(out)} | ({"restart": Path(out)} if Path(out) == self._out else {})
        self.config = make_config(kept)
        check_paths(self.config)
        check_out(self.config)
        calls = scheduled(callbacks)
        self.begin(callbacks=calls)
        self._out = self.config.out
        self._watcher = watcher or Notebook(progress)
        self.outcome = execute(self, calls, self._watcher)
        return self.summary

    def checkpoint(self, path: str | Path) -> Path:
        """Write all that is needed to go on from here bit for bit, with `from_checkpoint`.

        Raises RunFailed where the disk refuses.
        """
        return save(self, Path(path))


def _merged(names: dict[str, Any], settings: dict[str, Any]) -> RunConfig:
    """The configuration of what was given by name and as settings."""
    both = (*names.pop("settings"), *settings.pop("settings", ()))
    return make_config({**names, **({"settings": both} if both else {}), **settings})
