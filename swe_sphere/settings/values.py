"""Conversion of user input, as text, in TOML or from Python, to values of the right type.

Settings read "owner.parameter=value"; the owner is an effect, the scene or the stepper.
"""

import operator
import tomllib
from collections.abc import Mapping
from functools import reduce
from pathlib import Path
from types import NoneType
from typing import Annotated, Any, Literal, NamedTuple, TypeVar, get_args, get_origin

from pydantic import BaseModel, BeforeValidator, ConfigDict, TypeAdapter, ValidationError

from swe_sphere.errors import ConfigError, shown, unknown_name
from swe_sphere.files.durable import contents_of

SCENE, STEPPER = "scene", "stepper"
"""Owners of settings that are not effects."""

FIELD_OWNERS = {"alpha": SCENE, "preconditioner": STEPPER, "tolerance": STEPPER}
"""Owners of the parameters for which a configuration also has a field."""

M = TypeVar("M", bound=BaseModel)

_FLAGS = {"settings": "set", "as_json": "json", "outputs": "output"}
"""Flags, and tables of files, whose names differ from their fields."""
_NOUNS = {float: "a number", int: "a whole number", bool: "true or false"}
_DEFAULT = "default"
"""Word that stands for None if None is a choice."""


def names_in(text: str | None) -> list[str]:
    """Return the names in a list A,B,..."""
    return [name.strip() for name in (text or "").split(",") if name.strip()]


class Setting(NamedTuple):
    """A value for one parameter of an effect, of the scene or of the stepper."""

    owner: str
    """Name of an effect, `SCENE` or `STEPPER`."""
    parameter: str
    value: Any
    """The value, or text that can be read as such; None for the default."""

    def __str__(self) -> str:
        return f"{self.owner}.{self.parameter}={_DEFAULT if self.value is None else self.value}"


def read_settings(given: object) -> tuple[Setting, ...]:
    """Return the settings in texts "owner.parameter=value", or in a table by owner.

    Args:
        given: one text, a list of texts and settings, or a mapping: {"owner": {"parameter": value}}
            as in TOML, or {"owner.parameter": value}.

    Raises ConfigError for a text or a mapping of another form.
    """
    try:
        items: Any = [given] if isinstance(given, str) else given
        if isinstance(given, Mapping):
            items = []
            for key, value in given.items():
                if value == {} and key not in (SCENE, STEPPER):
                    raise ConfigError(f"set.{key} is empty: give a parameter, or leave it out")
                if isinstance(value, Mapping):
                    items += [(str(key), name, of) for name, of in value.items()]
                else:
                    items.append((*str(key).split(".", 1), value))
        return tuple(map(_setting, items))
    except (TypeError, ValueError):
        choice = "a list of EFFECT.PARAMETER=VALUE"
        if isinstance(given, Mapping):
            choice = "tables [set.EFFECT] of parameters, or EFFECT.PARAMETER=VALUE"
        raise ConfigError(f"{flag_of('settings')}: must be {choice}, got {shown(given)}") from None


Settings = Annotated[tuple[Setting, ...], BeforeValidator(read_settings)]


def _setting(item: Any) -> Setting:
    if not isinstance(item, str):
        owner, parameter, value = item
        if getattr(value, "ndim", None) == 0 and hasattr(value, "item"):
            value = value.item()  # the number in an array without dimensions, as JSON needs it
        return Setting(owner, parameter, str(value) if isinstance(value, Path) else value)
    key, _, value = item.partition("=")
    owner, _, parameter = (part.strip() for part in key.partition("."))
    if not (owner and parameter and value.strip()):
        known = owner if owner in (SCENE, STEPPER) else "effect"
        raise ConfigError(f"a setting must read {known}.parameter=value, got {item!r}")
    return Setting(owner, parameter, value.strip())


def merged(table: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return the table with changes; tables within it are merged too."""
    both = [k for k in changes if all(isinstance(x.get(k), Mapping) for x in (table, changes))]
    return {**table, **changes, **{k: merged(table[k], changes[k]) for k in both}}


def override(values: Mapping[str, Any], by: Mapping[str, Any]) -> dict[str, Any]:
    """Return values by field with those of another table in their place, settings one by one.

    A field and a setting of the same parameter (`FIELD_OWNERS`) replace one another.
    """
    old, new = (read_settings(table.get("settings") or ()) for table in (values, by))
    replaced = {setting[:2] for setting in new}
    replaced |= {(owner, name) for name, owner in FIELD_OWNERS.items() if name in by}
    found = {k: value for k, value in values.items() if (FIELD_OWNERS.get(k), k) not in replaced}
    found.update(by)
    if old or new:
        found["settings"] = (*(one for one in old if one[:2] not in replaced), *new)
    return found


def convert(label: str, kind: Any, value: object, finite: bool = True) -> Any:
    """Return the value converted to the type of an annotation.

    Args:
        label: purpose of the value, which begins the message.
        kind: float, int, bool, str, Path, `Literal[...]` of words or numbers, or one of these
            `| None`, where "default" stands for None.
        value: a value, or text that can be read as such.
        finite: True if numbers must be finite.

    Raises ConfigError if the value cannot be read.
    """
    given = value.strip() if isinstance(value, str) else value
    other = ""
    if NoneType in get_args(kind):
        if given is None or str(given).lower() == _DEFAULT:
            return None
        kind = reduce(operator.or_, (each for each in get_args(kind) if each is not NoneType))
        other = f" or {_DEFAULT!r}"
    expected = f"must be {_NOUNS.get(kind)}"
    if get_origin(kind) is Literal:
        words = {str(word).lower(): word for word in get_args(kind)}
        if (word := str(given).lower()) in words:
            return words[word]
        expected = f"must be one of {', '.join(map(str, get_args(kind)))}"
    elif not (isinstance(given, bool) and kind in (float, int)):
        config = ConfigDict(allow_inf_nan=not finite, coerce_numbers_to_str=True)
        try:
            return TypeAdapter(kind, config=config).validate_python(given)
        except ValidationError as error:
            if kind not in _NOUNS:
                expected = complaint(error)
            elif kind is float and "finite" in complaint(error):
                expected = "must be finite"
    raise ConfigError(f"{label} {expected}{other}, got {shown(value)}")


def complaint(error: ValidationError) -> str:
    """Return the condition that a value must meet: the first error that pydantic finds."""
    first = error.errors(include_url=False)[0]
    plain = {"too_short": "must not be empty", "path_type": "must be the path of a file"}
    if first["type"] in plain:
        return plain[first["type"]]
    return str(first["msg"]).removeprefix("Value error, ").replace("Input should", "must")


def place_and_complaint(error: ValidationError) -> str:
    """Return the first error in the tables of a file, after its position."""
    where = ".".join(str(part) for part in error.errors(include_url=False)[0]["loc"])
    return f"{where}: {complaint(error)}" if where else complaint(error)


def validate(model: type[M], values: Mapping[str, object]) -> M:
    """Return an instance of the model with these values, converted and checked.

    Raises ConfigError for an unknown name or an unfit value, in one line that names the flag.
    """
    try:
        return model.model_validate(dict(values))
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        name = flag_of(str(first["loc"][0])) if first["loc"] else "configuration"
        if name == "output" and len(first["loc"]) > 2:
            name = f"{name}: {first['loc'][2]}"
        line = f"{name}: {complaint(error)}, got {shown(first['input'])}"
        if first["type"] == "extra_forbidden":
            raise unknown_name("option", str(first["loc"][0]), sorted(model.model_fields)) from None
        if first["type"] == "missing":
            line = f"{name}: name one to run (see swe-sphere list)"
        raise ConfigError(line) from None


def flag_of(field: str) -> str:
    """Return the name of a field on the command line."""
    return _FLAGS.get(field, field.replace("_", "-"))


def by_field(table: Mapping[str, Any]) -> dict[str, Any]:
    """Return a table by the names of fields from one by the names of flags."""
    fields = {flag: field for field, flag in _FLAGS.items()}
    found = dict[str, Any]()
    for key, value in table.items():
        if (field := fields.get(key, key.replace("-", "_"))) in found:
            raise ConfigError(f"{key} is given twice, under two names: leave one out")
        found[field] = value
    return found


def read_toml(path: Path) -> dict[str, Any]:
    """Return the table in a file in UTF-8; ConfigError if it cannot be read or is not TOML."""
    try:
        if b"\0" in contents_of(path):
            raise ConfigError(f"{path} is not in UTF-8 but in UTF-16, or no text: save it in UTF-8")
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise ConfigError(f"cannot read {path}: {error.strerror}") from None
    except ValueError as error:  # also of text that is not UTF-8, and of endless numbers
        raise ConfigError(f"{path} is not valid TOML: {error}") from None
    except RecursionError:
        raise ConfigError(f"{path} is nested too deeply") from None
