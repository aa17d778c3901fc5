"""Linear combinations of states with fixed coefficients, so that their launches can be recorded."""

import itertools

import numpy as np
import warp as wp
from numpy.typing import NDArray

from swe_sphere.equations.model import Model
from swe_sphere.kernels import combine_kernel
from swe_sphere.kernels.vectors import AT_ONCE


class Combiner:
    """out = x + sum_s c[s] stack[s], with coefficients fixed so that launches can be recorded."""

    def __init__(self, model: Model, stack: wp.array, coefficients: NDArray[np.float64]) -> None:
        self._model = model
        terms = [(stack[s], float(c)) for s, c in enumerate(coefficients) if c != 0.0]
        self._parts = [
            list(itertools.chain(*terms[i : i + AT_ONCE])) for i in range(0, len(terms), AT_ONCE)
        ]
        real = model.device_mesh.real
        self._kernels = [combine_kernel(real, len(part) // 2) for part in self._parts]
        model.launch.load(*self._kernels)

    def __call__(self, x: wp.array, out: wp.array) -> None:
        if not self._parts:
            wp.copy(out, x)
        for kernel, part in zip(self._kernels, self._parts, strict=True):
            self._model.launch(kernel, self._model.size, x, *part, out)
            x = out
