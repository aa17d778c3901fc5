"""Exchanges between ranks in their place among the launches that are recorded: no Python there."""

import functools
from typing import no_type_check

import warp as wp


@functools.cache
def message_kernel() -> wp.Kernel:
    """Kernel (call,), of one thread on a CPU: begins or ends an exchange with other ranks.

    call: how often it was called, which grows, and how many exchanges more the neighbours must have
    begun; addresses of MPI_Startall or MPI_Waitall, how many requests, those of the requests and of
    room for as many statuses, 0 where none are wanted; addresses of sched_yield, usleep and
    MPI_Iprobe, and what that takes, to be called now and then while waiting; then of each neighbour
    that shares memory: from where, to where and how many bytes to copy, addresses of a count to
    wait for and of one to raise.
    """

    @wp.func_native("""
        typedef wp::int32 (*start_all)(wp::int32, void*);
        typedef wp::int32 (*wait_all)(wp::int32, void*, void*);
        typedef wp::int32 (*yield)();
        typedef wp::int32 (*sleep)(wp::uint32);
        typedef wp::int32 (*probe)(wp::int32, wp::int32, wp::uint64, void*, void*);
        const int HEAD = 13, ROW = 5, PATIENCE = 512, LONG = 1 << 18, NAP = 100;
        auto c = call.data;
        const wp::int32 many = c[3];
        void* requests = reinterpret_cast<void*>(c[4]);
        void* statuses = reinterpret_cast<void*>(c[5]);
        if (many && !statuses)
            reinterpret_cast<start_all>(c[2])(many, requests);
        for (auto row = c + HEAD; row < c + call.shape[0]; row += ROW) {
            const auto due = reinterpret_cast<wp::uint64*>(row[3]);
            const auto done = reinterpret_cast<wp::uint64*>(row[4]);
            for (wp::int64 n = 1; __atomic_load_n(due, __ATOMIC_ACQUIRE) < c[0] + c[1]; ++n)
                if (n % PATIENCE == 0) {
                    auto found = reinterpret_cast<wp::int32*>(c[12]);
                    reinterpret_cast<probe>(c[8])(c[9], c[10], c[11], found, found + 1);
                    if (n < LONG)
                        reinterpret_cast<yield>(c[6])();
                    else
                        reinterpret_cast<sleep>(c[7])(NAP);
                }
            memcpy(reinterpret_cast<void*>(row[1]), reinterpret_cast<void*>(row[0]), row[2]);
            __atomic_store_n(done, c[0] + 1, __ATOMIC_RELEASE);
        }
        if (many && statuses)
            reinterpret_cast<wait_all>(c[2])(many, requests, statuses);
        ++c[0];
    """)
    def exchange(call: wp.array(dtype=wp.uint64)): ...

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False)
    def message(call: wp.array(dtype=wp.uint64)):
        exchange(call)

    return message
