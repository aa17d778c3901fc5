"""One simulation: a scene on a mesh with a stepper, from its start to wherever it is taken."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from swe_sphere.equations.scene import Scene
from swe_sphere.errors import ConfigError, RunFailed
from swe_sphere.mesh import Mesh
from swe_sphere.settings.values import validated
from swe_sphere.simulation.callbacks import intervals, scheduled
from swe_sphere.simulation.config import RunConfig, make_config
from swe_sphere.simulation.execution import execute, summary_of
from swe_sphere.simulation.progress import Watcher, notebook
from swe_sphere.simulation.recorder import attributes_of, save
from swe_sphere.simulation.restart import check_paths, configured
from swe_sphere.simulation.running import Running
from swe_sphere.simulation.summary import Summary, html_table
from swe_sphere.simulation.supplied import Supplied, supply

if TYPE_CHECKING:
    import xarray as xr
    from cartopy.mpl.geoaxes import GeoAxes

    from swe_sphere.equations.effects import Effect

PER_RUN = {
    "out": "run()", "overwrite": "run()", "plot": "plot()", "restart": "from_checkpoint()",
    "live": "swe-sphere run", "as_json": "swe-sphere run", "quiet": "swe-sphere run",
}  # fmt: skip
"""Fields of a configuration that are those of one run of a simulation, and what takes them."""


class Simulation(Running):
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
    """The file that was written last."""

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
        _check_settings(settings)
        super().__init__(*supply(
            scene, stepper=stepper, mesh=mesh, preconditioner=preconditioner, effects=effects,
            parameters=parameters, options=options, **settings,
        ))  # fmt: skip

    @classmethod
    def from_config(cls, config: RunConfig, supplied: Supplied | None = None) -> Self:
        """The simulation that a configuration asks for, also one that goes on from a restart.

        supplied: objects that stand behind its names.
        """
        sim = cls.__new__(cls)
        Running.__init__(sim, config, supplied or Supplied())
        return sim

    @classmethod
    def from_checkpoint(cls, path: str | Path, scene: Any = None, **settings: Any) -> Self:
        """Go on from a checkpoint, or from the last frame of a run's file, bit for bit.

        scene: needed if it was given as an object.  settings: as for the class; a run that goes on
        has the stepper, the mesh and the effects it had.

        Raises:
            ConfigError: the file is missing or damaged, or of another run than what is asked for.
        """
        from swe_sphere.io.checkpoint import read_checkpoint  # netCDF4 takes its time to import

        _check_settings(settings)
        checkpoint = read_checkpoint(path)
        scene = scene or str(configured(path, checkpoint)["scene"])
        config, supplied = supply(scene, **settings, restart=Path(path))
        sim = cls.__new__(cls)
        Running.__init__(sim, config, supplied, checkpoint)
        return sim

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
        callbacks: Iterable[Any] = (),
        time_limit: float | None = None,
        overwrite: bool = False,
        progress: bool | None = None,
        watcher: Watcher | None = None,
    ) -> Summary:
        """Step to the end of the run, or until something comes in the way.

        Args:
            days: length of the run from its very start [days].
            out: a file to write frames, series of diagnostics and checkpoints to; the one that this
                simulation wrote last is gone on with.
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
        asked = {"days": days, "every": every, "time_limit": time_limit, "out": out}
        asked["overwrite"] = overwrite or None
        place = None if out is None else Path(out).resolve()
        if place is not None and place == self._out:
            asked["restart"] = out
        of_one = ("out", "overwrite", "plot", "live")
        kept = {k: v for k, v in self.configured.given().items() if k not in of_one}
        config = make_config(kept | {k: value for k, value in asked.items() if value is not None})
        calls = scheduled(callbacks)
        self.comm.on_root(lambda: check_paths(config))
        self.config = config
        self._check_reference()
        self.begin(also=intervals(calls))
        self._out = place or self._out
        watcher = watcher or (Watcher() if self.comm.rank else notebook(progress))
        self._own.warn = watcher.warn
        self.outcome = execute(self, calls, watcher)
        return self.summary

    @property
    def summary(self) -> Summary:
        """The numbers of the state, and how the last run ended."""
        return summary_of(self, self.outcome)

    @property
    def state(self) -> xr.Dataset:
        """Depth, wind, vorticity, divergence and tracers on the nodes (N,), with their units."""
        return self.to_xarray().isel(time=0)

    def to_xarray(self) -> xr.Dataset:
        """The state as a frame of a run's file: fields on (time, node), points, areas, bottom."""
        from swe_sphere.analysis import accessor  # noqa: F401 - registers `ds.swe`
        from swe_sphere.io.runfile import frame_dataset

        fields = self.snapshot.with_constants | self.own_fields
        own = self.own_attributes()
        return frame_dataset(self.mesh, fields, self.time, attributes_of(self), own)

    def plot(self, field: str | None = None, ax: GeoAxes | None = None, **look: Any) -> GeoAxes:
        """Draw a field of the state on the globe; into `ax`, else into a figure of its own.

        field: h, surface, vorticity, speed, q_NAME, ...; None: what suits the scene.
        look: projection="robinson", winds="arrows", mesh=True, ...; see
        `swe_sphere.pictures.look.Look`.
        Raises ConfigError for a field that is not there.
        """
        from swe_sphere.pictures.look import Look
        from swe_sphere.pictures.plot import draw_state

        fields = self.snapshot.with_constants | self.own_fields
        return draw_state(
            self.mesh, fields, self.time, attributes_of(self), field, ax, validated(Look, look),
            about=self.own_attributes(),
        )  # fmt: skip

    def checkpoint(self, path: str | Path) -> Path:
        """Write all that is needed to go on from here bit for bit, with `from_checkpoint`.

        A checkpoint that is there already is replaced, and nothing else.
        Raises RunFailed where the disk refuses, ConfigError for a file of another kind.
        """
        return save(self, Path(path))

    def _repr_html_(self) -> str:
        return html_table(repr(self), self._rows())

    def _rows(self) -> list[tuple[str, str]]:
        """What a notebook shows; to look at a simulation does not begin it."""
        if self._stepper is None:
            return [("scene", self.scene.title), ("result", "not begun")]
        try:
            return list(self.summary.rows())
        except RunFailed as error:
            return [("scene", self.scene.title), ("why", str(error))]


def _check_settings(settings: Iterable[str]) -> None:
    for name in settings:
        if name in PER_RUN:
            raise ConfigError(f"{name} is no setting of a simulation: see {PER_RUN[name]}")
