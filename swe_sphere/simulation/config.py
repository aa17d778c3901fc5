"""The configuration of a run: one frozen object, from flags, a TOML file, or Python."""

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any, Literal, TypedDict

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, TypeAdapter

from swe_sphere.equations.scene import LARGEST_COUNT, LONGEST_DAYS
from swe_sphere.errors import ConfigError, shown, unknown_name
from swe_sphere.settings.values import FIELD_OWNERS, STEPPER, Settings, names_in, validate
from swe_sphere.simulation.planning import meant_hours


def or_auto(kind: Any, words: str) -> BeforeValidator:
    """Return a reader of "auto" or a value of that kind, also from text; words: for messages."""
    adapter = TypeAdapter(kind, config=ConfigDict(allow_inf_nan=False))

    def read(value: object) -> object:
        if isinstance(value, str) and value.strip().lower() == "auto":
            return "auto"
        try:
            return adapter.validate_python(value)
        except ValueError:
            raise ValueError(f"must be {words} or 'auto'") from None

    return BeforeValidator(read)


def _not_of(*kinds: type) -> BeforeValidator:
    """Return a check that rejects values of some types, which pydantic would convert to numbers."""

    def check(value: object) -> object:
        if isinstance(value, kinds):
            raise ValueError("must be a valid number")
        return value

    return BeforeValidator(check)


def _nameable(path: Path) -> Path:
    """Return the path; ValueError for one that no file can have, or that is not in UTF-8."""
    try:
        str(path).encode()
        with suppress(FileNotFoundError, NotADirectoryError):
            path.stat()
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or "it is not in UTF-8"
        raise ValueError(f"must be the name of a file ({why})") from None
    return path


FileName = Annotated[Path, AfterValidator(_nameable)]
Names = Annotated[
    tuple[str, ...], BeforeValidator(lambda x: names_in(x) if isinstance(x, str) else x)
]
"""Names in a list, or in a text "h,u,v"."""
Number = Annotated[float, _not_of(bool, str)]
Positive = Annotated[Number, Field(gt=0.0)]
Whole = Annotated[int, _not_of(bool, str), Field(ge=-LARGEST_COUNT, le=LARGEST_COUNT)]
Days = Annotated[Number, Field(ge=0.0, le=LONGEST_DAYS)]
Hours = Annotated[Positive, Field(le=24.0 * LONGEST_DAYS)]
NumberOrText = Annotated[float, _not_of(bool), Field(gt=0.0)]
"""A positive number, also as text."""
WholeOrText = Annotated[int, _not_of(bool)]
TimeStep = Annotated[float | Literal["auto"], or_auto(NumberOrText, "a positive number of seconds")]
Count = Annotated[
    int | Literal["auto"], or_auto(Annotated[WholeOrText, Field(gt=0)], "a whole number from 1 on")
]


@dataclass(frozen=True)
class Output:
    """A further file of a run, with its own fields, times and grid; the run checks the values.

    Examples:
        >>> from swe_sphere import Output, Simulation
        >>> wind = Output("wind.nc", every=6, fields="u,v", grid="latlon:19x36")
        >>> sim = Simulation("williamson2", ne=2, np=4, dt=3600)
        >>> sim.run(days=0.5, outputs=[wind], overwrite=True).status
        'completed'
    """

    path: Annotated[FileName, AfterValidator(Path.absolute)]
    """Name of the file: netCDF, or a Zarr store if it ends in .zarr."""
    every: Annotated[Hours, AfterValidator(lambda h: float(meant_hours(h)))] | None = None
    """Time between frames [h]; None: the times of the frames of the run."""
    fields: Names = ()
    """Fields to write, as in `RunConfig.fields`."""
    grid: str | None = None
    """latlon:ROWSxCOLUMNS or gaussian:N; None: the nodes of the mesh."""


def _outputs(given: Any) -> object:
    """Return a list of outputs or tables; ConfigError for an unknown key or another type."""
    known = [field.name for field in fields(Output)]
    is_list = isinstance(given, Iterable) and not isinstance(given, str | Mapping)
    found = [*given] if is_list else [given]
    for each in found:
        if not isinstance(each, Output | Mapping):
            raise ConfigError(f"output: must be a list of outputs, got {shown(given)}")
        for name in each if isinstance(each, Mapping) else ():
            if name not in known:
                raise unknown_name("option of output", name, known)
        if isinstance(each, Mapping) and "path" not in each:
            raise ConfigError("output: give a path, the name of the file")
    return found


class SharedConfig(BaseModel):
    """Settings that all runs of a study share: refined and rotated mesh, machine."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", allow_inf_nan=False, use_attribute_docstrings=True,
        revalidate_instances="always",
    )  # fmt: skip

    stretch: Number = 1.0
    """Schmidt refinement: factor by which the mesh is refined at the centre."""
    centre_lon: Number = 0.0
    """Longitude of the centre [degrees]."""
    centre_lat: Number = 0.0
    """Latitude of the centre [degrees]."""
    spin: Number = 0.0
    """Rotation of the cube about the centre [degrees]."""
    alpha: Number | None = None
    """Scene parameter alpha: angle between the flow and the equator [rad]."""
    device: str = "cpu"
    """Device to run on."""
    launch: Literal["element", "node"] | None = None
    """Shape of kernel launches: a thread for each element or for each node."""
    tracer_steps: Count = 1
    """Flow steps for each tracer step; auto: as many as the tracer limit allows."""


class RunConfig(SharedConfig):
    """All options of `swe-sphere run`; None stands for a default of the scene or of the option.

    The names are those of the flags (and of the keys of a `--config` file), with `_` for `-`,
    except for `settings`, which is `--set`, `as_json`, which is `--json`, and `outputs`, which a
    file alone can give, as `[[output]]`. Scene, stepper, mesh and device are checked when built.
    """

    scene: str
    """Name of a scene, or a .py or .toml file with one."""
    stepper: str = "rk4"
    """Time integrator, by name, or a .py file with one."""
    preconditioner: str | None = None
    """Preconditioner of an implicit stepper, by name, or a .py file with one."""
    tolerance: Annotated[Number, Field(ge=0.0, lt=1.0)] | None = None
    """Solver tolerance of all but explicit steppers, relative to a step's change."""
    dt: TimeStep = "auto"
    """Time step [s]. auto (the default): a safe fraction of the stability limit; for implicit
    steppers advective Courant number 2 and at most an hour, for exponential ones 0.15 to 0.5 and
    at most three hours. With adaptive: the longest step, by default the time between frames.
    """
    adaptive: Positive | None = None
    """Adapt the step to this tolerance of its estimated error, relative to the state."""
    days: Days | None = None
    """Length of the run since the initial state [days]; 0 writes the initial state only."""
    ne: Whole | None = None
    """Elements along an edge of the cube."""
    np: Whole | None = None
    """Nodes along an edge of an element."""
    precision: Literal["float64", "float32"] = "float64"
    """Number type of the state."""
    settings: Settings = ()
    """Change an effect (viscosity.nu=1e5), the scene (scene.alpha=0.5) or an option of the stepper
    (stepper.tolerance=1e-4); repeatable."""
    diagnostics: tuple[FileName, ...] = ()
    """Python file with custom diagnostics; repeatable."""
    out: FileName | None = None
    """Output file: netCDF, or a Zarr store if it ends in .zarr."""
    fields: Names = ()
    """Fields to write: h, u, v, vorticity, divergence, q_TRACER, custom ones (default: all of
    these), potential_vorticity, potential_vorticity_anomaly, kinetic_energy."""
    outputs: Annotated[tuple[Output, ...], BeforeValidator(_outputs)] = ()
    """Further files, each with fields, a grid and times of its own; tables [[output]] in TOML."""
    overwrite: bool = False
    """Replace existing files."""
    every: Hours | None = None
    """Time between frames [h] (about a day)."""
    plot: FileName | None = None
    """Draw the last frame."""
    live: str | None = None
    """Draw this field in the terminal during the run; auto selects a suitable one."""
    restart: FileName | None = None
    """Resume the run in this file; out may name the same file."""
    trust: Annotated[tuple[FileName, ...], Field(exclude=True)] = ()
    """File whose code may be executed if the file of a run names it; repeatable."""
    initial: FileName | None = None
    """Begin a new run from a frame of this file; mesh, step, stepper and effects may differ."""
    initial_time: Days | None = None
    """Time of that frame in its file [days] (the last frame)."""
    reference: FileName | None = None
    """Reference solution on a lat-lon grid at the final time, for errors."""
    time_limit: Positive | None = None
    """Wall time of the command [s], start-up, compiling and writing included; the run then ends
    with a last frame, from which it can be resumed."""
    energy_growth: Positive | None = None
    """End the run as unstable if the energy, forcing and relaxation apart, has grown by this factor
    (10; no limit with custom effects)."""
    log: FileName | None = None
    """Append all lines about the run to this file, with times and progress."""
    as_json: bool = False
    """Print the result as one line of JSON."""
    quiet: bool = False
    """Print errors only."""

    def settings_of(self, owner: str) -> dict[str, Any]:
        """Return the values set for an effect, for the scene or for the stepper, by parameter.

        Raises ConfigError for a value that is also set by a separate field, such as `alpha`.
        """
        values = {each.parameter: each.value for each in self.settings if each.owner == owner}
        for name in (name for name, of in FIELD_OWNERS.items() if of == owner):
            if (value := getattr(self, name)) is not None:
                if name in values:
                    raise ConfigError(f"{name} is given twice: by {name} and by set {owner}.{name}")
                values[name] = value
        return values

    @property
    def chosen_preconditioner(self) -> Any:
        """Preconditioner by its field or by a setting of the stepper; None if neither is set."""
        return self.settings_of(STEPPER).get("preconditioner")

    @property
    def scene_settings(self) -> Settings:
        """The settings without options of the stepper."""
        return tuple(each for each in self.settings if each.owner != STEPPER)

    def given(self) -> dict[str, Any]:
        """Return the requested values, without the defaults."""
        return {name: getattr(self, name) for name in sorted(self.model_fields_set)}


class Keywords(TypedDict, total=False):
    """Fields of `RunConfig` that `Simulation` accepts as keywords."""

    ne: int | None
    np: int | None
    stretch: float
    centre_lon: float
    centre_lat: float
    spin: float
    dt: float | Literal["auto"]
    days: float | None
    every: float | None
    adaptive: float | None
    tolerance: float | None
    tracer_steps: int | Literal["auto"]
    alpha: float | None
    settings: Mapping[str, object] | Sequence[str]
    fields: str | Sequence[str]
    outputs: Sequence[Output]
    diagnostics: Sequence[str | Path]
    initial_time: float | None
    reference: str | Path | None
    energy_growth: float | None
    time_limit: float | None
    trust: Sequence[str | Path]
    device: str
    precision: Literal["float64", "float32"]
    launch: Literal["element", "node"] | None


def make_config(values: Mapping[str, object]) -> RunConfig:
    """Return the configuration of these values; raises the errors of `validate`."""
    return validate(RunConfig, values)
