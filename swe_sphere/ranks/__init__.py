"""Parallel runs: communication between ranks, their terminals and the threads of BLAS."""
