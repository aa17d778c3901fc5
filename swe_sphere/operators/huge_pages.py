"""Memory in huge pages for the arrays of a CPU, so that fewer addresses need a translation.

Most arrays are smaller than a huge page, and are therefore cut from larger chunks.
"""

import mmap
import sys
import threading
from contextlib import suppress

import numpy as np
import warp as wp

LINE, PAGE, CHUNK = 64, 1 << 21, 1 << 24
"""Sizes of a cache line and of a huge page, and the least size of a chunk [bytes]."""


class ChunkAllocator:
    """Allocator of a Warp device that cuts arrays from chunks, which begin at a huge page.

    Arrays begin at a cache line. Full chunks are released with their last array.
    """

    deallocate_requires_context_guard = False

    def __init__(self) -> None:
        self._chunk, self._next = np.empty(0, np.uint8), sys.maxsize
        self._chunks: dict[int, np.ndarray] = {}  # of each array, by its address
        self._lock = threading.Lock()

    def allocate(self, size_in_bytes: int) -> int:
        """Return the address of new memory."""
        size = max(size_in_bytes, 1)
        with self._lock:
            chunk, begin = self._chunk, self._next
            if size > CHUNK or begin + size > chunk.ctypes.data + chunk.size:
                chunk = new_memory(max(size, CHUNK) + PAGE)
                begin = chunk.ctypes.data + -chunk.ctypes.data % PAGE
            if size <= CHUNK:  # a larger array has a chunk of its own
                self._chunk, self._next = chunk, begin + size + -size % LINE
            self._chunks[begin] = chunk
        return begin

    def deallocate(self, ptr: int, size_in_bytes: int) -> None:
        """Release the memory of an array."""
        del self._chunks[ptr]


def new_memory(size: int) -> np.ndarray:
    """Return memory never used before, as pages in use stay small; MemoryError without memory."""
    with suppress(AttributeError, OSError):  # not Linux; no huge pages or no memory
        memory = mmap.mmap(-1, size, mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
        memory.madvise(mmap.MADV_HUGEPAGE)
        return np.frombuffer(memory, np.uint8)
    return np.empty(size, np.uint8)  # or MemoryError


def use_huge_pages() -> None:
    """Allocate the arrays of the CPU by a `ChunkAllocator`, if Warp's device has that attribute."""
    device = wp.get_device("cpu")
    if not isinstance(getattr(device, "default_allocator", None), ChunkAllocator | None):
        device.default_allocator = ChunkAllocator()
