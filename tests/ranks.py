"""Run under mpiexec: states after a few steps, as a hash and a depth, the bytes that all ranks
send for one right-hand side, and how many arrays MPI sends for them; rank 0 writes them as JSON.

Argument: JSON of cases by mode, where a case is [scene, stepper, dt, steps, ne, np, settings]; one
start serves all modes, as it takes longer than most cases.  Modes: "plain"; "as-gpu" takes the ways
of GPUs on a CPU, "as-gpu reached" those of an MPI that reaches them; "small-basis" leaves GMRES
little memory; "pairs" are on one machine each, "one-without" has no memory to share.
"""

import hashlib
import json
import sys
from contextlib import contextmanager

from swe_sphere import Simulation, messages
from swe_sphere.ranks.parallel import Ranks, world
from swe_sphere.solvers import vector_space
from swe_sphere.solvers.vector_operations import DeviceVectors
from swe_sphere.steppers import implicit


def fingerprint(scene, stepper, dt, steps, ne, np, settings):
    """Of all that the stepper remembers, and of the numbers that are told of the run."""
    by_mpi_from_here.clear()
    sim = Simulation(scene, stepper=stepper, dt=dt, ne=ne, np=np, **settings)
    for _ in range(steps):
        sim.step()
    states = sim.stepper.state_dict()
    numbers = repr([sim.diagnostics, sim.counts() | {"wall_seconds": 0, "setup_seconds": 0}])
    parts = [states[name].tobytes() for name in sorted(states)] + [numbers.encode()]
    told = hashlib.sha256(b"".join(parts)).hexdigest(), float(sim.state.h[7])
    mesh, before = sim.model.device_mesh, sim.model.device_mesh.bytes_sent
    sim.model.tendency(sim.stepper.state, 0.0, sim.model.zeros())
    sent, by_mpi = mesh.bytes_sent - before, sum(map(len, by_mpi_from_here))
    return *told, *(sum(sim.comm.tell_all(each)) for each in (sent, by_mpi))


by_mpi_from_here = []
"""What goes by MPI, of all exchanges of this rank in a case."""


def watch_mpi():
    """Have `by_mpi_from_here` filled."""
    build = messages.Requests.__init__

    def watched(requests, comm, outgoing, incoming):
        outgoing = dict(outgoing)
        by_mpi_from_here.append(outgoing)
        build(requests, comm, outgoing, incoming)

    messages.Requests.__init__ = watched


def in_pairs(self):
    """As if no more than two of them were on a machine."""
    from mpi4py import MPI

    return MPI.COMM_WORLD.Split(MPI.COMM_WORLD.rank // 2)


def as_gpu(reached):
    """Messages go between pieces of what is recorded, and sums are taken by kernels for GPUs.

    Of what MPI does not reach they go by way of memory apart.
    """
    return [
        (Ranks, "reaches", lambda self, device: reached),
        (Ranks, "waits", lambda self, device: True),
        (
            vector_space,
            "HostVectors",
            lambda weights, real, mesh: DeviceVectors(weights, real, "cpu", mesh),
        ),
    ]


CHANGES = {
    "plain": [],
    "as-gpu": as_gpu(reached=False),
    "as-gpu reached": as_gpu(reached=True),
    "small-basis": [(implicit, "KRYLOV_MEMORY", 6e5)],
    "pairs": [(Ranks, "machine", in_pairs)],
    "one-without": [(messages, "SHARED", "/nowhere")],
}
"""By mode: where, what and how it is otherwise; "one-without" on rank 1 alone."""


@contextmanager
def changed(mode):
    """Within the block ranks are as the mode says, and after it as before."""
    changes = CHANGES[mode] if mode != "one-without" or world().rank == 1 else []
    before = [(where, name, getattr(where, name)) for where, name, _ in changes]
    for change in changes:
        setattr(*change)
    world.cache_clear()  # ranks find out who is on their machine when they are made
    yield
    for each in before:
        setattr(*each)
    world.cache_clear()


if __name__ == "__main__":
    watch_mpi()
    found = {}
    for mode, cases in json.loads(sys.argv[1]).items():
        with changed(mode):
            found[mode] = [fingerprint(*case) for case in cases]
    if world().rank == 0:
        sys.stdout.write(json.dumps(found) + "\n")
