"""Seconds, messages, bytes and sums of the ranks in a step.  `scaling.py` runs this script."""

from __future__ import annotations

import gc
import hashlib
import json
import sys
import time
from collections import Counter
from typing import Any

import numpy as np
from scaling_bytes import Launches, each_launch, launches

from swe_sphere import Simulation
from swe_sphere.operators.halo import Halo
from swe_sphere.ranks.communicator import Communicator, world

STEPPERS = {
    "rk4": (200.0, 4),
    "semi-implicit": (900.0, 2),
    "tr-bdf2": (1800.0, 1),
    "bdf2": (3600.0, 1),
}
"""Time step [s] on ne 30, and number of steps that are timed together, by stepper."""
PIECES = 12
SIZES = (8, 1024, 16384, 131072)
"""Sizes of messages between two ranks [bytes]."""
ROUND_TRIPS = 300
KERNELS = {"sweeps": "coarse_step", "longest": "tall_"}
LOOKED_AT = 3
"""Number of steps whose solves of the coarse level are timed."""


def measure(stepper: str, ne: int, pieces: int = PIECES) -> dict[str, Any]:
    """Return times of a step [s] by segment, counts of all ranks per step, a hash of the state."""
    traffic, at_once = Counted(world()), STEPPERS[stepper][1]
    sim = started(stepper, ne)
    gc.collect()  # earlier simulations
    before, times = traffic.counts(), []
    for _ in range(pieces):
        start, end = time.perf_counter(), sim.steps + at_once
        while sim.steps < end:
            sim.take(end - sim.steps)
        times.append((time.perf_counter() - start) / at_once)
    steps = pieces * at_once
    totals = sum(sim.comm.allgather(traffic.counts() - before), Counter())
    state = np.concatenate([sim.state.h, sim.state.u, sim.state.v])
    return {
        "times": times,
        "traffic": {name: count / steps for name, count in totals.items()},
        **(coarse_seconds(sim) if pieces == PIECES else {}),
        "bits": hashlib.sha256(state.tobytes()).hexdigest(),
    }


def started(stepper: str, ne: int) -> Simulation:
    """Return a simulation that has loaded its kernels and started its scheme."""
    dt, _ = STEPPERS[stepper]
    sim = Simulation("williamson5", ne=ne, np=4, stepper=stepper, dt=dt * 30 / ne)
    for _ in range(3):
        sim.step()
    return sim


def launched(stepper: str, ne: int, pieces: int) -> Launches:
    """Return the launches per step whose results go to other ranks, as in `measure`."""
    return launches(started(stepper, ne), pieces * STEPPERS[stepper][1])


def coarse_seconds(sim: Simulation) -> dict[str, float]:
    """Return the time of coarse-level solves per step [s]: sweeps, and longest waves."""
    with each_launch(sim.model.launch) as made:
        for _ in range(LOOKED_AT):
            sim.step()
    found = {}
    for what, name in KERNELS.items():
        times: dict[object, list[float]] = {}
        for kernel, dim, seconds in made:
            if kernel.module.name.startswith(name):
                times.setdefault((kernel.module.name, dim), []).append(seconds)
        least = sum(len(each) * min(each) for each in times.values())
        found[f"{what} seconds"] = least / LOOKED_AT
    return found


class Counted:
    """Counts of the messages that this rank sends, and of the sums in which it takes part."""

    def __init__(self, comm: Communicator) -> None:
        self._sums, self._halos, gather = Counter[str](), [], comm.allgather_arrays
        self._exchanges = Counter[Halo]()
        build, start = Halo.__init__, Halo._start

        def kept(halo: Halo, launch: Any, flat: Any, sends: Any, *more: Any) -> None:
            build(halo, launch, flat, sends, *more)
            self._halos.append((halo, len(sends), comm.rank in sends))

        def counted(halo: Halo) -> None:
            self._exchanges[halo] += 1
            start(halo)

        def counting(mine: Any, counts: Any, out: Any = None) -> Any:
            self._sums.update({"sums": 1, "sums bytes": mine.nbytes})
            return gather(mine, counts, out)

        Halo.__init__, Halo._start = kept, counted  # type: ignore[method-assign]
        comm.allgather_arrays = counting  # type: ignore[method-assign]

    def counts(self) -> Counter[str]:
        """Return the counts since the object was built."""
        found = Counter(self._sums)
        for halo, others, of_all in self._halos:
            n = self._exchanges[halo]
            sent = n * halo.going.bytes
            if of_all:  # the integrals of coarse functions
                found.update({"coarse": n, "coarse bytes": sent // others})
            else:
                found.update(exchanges=n, messages=n * others, bytes=sent)
        return found


def ping_pong() -> dict[int, float]:
    """Return the least time [s] of a message from one rank to the next, by size [bytes]."""
    from mpi4py import MPI

    found, comm = {}, MPI.COMM_WORLD
    for size in SIZES:
        mine, theirs, other = np.zeros(size, np.int8), np.zeros(size, np.int8), 1 - comm.rank
        back, forth = comm.Send_init(mine, other), comm.Recv_init(theirs, other)
        times = []
        for _ in range(ROUND_TRIPS):
            start = time.perf_counter()
            for request in (back, forth) if comm.rank == 0 else (forth, back):
                request.Start()
                request.Wait()
            times.append(0.5 * (time.perf_counter() - start))
        found[size] = min(times)
        back.Free()
        forth.Free()
    return found


def main(job: str, ne: str, pieces: str) -> None:
    """Run a job for all its steppers, or time messages; rank 0 prints JSON."""
    if job == "ping":
        told: Any = ping_pong()
    else:
        of_each = {"steps": measure, "launches": launched}[job]
        told = {name: of_each(name, int(ne), int(pieces)) for name in STEPPERS}
    if world().rank == 0:
        sys.stdout.write(json.dumps(told) + "\n")


if __name__ == "__main__":
    main(*sys.argv[1:])
