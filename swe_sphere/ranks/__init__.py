"""Communication between ranks, and limits of a process: memory, BLAS threads, time."""
