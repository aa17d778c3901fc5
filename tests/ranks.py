"""Run under mpiexec: states after a few steps, as a hash and a depth, and the bytes that all ranks
send for one right-hand side; rank 0 writes them as JSON.

Argument: JSON of cases by mode, where a case is [scene, stepper, dt, steps, ne, np, settings]; one
start serves all modes, as it takes longer than most cases.  Modes: "plain"; "as-gpu" takes the ways
of GPUs on a CPU, "as-gpu reached" those of an MPI that reaches them; "small-basis" leaves GMRES
little memory; "strips" cuts small parts into strips and writes how often these were launched,
"mixed" those of rank 0 alone.
"""

import hashlib
import json
import sys
from contextlib import contextmanager
from unittest.mock import patch

from swe_sphere import Simulation
from swe_sphere.mesh import partition
from swe_sphere.operators import device_mesh, strips
from swe_sphere.operators.halo import Halo
from swe_sphere.ranks.communicator import Communicator, world
from swe_sphere.solvers import vector_space
from swe_sphere.steppers import implicit


def fingerprint(scene, stepper, dt, steps, ne, np, settings):
    """Of all that the stepper remembers, and of the numbers that are told of the run."""
    sim = Simulation(scene, stepper=stepper, dt=dt, ne=ne, np=np, **settings)
    sim.step()
    while sim.steps < steps:
        sim.take(steps - sim.steps)
    states = sim.stepper.state_dict()
    numbers = repr([sim.diagnostics, sim.counts() | {"wall_seconds": 0, "setup_seconds": 0}])
    parts = [states[name].tobytes() for name in sorted(states)] + [numbers.encode()]
    told = hashlib.sha256(b"".join(parts)).hexdigest(), float(sim.state.h[7])
    sent, start = [], Halo.start
    with patch.object(Halo, "start", lambda halo: [sent.append(halo.going.bytes), start(halo)]):
        sim.model.tendency(sim.stepper.state, 0.0, sim.model.zeros())
    return *told, sum(sim.comm.allgather(sum(sent)))


def as_gpu(reached):
    """Sums are taken by kernels for GPUs; messages go by way of memory apart where MPI does not
    reach the array.
    """
    return [
        (Communicator, "reaches", lambda self, device: reached),
        (vector_space, "HostSpace", vector_space.DeviceSpace),
    ]


launched = []
"""Number of launches in each pass over strips in the mode "strips"."""
call = strips.StripLaunches.__call__


def count(of, group):
    launched.append(len(of._rows))
    call(of, group)


CHANGES = {
    "plain": [],
    "as-gpu": as_gpu(reached=False),
    "as-gpu reached": as_gpu(reached=True),
    "small-basis": [(implicit, "KRYLOV_MEMORY", 6e5)],
    "mixed": [
        (partition, "RINGED", 0),
        (strips, "NODES", 1),
        (device_mesh, "LEAST_AWAY", 1 if world().rank == 0 else 10**9),
    ],
    "strips": [
        (partition, "RINGED", 0),
        (strips, "NODES", 1),
        (device_mesh, "LEAST_AWAY", 1),
        (strips.StripLaunches, "__call__", count),
    ],
}
"""By mode: where, what and how it is otherwise."""


@contextmanager
def changed(mode):
    """Within the block ranks are as the mode says, and after it as before."""
    changes = CHANGES[mode]
    before = [(where, name, getattr(where, name)) for where, name, _ in changes]
    for change in changes:
        setattr(*change)
    yield
    for each in before:
        setattr(*each)


if __name__ == "__main__":
    found = {}
    for mode, cases in json.loads(sys.argv[1]).items():
        with changed(mode):
            found[mode] = [fingerprint(*case) for case in cases]
    if world().rank == 0:
        found["launched"] = len(launched)
        sys.stdout.write(json.dumps(found) + "\n")
