"""Messages of MPI in their place among the launches that are recorded: no Python in between."""

import functools
from typing import no_type_check

import warp as wp


@functools.cache
def message_kernel() -> wp.Kernel:
    """Kernel (call (5,)), of one thread on a CPU: calls MPI_Startall or MPI_Waitall.

    call: addresses of the function, how many requests, those of the requests and of room for as
    many statuses, 0 where none are wanted, and how often it was called, which grows.
    """

    @wp.func_native("""
        typedef wp::int32 (*start_all)(wp::int32, void*);
        typedef wp::int32 (*wait_all)(wp::int32, void*, void*);
        auto c = call.data;
        const wp::int32 many = c[1];
        void* requests = reinterpret_cast<void*>(c[2]);
        if (c[3])
            reinterpret_cast<wait_all>(c[0])(many, requests, reinterpret_cast<void*>(c[3]));
        else
            reinterpret_cast<start_all>(c[0])(many, requests);
        ++c[4];
    """)
    def call_mpi(call: wp.array(dtype=wp.uint64)): ...

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False)
    def message(call: wp.array(dtype=wp.uint64)):
        call_mpi(call)

    return message
