// Body of turns in shared_lines.py.
#ifdef __CUDA_ARCH__
    return 1;
#else
    return node == 0 ? $points : 0;
#endif
