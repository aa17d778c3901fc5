"""Repeated launches of Warp kernels with little overhead."""

import functools
import inspect
import os
import time
import zlib
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import warp as wp
from numpy.typing import NDArray

from swe_sphere.compiling import mark_compiling
from swe_sphere.errors import ConfigError, NotCopyable
from swe_sphere.kernels.define import specialise
from swe_sphere.kernels.simd.shared_lines import block_threads
from swe_sphere.kernels.vectors import ADDERS
from swe_sphere.operators.huge_pages import use_huge_pages
from swe_sphere.ranks.communicator import Communicator

MOST_CACHED = 512
"""Largest number of recorded commands; a cache that is full is emptied."""


class Span(NamedTuple):
    """Range of nodes for launches, with the first node of each strip of the mesh in the range."""

    begin: int
    end: int
    starts: NDArray[np.integer] | None = None
    """(strips + 1,) starts of the strips; None if the mesh is not cut into strips."""
    on_rim: bool = False
    """True for nodes of several ranks and others that come after the strips."""

    def cut(self, begin: int, end: int, step: int, field: int = 0) -> "Cuts | None":
        """Cut a launch over the nodes from `begin` to `end`, with `step` nodes per thread.

        field: offset of the field, which is added to the first argument of the kernel.
        """
        if self.starts is None:
            return None
        return Cuts((self.starts.clip(begin, end) - begin) // step, field + begin, step, 0)


class Cuts(NamedTuple):
    """Assignment of the threads of a launch to strips of the mesh, see `strips.py`."""

    starts: NDArray[np.integer]
    """(strips + 1,) first thread of each strip."""
    begin: int
    """First argument of the kernel in the whole launch."""
    step: int
    """Increment of that argument from thread to thread."""
    reach: int
    """Number of strips that a launch over elements reads ahead; 0 for a launch over nodes."""


TEMPLATES = "-fpch-instantiate-templates"
"""Flag of Clang for compiled headers."""
OBJECT = "_get_compile_output_name"
"""Private method of Warp's modules: the name of the file compiled for a device."""


class Launcher(NotCopyable):
    """Launches kernels on one device through recorded commands.

    A plain `wp.launch` costs about as much as the whole right-hand side of a small mesh; a recorded
    one a fifth of it. Commands are stored by kernel and arguments (arrays by address).
    """

    def __init__(self, device: str, comm: Communicator | None = None, nodes: int = 1) -> None:
        """Create a launcher; a block of threads holds whole elements of `nodes` nodes each."""
        self.device, self.comm = device, comm or Communicator()
        with self.comm.root_first():
            keep_headers()
        use_huge_pages()
        self.compile_cpu_seconds = 0.0
        """CPU time of all threads spent compiling or loading kernels [s]."""
        self.compile_seconds = 0.0
        """Wall time spent compiling or loading kernels [s]."""
        self.sweep: Any = None  # the kernel that launches strips, see `DeviceMesh.strips`
        self.records = True
        """True if repeated launches are recorded and launched as a whole, see `Replay`."""
        self.defer: Callable[[tuple[Any, ...], Cuts], None] | None = None
        """Function that receives launches over strips instead of the device during recording."""
        self.on_rim = 0
        """Number of launches on the rim, see `strips.py`."""
        self._block_dim = 1 if wp.get_device(device).is_cpu else block_threads(nodes)
        # with the arguments, so that no new array or structure reuses a stored address
        self._commands: dict[tuple[object, ...], tuple[Any, tuple[Any, ...]]] = {}
        self._adder = functools.cache(lambda real, count: self.compile(real, ADDERS[count])[0])

    def load(self, *kernels: Any) -> None:
        """Compile the kernels for the device, or load them from Warp's cache."""
        start, worked = time.perf_counter(), time.process_time()
        modules = {kernel.module.name: kernel.module for kernel in kernels}.values()
        with self.comm.root_first():  # the root compiles for all ranks
            if new := [module for module in modules if not self._cached(module).exists()]:
                with mark_compiling(), ThreadPoolExecutor(os.cpu_count()) as pool:
                    self._load(new[0])  # alone, because it compiles Warp's headers
                    list(pool.map(self._load, new[1:]))
            for module in modules:
                self._load(module)
        self.compile_seconds += time.perf_counter() - start
        self.compile_cpu_seconds += time.process_time() - worked

    def compile(self, of: Any, *kernels: Any) -> list[Any]:
        """Return these kernels for a register or for elements, loaded; `of` as for `specialise`."""
        made = [specialise(kernel, of) for kernel in kernels]
        self.load(*made)
        return made

    def _cached(self, module: Any) -> Path:
        """Return the path of Warp's copy of the module compiled for this processor or GPU."""
        place = Path(wp.config.kernel_cache_dir, module.get_module_identifier(self._block_dim))
        if warp_internals() is not None:  # otherwise the module for any processor
            device, block_dim = wp.get_device(self.device), self._block_dim
            place /= getattr(module, OBJECT)(device, block_dim=block_dim)
        return place

    def _load(self, module: Any) -> None:
        """Load or compile a module; raise ConfigError if Warp's cached copy cannot be loaded."""
        try:
            module.load(self.device, block_dim=self._block_dim)
        except Exception as error:  # Warp raises plain Exception
            if not (kept := self._cached(module)).exists():
                raise
            raise ConfigError(
                f"a compiled kernel is damaged ({error}): remove {kept.parent} and run again"
            ) from error

    def __call__(
        self, kernel: Any, dim: int | tuple[int, ...], *arguments: Any, cuts: Cuts | None = None,
        on_rim: bool = False,
    ) -> None:  # fmt: skip
        """Run the kernel over `dim` threads, which may be cut into strips, or are on the rim."""
        key = (id(kernel), dim, *map(_identity, arguments))
        if (known := self._commands.get(key)) is None:
            if len(self._commands) >= MOST_CACHED:
                self.forget()
            command = wp.launch(
                kernel, dim, inputs=list(arguments), device=self.device, record_cmd=True,
                block_dim=self._block_dim,
            )  # fmt: skip
            known = self._commands[key] = command, (kernel, *arguments)
        self.on_rim += on_rim
        if cuts is None or self.defer is None:
            known[0].launch()
        else:
            self.defer(known, cuts)

    def combine(self, x: wp.array, *terms: Any, out: wp.array) -> None:
        """Set out = x + the sum of vectors, each times the factor that follows it; out may be x."""
        if not terms:
            wp.copy(out, x)
        for first in range(0, len(terms), 2 * len(ADDERS)):
            part = terms[first : first + 2 * len(ADDERS)]
            self(self._adder(out.dtype, len(part) // 2), out.size, x, *part, out)
            x = out

    def forget(self) -> None:
        """Drop all recorded commands, and the arrays that only these commands reference."""
        self._commands.clear()


def warp_internals() -> Any | None:
    """Return Warp's module `context`, or None if its private methods are not those used here.

    Without these methods, each process compiles Warp's headers, a kernel counts as compiled
    regardless of the processor, and launches do not run strip by strip; results are the same.
    """
    try:
        from warp._src import context

        wp.init()
        if context.runtime.llvm is not None:
            context.runtime.llvm.wp_get_host_cpu_features  # noqa: B018 - tests that it exists
        context.runtime.core.wp_apic_get_operation_count  # noqa: B018 - likewise
        context.runtime.core.wp_apic_get_recording_state  # noqa: B018 - likewise
        headers = inspect.signature(context.Runtime.get_clang_pch_dir).parameters
        compiled = inspect.signature(getattr(context.Module, OBJECT)).parameters
    except (ImportError, AttributeError):
        return None
    return context if [*headers] == ["self"] and {"device", "block_dim"} <= {*compiled} else None


def keep_headers() -> None:
    """Keep Warp's compiled headers beside the kernels, which saves every process 2 s.

    Warp has no setting for the path of its compiled headers: each thread has a temporary path.
    Clang moves a complete file to this path, so that processes may share it. Each processor needs a
    separate file, and so does each installation of Warp, even of one version, because Clang
    identifies headers by path. Their templates are instantiated once, in the compiled headers,
    instead of for each kernel, which saves 0.1 s per kernel.
    """
    if (context := warp_internals()) is None or context.runtime.llvm is None:
        return
    flags = wp.config.cpu_compiler_flags
    if flags is not None and TEMPLATES not in flags:
        wp.config.cpu_compiler_flags = f"{flags} {TEMPLATES}"
    processor = context.runtime.llvm.wp_get_host_cpu_features()
    kind = zlib.crc32(os.fsencode(wp.__file__), zlib.crc32(processor))
    folder = Path(wp.config.kernel_cache_dir, f"headers_{kind:08x}")
    with suppress(OSError):  # the user may lack permission to write to the cache
        folder.mkdir(parents=True, exist_ok=True)
        context.runtime.get_clang_pch_dir = lambda: str(folder)


def _identity(argument: Any) -> object:
    """Return the key of a recorded argument: the address of an array, otherwise the value."""
    if isinstance(argument, wp.array):
        return argument.ptr
    return argument if isinstance(argument, int | float) else id(argument)


def find_device(name: str, local: int = 0) -> str:
    """Return the Warp device of that name; "cuda" is the GPU for rank `local` of this machine.

    Raises ConfigError if this machine has no such device.
    """
    count = wp.get_cuda_device_count()
    if name == "cuda" and count:
        return f"cuda:{local % count}"
    with suppress(ValueError, RuntimeError, AssertionError):
        if name != "cuda":  # otherwise Warp prints its own complaint
            return str(wp.get_device(name))
    available = ", ".join(str(device) for device in wp.get_devices())
    raise ConfigError(f"there is no device {name!r} on this machine; available: {available}")
