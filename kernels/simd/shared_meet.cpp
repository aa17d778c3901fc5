// Body of meet in shared_lines.py.
#ifdef __CUDA_ARCH__
    __syncthreads();
#endif
