"""The request of a sweep: one frozen object, from flags, a recipe in TOML, or Python."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from inspect import signature
from itertools import product
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import AfterValidator, BeforeValidator, Field

from swe_sphere.equations.scene import LARGEST_COUNT, Scene
from swe_sphere.errors import ConfigError, unknown_name
from swe_sphere.files.user_file import is_custom, is_user_file
from swe_sphere.settings import values as reading
from swe_sphere.settings.registry import file_or_name
from swe_sphere.simulation import config
from swe_sphere.simulation.build import check_mesh, make_scene
from swe_sphere.simulation.config import NumberOrText, RunConfig, SharedConfig, make_config, or_auto
from swe_sphere.simulation.diagnostics import DIAGNOSTICS
from swe_sphere.solvers.preconditioners import PRECONDITIONERS
from swe_sphere.steppers import STEPPERS, get_stepper
from swe_sphere.studies.jobs import MOST_JOBS


def _listed(value: object) -> tuple[object, ...]:
    """Return a comma-separated list, one value or several of them, as a tuple."""
    if isinstance(value, str):
        if not (names := reading.names_in(value)):
            raise ValueError("must not be empty")
        return tuple(names)
    value = value.tolist() if hasattr(value, "tolist") else value
    if not isinstance(value, list | tuple | range):
        return (value,)
    parts = (_listed(item) if isinstance(item, str) else (item,) for item in value)
    return tuple(part for several in parts for part in several)


def stepper_names(value: object) -> tuple[str, ...]:
    """Return names of steppers from names, families, files and classes."""
    names = []
    for item in _listed(value):
        if family := [name for name, kind in STEPPERS.items() if kind.family == item]:
            names += family
            continue
        named = str(item) if isinstance(item, str | Path) else file_or_name(item)
        if not (isinstance(item, str | Path) or is_user_file(named) or STEPPERS.get(named) is item):
            raise ValueError("must be names, files or classes of steppers, each as last defined")
        names.append(STEPPERS.aliases.get(named, named))
    return tuple(dict.fromkeys(names))  # a stepper may be of a family that is named too


def _of_folder(name: str) -> str:
    """Return the name; ValueError for a path out of the folder of a recipe, or a file in it."""
    is_path = Path(name).name != name or name == ".." or "\0" in name
    if is_path or len(name.encode()) > 200 or name.endswith((".html", ".md", ".svg")):
        raise ValueError("must be the name of a folder")
    return name


T = TypeVar("T")
Listed = Annotated[tuple[T, ...], BeforeValidator(_listed)]
Count = Annotated[config.WholeOrText, Field(ge=0, le=LARGEST_COUNT)]
Steps = Annotated[
    Literal["auto"] | tuple[float, ...],
    or_auto(Annotated[Listed[NumberOrText], Field(min_length=1)], "positive numbers of seconds"),
]


class SweepPlan(SharedConfig):
    """A grid of runs, or a search, on one scene; empty or None ne, np and days are the scene's.

    The names are those of the flags of `swe-sphere sweep` and of the keys of a recipe, with `_` for
    `-` (`settings` is `--set`); `name`, `slow` and `spin` have no flag.
    """

    scene: str
    """Name of a scene, or a .py or .toml file with one."""
    steppers: Annotated[tuple[str, ...], BeforeValidator(stepper_names), Field(min_length=1)]
    """Steppers to compare: names, files, or families (explicit, imex, exponential, implicit)."""
    dt: Steps = "auto"
    """Time steps [s] of every stepper; auto (the default): a sequence for each."""
    levels: Annotated[config.Whole, Field(ge=1, le=20)] = 6
    """Number of steps in the sequence of auto."""
    ne: Listed[Count] = ()
    """Elements along an edge of the cube."""
    np: Listed[Count] = ()
    """Nodes along an edge of an element."""
    precision: Annotated[Listed[Literal["float64", "float32"]], Field(min_length=1)] = ("float64",)
    """float64, float32 or both."""
    preconditioner: Listed[str] = ()
    """Preconditioners of implicit steppers."""
    tolerance: Annotated[config.Number, Field(ge=0.0, lt=1.0)] | None = None
    """Solver tolerance of all but explicit steppers, relative to a step's change."""
    days: Annotated[config.Days, Field(gt=0.0)] | None = None
    """Length of the runs [days]."""
    report_days: Listed[NumberOrText] = ()
    """Times at which errors are measured [days], in addition to the end."""
    repeats: Annotated[config.Whole, Field(ge=1, le=100)] = 3
    """Minimum number of timed runs of a setting; more while the two shortest differ by over 3 %."""
    jobs: Annotated[config.Whole, Field(ge=1, le=MOST_JOBS)] = 1
    """Number of parallel processes; with more than one, runs give errors only and no times."""
    time_limit: config.Positive | None = None
    """Wall time of the steps of one run [s]."""
    budget: config.Positive | None = None
    """Wall time of the steps of all runs together, with reference runs [s]; for target-error."""
    find_limit: bool = False
    """Also search for the longest stable step of every stepper, to 2 %."""
    target_error: Listed[NumberOrText] = ()
    """Search for the longest step with each of these errors instead of running a grid."""
    target_kind: Literal["auto", "time", "total", "slow"] = "auto"
    """Kind of error; auto: total where it is known, otherwise time."""
    target_field: Literal["h", "v", "vorticity"] = "h"
    """Field of the error; v: the wind."""
    target_norm: Literal["l1", "l2", "linf"] = "l2"
    """Norm of the error."""
    reference: Listed[config.FileName] = ()
    """Lat-lon reference solution of a report day; repeatable."""
    slow: bool | None = None
    """Compute the slow-flow error; the default is true if the initial state sheds waves."""
    settings: reading.Settings = ()
    """Change an effect or the scene; repeatable."""
    name: Annotated[str, AfterValidator(_of_folder)] = ""
    """Name of its folder in a recipe; empty: the name of the scene."""

    def run_config(self, **values: object) -> RunConfig:
        """Return the configuration of one run of the sweep; values that are None are omitted."""
        whole = self.model_dump(include={*SharedConfig.model_fields, "scene", "settings"}) | values
        return make_config({name: value for name, value in whole.items() if value is not None})


def make_plan(values: Mapping[str, object], scene: Scene | None = None) -> SweepPlan:
    """Return the plan of these values, checked as far as possible without computing.

    scene: one that replaces the named one. Raises ConfigError for an unknown name or unfit value.
    """
    plan = reading.validate(SweepPlan, values)
    _check_options(plan)
    made = make_scene(plan.run_config(), scene)
    takes = {x for name in plan.steppers for x in signature(get_stepper(name)).parameters}
    for name in plan.preconditioner:
        PRECONDITIONERS.find(name)
    for name in ("tolerance", "preconditioner"):
        if getattr(plan, name) not in (None, ()) and name not in takes:
            raise ConfigError(f"{name}: none of the steppers has this option: leave it out")
    for ne, points in product(plan.ne or (made.ne,), plan.np or (made.np,)):
        check_mesh(plan.run_config(ne=ne, np=points), made)
    days = made.days if plan.days is None else plan.days
    if late := [day for day in plan.report_days if day > days + 1e-6]:
        raise ConfigError(f"report-days: day {late[0]:g} is after the end, day {days:g}")
    for path in plan.reference:
        if not path.is_file():
            raise ConfigError(f"reference: there is no file {path}")
    if plan.jobs > 1:
        _check_jobs(plan, scene)
    return plan


def _check_options(plan: SweepPlan) -> None:
    """Raise ConfigError for an option without any effect."""
    for name in plan.model_fields_set & {*(GRID if plan.target_error else SEARCH)}:
        if getattr(plan, name) not in (None, SweepPlan.model_fields[name].default):
            flag, other = reading.flag_of(name), "a grid" if plan.target_error else "a search"
            advice = "leave out target-error" if plan.target_error else "give target-error"
            raise ConfigError(f"{flag}: only {other} uses it: {advice}, or leave it out")
    chosen = plan.target_field if "target_field" in plan.model_fields_set else "vorticity"
    if plan.target_kind == "slow" and chosen != "vorticity":
        raise ConfigError("target-field: the slow-flow error is of vorticity: leave it out")


def _check_jobs(plan: SweepPlan, own: Scene | None) -> None:
    """Raise ConfigError for settings that other processes do not have or cannot share."""
    if plan.budget is not None:
        raise ConfigError("jobs: processes cannot share a budget: leave jobs or budget out")
    if plan.device != "cpu":
        raise ConfigError("jobs: runs on a GPU run one after the other: leave jobs out")
    kinds = [get_stepper(name) for name in plan.steppers if not is_user_file(name)]
    theirs = [kind.name for kind in kinds if is_custom(kind)]
    if made_here := [own.name] if own else [*theirs, *DIAGNOSTICS]:
        raise ConfigError(
            f"jobs: other processes cannot import {made_here[0]}, which is defined in this one:"
            " leave jobs out, or put scenes and steppers into files and give their names"
        )


GRID, SEARCH = ("dt", "levels"), ("budget", "target_field", "target_kind", "target_norm")
"""Options that only a grid of runs uses, and those that only a search for an error uses."""
RECIPES = Path(__file__).with_name("recipes")


@dataclass(frozen=True)
class Recipe:
    """Sweeps that belong together."""

    title: str
    sweeps: tuple[dict[str, Any], ...]
    """Values of the plan of each sweep, with the names of `SweepPlan`."""
    introduction: str = ""
    """Markdown at the top of README.md."""
    notes: Mapping[str, str] = field(default_factory=dict)
    """Markdown by folder: replaces the headline in README.md, follows the results in index.html."""

    def plans(self, flags: Mapping[str, object]) -> list[SweepPlan]:
        """Return the plans; values of flags replace the recipe's.

        A scene among them chooses the sweeps of that scene.  Raises ConfigError for a scene that
        the recipe does not have, and as `make_plan`.
        """
        scene = flags.get("scene")
        chosen = [values for values in self.sweeps if scene in (None, values.get("scene"))]
        if not chosen:
            scenes = ", ".join(str(values.get("scene")) for values in self.sweeps)
            raise ConfigError(f"the recipe has no scene {scene!r}; it has {scenes}")
        plans = [make_plan(reading.override(values, flags)) for values in chosen]
        unnamed = {plan.model_copy(update={"name": ""}).model_dump_json() for plan in plans}
        if len(unnamed) < len({plan.model_dump_json() for plan in plans}):
            raise ConfigError("a flag sets what [sweep.each] of the recipe varies: leave it out")
        asked: dict[str, tuple[object, ...]] = {}
        for plan in plans:
            mine = plan.days, plan.target_error, plan.target_kind, plan.target_field
            if asked.setdefault(folder := folder_of(dict(plan)), mine) != mine:
                raise ConfigError(f"sweeps {folder} differ in days or target: give each a name")
        return plans


def load_recipe(name: str) -> Recipe:
    """Return the recipe of that name, or in the TOML file of that path.

    A file has a `title`, perhaps an `introduction`, keys that all sweeps share, and for each a
    table [[sweep]], perhaps with a `note`; or just the keys of one sweep. Sweeps of one scene share
    a folder unless their `name` differs. A table [sweep.each] with lists by key makes a sweep of
    every combination, whose values are appended to the name. ConfigError if it cannot be read.
    """
    path = Path(name)
    if path.suffix != ".toml":
        if name not in (known := sorted(each.stem for each in RECIPES.glob("*.toml"))):
            raise unknown_name("recipe", name, known)
        path = RECIPES / f"{name}.toml"
    table = reading.read_toml(path)
    title, introduction = str(table.pop("title", path.stem)), str(table.pop("introduction", ""))
    sweeps = table.pop("sweep", [{}])
    if not isinstance(sweeps, list) or not all(isinstance(each, dict) for each in sweeps):
        raise ConfigError(f"{path}: sweeps are tables [[sweep]]")
    single, notes = [], dict[str, str]()
    for each in sweeps:
        note = each.pop("note", None)
        made = [*_combinations(path, reading.merged(table, each))]
        single += [reading.by_field(one) for one in made]
        notes |= {} if note is None else dict.fromkeys(map(folder_of, made), str(note))
    return Recipe(title, tuple(single), introduction, notes)


def folder_of(sweep: Mapping[str, Any]) -> str:
    """Return the name of the folder of these values of a plan in the folder of a recipe."""
    return str(sweep.get("name") or Path(str(sweep.get("scene"))).stem)


def _combinations(path: Path, sweep: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield a sweep for every combination of the lists in its table `each`, named after it.

    Keys with a dot are settings; an empty text among the values omits the key.
    """
    each = sweep.pop("each", {})
    if not isinstance(each, dict) or not all(isinstance(of, list) and of for of in each.values()):
        raise ConfigError(f"{path}: [sweep.each] has a list of values for each key")
    for values in product(*each.values()):
        chosen = {key: value for key, value in zip(each, values, strict=True) if value != ""}
        words = [f"{key.rpartition('.')[2]}{value}" for key, value in chosen.items()]
        settings = [*reading.read_settings(sweep.get("set", ()))]
        settings += reading.read_settings(
            {key: value for key, value in chosen.items() if "." in key}
        )
        made = sweep | {key: value for key, value in chosen.items() if "." not in key}
        if each:
            made["name"] = "-".join([folder_of(sweep), *words])
        yield made | ({"set": settings} if settings else {})
