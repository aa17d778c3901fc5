"""SIMD registers: their Warp types, and the C++ with which every native function begins."""

from dataclasses import dataclass
from typing import Any

import warp as wp

REGISTER_BYTES = 64


@dataclass(frozen=True)
class Register:
    """`lanes` numbers of the type `real` side by side, or a plain number where `lanes` is 1."""

    real: Any
    lanes: int = 1

    @property
    def value(self) -> Any:
        """Warp type of a register."""
        return wp.types.vector(self.lanes, self.real) if self.lanes > 1 else self.real

    @property
    def index(self) -> Any:
        """Warp type of a node number for each lane."""
        return wp.types.vector(self.lanes, wp.int32) if self.lanes > 1 else wp.int32

    def rows(self, count: int) -> Any:
        """Warp type of `count` registers, one after the other."""
        if self.lanes == 1:
            return wp.types.vector(count, self.real)
        return wp.types.matrix((count, self.lanes), self.real)

    def func_native(self, code: str) -> Any:
        """Return a decorator that makes a Warp function of C++; Warp recognises it by its name.

        The code uses the types `number`, `run` (a register of the processor), `runs` (a pointer to
        it) and `value` (the register of Warp), and `as_value(run)`.  The compiler makes whole
        registers of the loops over lanes in Warp's vectors in most places only.  A statement has
        one operation, so that the compiler contracts none.
        """
        return wp.func_native(f"{self._prelude}{code}")

    @property
    def _prelude(self) -> str:
        attributes = f"__attribute__((ext_vector_type({self.lanes}), aligned(sizeof(number))))"
        vector = f"wp::vec_t<{self.lanes}, number>"
        return f"""
        typedef wp::{self.real.__name__} number;
        typedef number run {attributes if self.lanes > 1 else ""};
        typedef run* runs;
        typedef {vector if self.lanes > 1 else "number"} value;
        const auto as_value = [](run r) {{ return *reinterpret_cast<value*>(&r); }};
        """


def lanes_of(real: Any) -> int:
    """Return how many numbers of the type `real` a SIMD register holds: elements side by side."""
    size: int = wp.types.type_size_in_bytes(real)
    return REGISTER_BYTES // size
