"""Parallel runs: MPI ranks, their terminals and the threads of BLAS."""
