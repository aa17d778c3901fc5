"""Elements on the rim of a rank apart from those away from it, so that messages take no time.

What elements leave on the rim is on its way while the others are computed.
"""

from typing import Any

import warp as wp

from swe_sphere.operators.halo import Halo
from swe_sphere.operators.launch import REMEMBERED, Launcher

LEAST = 32
"""Groups of elements away from the rim from which on two launches are worth while: more than a
matrix of any order has rows, so that arrays on elements are known by their length."""


class Rim:
    """Launches kernels over `groups` of elements in two: those behind the first `away`, then these.

    Arrays on elements are those of at least two dimensions with a row for each group.
    """

    def __init__(self, groups: int, away: int) -> None:
        self._groups, self._away = groups, away if away >= LEAST else 0
        self._known: dict[int, tuple[Any, Any]] = {}

    def launch(
        self, launch: Launcher, kernel: Any, each: tuple[int, ...], arguments: Any, halo: Halo
    ) -> None:
        """Compute all elements and exchange what they leave; each: threads of a group."""
        if not self._away:
            launch(kernel, (self._groups, *each), *arguments)
            halo()
            return
        behind = map(self._behind, arguments)
        launch(kernel, (self._groups - self._away, *each), *behind)
        halo.start()
        launch(kernel, (self._away, *each), *arguments)
        halo.wait()

    def _behind(self, argument: Any) -> Any:
        """An argument of a kernel as it is for the groups behind the first ones."""
        if not (self._is_on_elements(argument) or hasattr(argument, "cls")):
            return argument
        if id(argument) not in self._known:
            if len(self._known) >= REMEMBERED:
                self._known.clear()
            self._known[id(argument)] = argument, self._cut(argument)
        return self._known[id(argument)][1]

    def _is_on_elements(self, argument: Any) -> bool:
        is_table = isinstance(argument, wp.array) and argument.ndim > 1
        return is_table and argument.shape[0] >= self._groups

    def _cut(self, argument: Any) -> Any:
        if isinstance(argument, wp.array):
            return argument[self._away :]
        other = type(argument)()
        for name in argument.cls.__annotations__:
            value = getattr(argument, name)
            whole = name == "whole"  # groups from the first on
            setattr(other, name, max(value - self._away, 0) if whole else self._behind(value))
        return other
