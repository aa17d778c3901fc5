"""C++ of the kernels: loads, stores and arithmetic of whole SIMD registers."""
