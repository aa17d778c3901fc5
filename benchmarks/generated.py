"""Loads and floating-point operations counted in the C++ that Warp generates for a kernel.

Each call of an arithmetic function counts by the width of its result, and each array access by the
width of the value.  Both are multiplied by the trip counts of the enclosing loops (once if the code
does not state the count: loops over tracers) and by the calls of the enclosing function.  Later
savings of the compiler are not included.  Work arrays of an element and tables of the np GLL
points, which stay in the first-level cache, do not count as loads.  Only kernels with one thread
per node are supported: kernels for CPUs contain C++ whose loads and sums are not counted.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path

import warp as wp

FLOPS = {"add": 1, "sub": 1, "mul": 1, "cw_mul": 1, "neg": 1, "div": 1, "max": 1, "sqrt": 1}
TABLES = ("derivative", "weight")
CACHED = ("var_d", "var_f")
"""Parameters of the line sums that are tables of GLL points or work arrays, and do not count."""
FUNCTION = re.compile(
    r"^static (?!CUDA_CALLABLE)[\w:<>, ]+? (\w+)\(\n(.*?)\)\n\{(.*?)^\}", re.M | re.S
)
NATIVE = re.compile(r"^static CUDA_CALLABLE [\w:<>, ]+? (\w+)\(\n.*?\)\n\{(.*?)\}\n\n", re.M | re.S)
"""Functions that are written in C++ in the package."""
KERNEL = re.compile(r"^\w+ ?\w* (\w+_cpu_kernel_forward)\(\n(.*?)\)\n\{(.*?)^\}", re.M | re.S)
DECLARED = re.compile(r"^ *(?:const )?(\w[\w:<>, ]*?[*&]?) (var_\w+)(?: = [^;]+)?;$", re.M)
ASSIGNED = re.compile(r"(\w+) = wp::(\w+)\((.*)\);")


def source(kernel: wp.Kernel) -> str:
    """Return the generated C++ of a kernel from the cache of Warp, without comments."""
    name = kernel.module.get_module_identifier(block_dim=1)
    text = (Path(wp.config.kernel_cache_dir) / name / f"{name}.cpp").read_text()
    return re.sub(r"//[^\n]*", "", text)


@dataclass(frozen=True)
class Cost:
    """Number of values loaded and stored (arrays over nodes) and of operations, per thread."""

    loads: float = 0.0
    stores: float = 0.0
    flops: float = 0.0

    def __add__(self, other: Cost) -> Cost:
        return Cost(self.loads + other.loads, self.stores + other.stores, self.flops + other.flops)

    def __mul__(self, factor: float) -> Cost:
        return Cost(self.loads * factor, self.stores * factor, self.flops * factor)


NATIVE_COSTS = {
    "load": Cost(loads=1.0),
    "load_nodes": Cost(loads=1.0),
    "put": Cost(stores=1.0),
    "product": Cost(flops=1.0),
    "clip": Cost(flops=2.0),
    "step": Cost(2.0, 2.0, 7.0),
    "mix_run": Cost(4.0, 1.0, 9.0),
    "diffusive_run": Cost(6.0, 2.0, 10.0),
}
"""Costs of functions in C++ with one number a thread, by name; `mix_run` with three levels."""


def cost(kernel: wp.Kernel, contributors: float) -> Cost:
    """Return the cost of one thread; contributors: mean number of elements that share a node."""
    text = source(kernel)
    gather = Cost(loads=contributors, flops=contributors - 1.0)
    found = [m for m in NATIVE.finditer(text) if not m[1].startswith("adj_")]
    known = {m[1]: _native(m[1], m[2], gather) for m in found}
    bodies = {m[1]: Function(m[2], m[3], known) for m in FUNCTION.finditer(text)}
    thread = Function(*_entry(text), known)
    return thread.cost(bodies)


def _native(name: str, body: str, gather: Cost) -> Cost:
    """Return the cost of a C++ function for one node; raise KeyError for one that is not known."""
    if name.startswith("stage_store"):
        return Cost(stores=float(re.findall(r"f < (\d+)", body)[0]))
    if name.startswith("shared_lines__locals__line_sum"):  # of rows that threads share
        points, rows = (int(re.findall(rf"{each} < (\d+)", body)[0]) for each in "mk")
        return Cost(flops=2.0 * points * rows)
    if name.startswith("shared_lines"):
        return Cost()  # of the memory that threads share
    return (NATIVE_COSTS | {"gather": gather})[re.sub(r"_\d+$", "", name.split("__")[-1])]


def _entry(text: str) -> tuple[str, str]:
    """Return parameters and body of the function that runs one thread."""
    found = [m for m in KERNEL.finditer(text) if "_forward" in m[1]]
    return found[0][2], found[0][3]


def width(kind: str) -> int:
    """Return the number of scalars in a value of a C++ type, also for nested vectors."""
    sizes = re.findall(r"(?:vec_t|mat_t)<(\d+), ?(?:(\d+),)?", kind)
    return math.prod(int(n) for pair in sizes for n in pair if n)


class Function:
    """Function of the generated code."""

    def __init__(self, parameters: str, body: str, known: dict[str, Cost]) -> None:
        """Parse a function; known: costs of the functions that are written in C++."""
        given = re.findall(r"([\w:<>, ]+?) (var_\w+)", parameters)
        found = given + DECLARED.findall(body)
        self._types = {name: kind.strip() for kind, name in found if kind.strip() != "return"}
        self._members = dict(re.findall(r"(var_\d+) = &\(\(\w+\)\.(\w+)\)", body))
        copies = re.findall(r"(var_\d+) = wp::load\((var_\d+)\)", body)
        self._members |= {a: self._members[b] for a, b in copies if b in self._members}
        self._body, self._known = body, known

    def cost(self, functions: dict[str, Function]) -> Cost:
        """Return the cost of one call, including the functions that it calls."""
        total = Cost()
        trips: list[int] = []
        for line in self._body.splitlines():
            if "goto end_for_" in line:
                known = re.search(r">= (\d+)\)", line)
                trips.append(int(known[1]) if known else 1)
            elif re.match(r"\s*end_for_\d+:", line):
                trips.pop()
            else:
                total += self._line(line, functions) * math.prod(trips)
        return total

    def _line(self, line: str, functions: dict[str, Function]) -> Cost:
        if call := re.search(r"\b(?<!wp::)(\w+)\(", line):
            if call[1] in self._known:
                return self._known[call[1]]
            if call[1] in functions:
                return functions[call[1]].cost(functions)
        if store := re.search(r"wp::array_store\((\w+), .*, (\w+)\);", line):
            return Cost() if self._is_cached(store[1]) else Cost(stores=self._width(store[2]))
        if not (found := ASSIGNED.search(line)):
            return Cost()
        result, name, arguments = found.groups()
        if name == "address":
            return Cost() if self._is_cached(arguments) else Cost(loads=self._width(result))
        if "float" not in self._types.get(result, ""):
            return Cost()
        return Cost(flops=self._flops(name, result, arguments))

    def _flops(self, name: str, result: str, arguments: str) -> int:
        """Return the operations of an arithmetic function; a length is a dot product and a root."""
        if name in ("dot", "length"):
            return 2 * self._width(arguments.split(",")[0])
        return FLOPS.get(name, 0) * self._width(result)

    def _is_cached(self, arguments: str) -> bool:
        array = arguments.split(",")[0].strip()
        member = self._members.get(array)
        return array in CACHED or member in TABLES or "fixedarray" in self._types.get(array, "")

    def _width(self, name: str) -> int:
        return width(self._types.get(name, ""))
