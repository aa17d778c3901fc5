// Body of enter in shared_lines.py.
#ifdef __CUDA_ARCH__
    __shared__ number $block[$size];
    __syncthreads();  // all have read what was here
    return wp::uint64($block + threadIdx.x - node);
#else
    static number $block[$size];
    return wp::uint64($block);
#endif
