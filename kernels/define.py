"""Definition of kernels, device functions and their structures.

A kernel is compiled for a number type and for a count of numbers side by side. Its code uses a
`Placeholder` for everything that depends on either: `real` is the number type, `load` loads a
register. `specialise` returns the Warp kernel for a `Register` or for the `KernelTypes` of
elements: it replaces placeholders by their values, also in the functions that the kernel calls.

A formula is thus written once, with names for the types of its arguments and constants:

    @func
    def kinetic_energy(u: value, v: value):
        return real(0.5) * (mul(u, u) + mul(v, v))

A function must be defined above its callers. Warp compiles a kernel again if its code, or the code
of a function that it calls, has changed.
"""

import functools
import types
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Any

import warp as wp

REGISTER_BYTES = 64


@functools.cache
def source(name: str, **given: object) -> str:
    """Return the C++ code in kernels/simd/NAME.cpp, each $key replaced by its value in `given`."""
    path = Path(__file__).with_name("simd") / f"{name}.cpp"
    return Template(path.read_text(encoding="utf-8")).substitute(given)


@dataclass(frozen=True)
class Register:
    """A register of `lanes` numbers of the type `real`, or a plain number if `lanes` is 1.

    whole: True if products use whole registers, slower for numbers that were gathered one by one.
    """

    real: Any
    lanes: int = 1
    whole: bool = True

    @property
    def register(self) -> "Register":
        """The register itself, as in `KernelTypes`."""
        return self

    @property
    def value(self) -> Any:
        """Warp type of a register."""
        return wp.types.vector(self.lanes, self.real) if self.lanes > 1 else self.real

    @property
    def index(self) -> Any:
        """Warp type with one node number per lane."""
        return wp.types.vector(self.lanes, wp.int32) if self.lanes > 1 else wp.int32

    def rows(self, count: int) -> Any:
        """Return the Warp type of `count` consecutive registers."""
        if self.lanes == 1:
            return wp.types.vector(count, self.real)
        return wp.types.matrix((count, self.lanes), self.real)

    @staticmethod
    def func_native(code: str) -> Callable[[Any], Any]:
        """Return a decorator that builds a device function from C++.

        The code uses the types `number`, `run` (a register of the processor), `runs` (a pointer to
        one) and `value` (the register of Warp), the number `lanes`, and `as_value(run)`. In some
        places the compiler does not vectorise loops over the lanes of Warp's vectors. Statements
        contain one operation where a fused multiply-add would change bits between variants.
        """
        return lambda f: KernelTemplate(f, lambda made, of: wp.func_native(of.prelude + code)(made))

    @property
    def prelude(self) -> str:
        """C++ code at the beginning of every native function."""
        attributes, register = "", "number"
        if self.lanes > 1:
            attributes = f"__attribute__((ext_vector_type({self.lanes}), aligned(sizeof(number))))"
            register = f"wp::vec_t<{self.lanes}, number>"
        given = {"real": self.real.__name__, "lanes": self.lanes}
        return source("prelude", attributes=attributes, register=register, **given)


def lanes_of(real: Any) -> int:
    """Return how many numbers of the type `real` fill a SIMD register (elements side by side)."""
    size: int = wp.types.type_size_in_bytes(real)
    return REGISTER_BYTES // size


class Placeholder:
    """A type, number or function in kernel code whose value depends on the register or elements."""

    def __init__(self, find: Callable[[Any], Any], of_elements: bool = False) -> None:
        """Store `find`: a function of a `Register`, or of `KernelTypes` if `of_elements`."""
        self._find, self.of_elements = functools.cache(find), of_elements

    def find(self, of: Any) -> Any:
        """Return the value for a `Register` or `KernelTypes`, the same object each time."""
        return self._find(of if self.of_elements else of.register)


class KernelTemplate(Placeholder):
    """A kernel or a device function whose code uses placeholders, all of them defined before it."""

    def __init__(self, function: Any, compiled: Callable[[Any, Any], Any]) -> None:
        """Store the function and `compiled`, which turns it into a Warp object for a register."""
        self._function, self._compiled, known = function, compiled, function.__globals__
        self._names = {name: known.get(name) for name in function.__code__.co_names}
        self._around = [cell.cell_contents for cell in function.__closure__ or ()]
        kinds = (getattr(kind, "dtype", kind) for kind in function.__annotations__.values())
        used = (*self._names.values(), *self._around, *kinds)
        of_elements = any(isinstance(it, Placeholder) and it.of_elements for it in used)
        super().__init__(self._specialise, of_elements)

    def _specialise(self, of: Any) -> Any:
        f = self._function
        meant = {name: specialise(it, of) for name, it in self._names.items() if it is not None}
        cells = tuple(types.CellType(specialise(it, of)) for it in self._around)
        names = f.__globals__ | meant
        made = types.FunctionType(f.__code__, names, f.__name__, f.__defaults__, cells)
        made.__annotations__ = {name: specialise(it, of) for name, it in f.__annotations__.items()}
        made.__qualname__, made.__module__ = f.__qualname__, f.__module__
        return self._compiled(made, of.register)


def specialise(it: Any, of: Any) -> Any:
    """Return the value of a `Placeholder`, or of an array type of one; other objects as they are.

    of: a `Register`, `KernelTypes`, or a number type of Warp, which stands for plain numbers.
    """
    of = of if hasattr(of, "register") else Register(of)
    if isinstance(it, wp.array) and isinstance(it.dtype, Placeholder):
        return wp.array(dtype=it.dtype.find(of), ndim=it.ndim)
    return it.find(of) if isinstance(it, Placeholder) else it


if TYPE_CHECKING:  # annotations of what Warp compiles are Warp types
    from typing import no_type_check as func
    from typing import no_type_check as kernel
    from typing import no_type_check as unrolled
else:

    def func(f: Any) -> KernelTemplate:
        """Turn the decorated Python function into a device function."""
        return KernelTemplate(f, lambda made, _: wp.func(made))

    def kernel(f: Any, unroll: int = 1) -> KernelTemplate:
        """Turn the function into a kernel whose loops of up to `unroll` rounds are unrolled.

        Unrolled loops take long to compile. All kernels share their compiler flags
        (`keep_headers`): each set compiles Warp's headers again, which takes seconds.
        """
        options = {"module": "unique", "module_options": {"max_unroll": unroll}}
        return KernelTemplate(f, lambda made, _: wp.kernel(made, enable_backward=False, **options))

    unrolled = functools.partial(kernel, unroll=16)  # the largest np


@functools.cache
def rows(count: int) -> Any:
    """Return the `Placeholder` of the type of `count` consecutive registers."""
    return Placeholder(lambda of: of.rows(count))


real: Any = Placeholder(lambda of: of.real)
"""Number type."""
value: Any = Placeholder(lambda of: of.value)
"""A register."""
index: Any = Placeholder(lambda of: of.index)
"""Node numbers, one for each lane of a register."""
vector: Any = Placeholder(lambda of: wp.array(dtype=of.real))
"""Array of numbers."""
lanes: Any = Placeholder(lambda of: of.lanes)
"""Count of numbers in a register."""


def struct_of(name: str, members: dict[str, Any]) -> Any:
    """Return a Warp structure with the members whose type is not False."""
    kept = {name: kind for name, kind in members.items() if kind is not False}
    return wp.struct(type(name, (), {"__annotations__": kept}))
