"""Run under mpiexec: states after a few steps, as a hash and a depth, the bytes that all ranks
send for one right-hand side, and how many arrays MPI sends for them; rank 0 writes them as JSON.

Arguments: a JSON list of [scene, stepper, dt, steps, ne, np, settings], and "as-gpu" to take the
ways of GPUs on a CPU, with "reached" those of an MPI that reaches them; "small-basis" leaves GMRES
little memory; "pairs" are on one machine each, "one-without" has no memory to share.
"""

import hashlib
import json
import sys

from swe_sphere import Simulation, messages
from swe_sphere.parallel import Ranks, world
from swe_sphere.solvers import vector_space
from swe_sphere.solvers.vector_operations import DeviceVectors
from swe_sphere.steppers import implicit


def fingerprint(scene, stepper, dt, steps, ne, np, settings):
    """Of all that the stepper remembers, and of the numbers that are told of the run."""
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


def act_as_gpu(reached):
    """Messages go between pieces of what is recorded, and sums are taken by kernels for GPUs.

    Of what MPI does not reach they go by way of memory apart.
    """
    Ranks.reaches, Ranks.waits = (lambda self, device: reached), (lambda self, device: True)
    vector_space.HostVectors = lambda weights, real, mesh: DeviceVectors(weights, real, "cpu", mesh)


by_mpi_from_here = []
"""What goes by MPI, of all exchanges of this rank."""


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


if __name__ == "__main__":
    watch_mpi()
    if "pairs" in sys.argv:
        Ranks.machine = in_pairs
    if "one-without" in sys.argv and world().rank == 1:
        messages.SHARED = "/nowhere"
    if "as-gpu" in sys.argv:
        act_as_gpu(reached="reached" in sys.argv)
    if "small-basis" in sys.argv:
        implicit.KRYLOV_MEMORY = 6e5
    found = [fingerprint(*case) for case in json.loads(sys.argv[1])]
    if world().rank == 0:
        sys.stdout.write(json.dumps(found) + "\n")
