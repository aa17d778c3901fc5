"""How numbers of elements lie in memory: `lanes` elements side by side, in whole registers."""

import math
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from swe_sphere.arrays import Array
from swe_sphere.kernels import lanes_of
from swe_sphere.kernels.terms import LANE_BYTES


class Layout:
    """Numbers of so many elements on a device, in a number type and for a launch shape."""

    def __init__(self, elements: int, device: str, real: Any, shape: str) -> None:
        self.elements, self.device, self.real, self.shape = elements, device, real, shape
        self.lanes = lanes_of(real) if shape == "element" else 1
        self.groups = -(-elements // self.lanes)
        self.numpy_real = np.dtype(wp.dtype_to_numpy(real))

    def flat(self, array: wp.array) -> wp.array:
        """An array of registers of the run's number type as numbers (n,)."""
        shape = (array.size * self.lanes,)
        return wp.array(ptr=array.ptr, shape=shape, dtype=self.real, device=self.device)

    def upload(self, values: Array) -> wp.array:
        """A numpy array on the device in the number type of the run."""
        return wp.array(
            np.ascontiguousarray(values, self.numpy_real), dtype=self.real, device=self.device
        )

    def write(self, values: NDArray[Any], to: wp.array) -> None:
        """Numbers (k,) from the host to the front of an array; on a CPU without Warp's detours."""
        if to.device.is_cpu:
            to.numpy()[: values.size] = values
        else:
            wp.copy(to, self.upload(values), count=values.size)

    def on_elements(
        self, values: NDArray[Any], tail: tuple[int, ...] = (), scalar: Any = None
    ) -> wp.array:
        """(E, k, *tail) or (E, np, np, *tail) of this rank's elements: (groups, k, *tail) of lanes.

        scalar: another number type than that of the run.
        """
        rows = values.reshape(self.elements, -1, math.prod(tail))
        lanes = self.in_lanes(rows)
        return self.registers(lanes.reshape(*lanes.shape[:2], *tail, self.lanes), scalar)

    def in_lanes(self, values: NDArray[Any]) -> NDArray[Any]:
        """(E, k, ...) as (groups, k, ..., lanes)."""
        short = self.groups * self.lanes - self.elements
        padded = np.concatenate([values, np.repeat(values[-1:], short, axis=0)])
        grouped = padded.reshape(self.groups, self.lanes, values.shape[1], -1)
        return np.ascontiguousarray(grouped.transpose(0, 2, 3, 1))

    def registers(self, values: NDArray[Any], scalar: Any = None) -> wp.array:
        """Numbers (..., lanes) on the device, lanes side by side; scalar: as for `on_elements`."""
        scalar = scalar or self.real
        dtype = wp.types.vector(self.lanes, scalar) if self.lanes > 1 else scalar
        array = self.aligned(values.shape[:-1], dtype)
        array.assign(values.astype(wp.dtype_to_numpy(scalar)).reshape(array.numpy().shape))
        return array

    def aligned(self, shape: tuple[int, ...], dtype: Any) -> wp.array:
        """Zeros that begin where a cache line does."""
        count = math.prod(shape) * wp.types.type_size_in_bytes(dtype)
        whole = wp.zeros(count + LANE_BYTES, dtype=wp.uint8, device=self.device)
        begin = whole.ptr + -whole.ptr % LANE_BYTES
        array = wp.array(ptr=begin, shape=shape, dtype=dtype, device=self.device)
        array.kept = whole
        return array
