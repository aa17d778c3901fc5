"""Classes by name, each put into its registry where it is defined."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, ClassVar, Protocol, TypeVar

from swe_sphere.errors import ConfigError, unknown_name

__all__ = ["Registry"]


class Named(Protocol):
    """A class with a name by which users call it."""

    name: ClassVar[str]


T = TypeVar("T", bound=Named)


class Registry(Mapping[str, type[T]]):
    """The classes of one kind by name, in an order of their own.

    A class defined in the same module as another of its name (a file loaded anew, a notebook's
    cell) takes its place.
    """

    def __init__(
        self,
        kind: str,
        order: Callable[[type[T]], Any] = lambda cls: 0,
        aliases: Mapping[str, str] | None = None,
    ) -> None:
        """kind: what they are, for messages; order: what to sort by before the order of definition;
        aliases: more names, by which `find` knows some of them."""
        self.kind, self.aliases, self._order = kind, aliases or {}, order
        self._classes: dict[str, type[T]] = {}

    def add(self, cls: type[T]) -> None:
        """Enter a class by its name; ConfigError where the name belongs to another."""
        there = self._classes.get(cls.name)
        if there is not None and there.__module__ != cls.__module__:
            raise ConfigError(
                f"there are two {self.kind}s of the name {cls.name!r}: in {there.__module__} and "
                f"in {cls.__module__}"
            )
        self._classes[cls.name] = cls

    def __getitem__(self, name: str) -> type[T]:
        """The class of that name."""
        return self._classes[name]

    def __iter__(self) -> Iterator[str]:
        """The names, in order."""
        return iter(sorted(self._classes, key=lambda name: self._order(self._classes[name])))

    def __len__(self) -> int:
        """How many there are."""
        return len(self._classes)

    def find(self, name: str) -> type[T]:
        """The class of that name or alias.

        Raises ConfigError, naming the nearest one, when there is none.
        """
        name_of_class = self.aliases.get(name, name)
        if name_of_class not in self._classes:
            raise unknown_name(self.kind, name, (*self, *self.aliases))
        return self._classes[name_of_class]
