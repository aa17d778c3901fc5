"""Product with a sparse matrix of fixed row length."""

import functools
from typing import no_type_check

import warp as wp

from swe_sphere.kernels.assembly import OPTIONS


@functools.cache
def patch_kernel(real: type) -> wp.Kernel:
    """Kernel (columns (N, m), rows (N, m) float32, b (N,), x): x_n = sum_k rows_nk b[column_nk]."""

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def patch(
        columns: wp.array2d(dtype=wp.int32),
        rows: wp.array2d(dtype=wp.float32),
        b: wp.array(dtype=real),
        x: wp.array(dtype=real),
    ):
        node = wp.tid()
        r = real(0.0)
        for k in range(columns.shape[1]):
            r += real(rows[node, k]) * b[columns[node, k]]
        x[node] = r

    return patch
