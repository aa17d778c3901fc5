"""Classes by name; each class registers itself where it is defined."""

from collections import UserDict
from collections.abc import Callable, Mapping
from inspect import isabstract
from pathlib import Path
from typing import Any, ClassVar, Protocol, TypeVar

from swe_sphere.errors import ConfigError, unknown_name
from swe_sphere.files.user_file import file_contents, is_user_file, load_file


class RegistryEntry(Protocol):
    """A class with a name that users type."""

    name: ClassVar[str]


T = TypeVar("T", bound=RegistryEntry)


def first_line(documented: Any) -> str:
    """Return the first line of a docstring; the empty text if there is none."""
    return next(iter((documented.__doc__ or "").strip().splitlines()), "")


def file_or_name(cls: Any) -> str:
    """Return what `Registry.find` accepts for a class: the file it was found in, or its name."""
    return str(getattr(cls, "__dict__", {}).get("found_in", getattr(cls, "name", cls)))


class Registry(UserDict[str, type[T]]):
    """The classes of one kind by name, in a defined order.

    A class that is defined again (a cell of a notebook) replaces the earlier one.

    Args:
        kind: kind of the classes, for messages.
        order: sort key; classes of the same key keep the order of their definition.
        aliases: names by other names, which `find` accepts too.
    """

    def __init__(
        self, kind: str, order: Callable[[type[T]], Any] = lambda cls: 0,
        aliases: Mapping[str, str] | None = None,
    ) -> None:  # fmt: skip
        super().__init__()
        self.kind, self.aliases, self._order = kind, aliases or {}, order
        self._files: dict[Path, tuple[bytes, type[T]]] = {}

    def add(self, cls: type[T]) -> None:
        """Register a class by its name; ConfigError if the name belongs to another."""
        there = self.get(cls.name, cls)
        if (there.__module__, there.__qualname__) != (cls.__module__, cls.__qualname__):
            raise ConfigError(
                f"class {cls.__qualname__}: there is a {self.kind} {cls.name!r} already, in"
                f" {there.__module__}: give it another name"
            )
        self[cls.name] = cls
        self.data = dict(sorted(self.data.items(), key=lambda named: self._order(named[1])))

    def find(self, which: str | Path | type[T]) -> type[T]:
        """Return the class of that name or alias, the one in that Python file, or the class itself.

        Raises ConfigError if there is none of that name (the message names the nearest), if the
        file fails or does not define exactly one, or if the class lacks methods.
        """
        if isinstance(which, type):
            found = which
        elif is_user_file(which):
            found = self._loaded(Path(which))
        else:
            if (name := self.aliases.get(str(which), str(which))) not in self:
                raise unknown_name(self.kind, str(which), (*self, *self.aliases))
            found = self[name]
        if not getattr(found, "name", ""):
            raise ConfigError(f"{self.kind} {found.__qualname__} has no name: define `name`")
        if isabstract(found):
            lacking = ", ".join(sorted(found.__abstractmethods__))
            raise ConfigError(f"{self.kind} {found.__qualname__} does not define {lacking}")
        return found

    def _loaded(self, path: Path) -> type[T]:
        """Return the class in a file, the same one as long as the file has not been edited.

        The class is not registered by name.
        """
        contents, before, place = file_contents(path, self.kind), self.data, path.resolve()
        if place not in self._files or self._files[place][0] != contents:
            self.data = dict(before)
            try:
                load_file(path, self.kind)
                found = [cls for name, cls in self.items() if before.get(name) is not cls]
            finally:
                self.data = before
            if len(found) != 1:
                names = ", ".join(cls.name for cls in found) or "none"
                raise ConfigError(
                    f"{path} must define one {self.kind}, a class with a name; it has {names}"
                )
            found[0].found_in = str(place)  # type: ignore[attr-defined]
            self._files[place] = contents, found[0]
        return self._files[place][1]
