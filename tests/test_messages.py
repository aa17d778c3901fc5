"""Messages between ranks, again and again between the same arrays."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

MPIEXEC = str(Path(sys.executable).with_name("mpiexec"))
ROUNDS = 40

SCRIPT = """
import json, random, time
import numpy as np
import warp as wp
from swe_sphere.operators.halo import Halo
from swe_sphere.operators.launch import Launcher
from swe_sphere.operators.replay import recorded
from swe_sphere.ranks.communicator import world

comm, n = world(), 1000
other, places = 1 - comm.rank, np.random.default_rng(1).permutation(n)
x = wp.zeros(2 * n, dtype=wp.float64, device="cpu")
scattered = Halo(comm, x, {other: places}, {other: n + places})
in_place = Halo(comm, x, {other: np.arange(n)}, {other: np.arange(n, 2 * n)})


def said(halo, start, wait):
    found = []
    for k in range(ROUNDS):
        x.numpy()[:n] = 100.0 * k + comm.rank + 0.001 * np.arange(n)
        time.sleep(random.choice([0.0, 0.003]))
        start()
        time.sleep(random.choice([0.0, 0.003]))
        wait()
        expected = 100.0 * k + other + 0.001 * np.arange(n)
        found.append(bool(np.array_equal(x.numpy()[n:], expected)))
    return all(found) and halo.exchanges == ROUNDS


def repeated(halo):
    launch = recorded(Launcher("cpu", comm), lambda *_: halo())
    return lambda: launch(x, x)


random.seed(comm.rank)
right = [said(scattered, scattered.start, scattered.wait), said(in_place, lambda: None, in_place)]
again = Halo(comm, x, {other: places}, {other: n + places})
right.append(said(again, lambda: None, repeated(again)))
right.append(again.bytes_sent == 8 * n * ROUNDS)
right.append(np.array_equal(comm.gather(np.full(comm.rank + 1, comm.rank), [1, 2]), [0, 1, 1]))

messages = Halo(comm, x, {other: places}, {other: n + places})
waiting = {}
for name, call in {
    "messages": messages, "gather": lambda: comm.gather(np.ones(1), [1, 1])
}.items():
    comm.tell_all(None)
    if comm.rank:
        time.sleep(1.0)
    begin = time.process_time()
    call()
    waiting[name] = time.process_time() - begin
if comm.rank == 0:
    print(json.dumps([right, waiting]))
"""


@pytest.fixture(scope="module")
def told():
    """What two ranks find: whether they got the right numbers, and CPU time spent waiting [s]."""
    pytest.importorskip("mpi4py")
    script = SCRIPT.replace("ROUNDS", str(ROUNDS))
    command = [MPIEXEC, "-n", "2", sys.executable, "-c", script]
    return json.loads(subprocess.check_output(command, text=True, timeout=300).splitlines()[-1])


def test_each_rank_gets_what_the_other_sent_in_that_round(told):
    """Whichever rank is late, scattered or in place, recorded or not."""
    right, _ = told
    assert right == [True] * 5


@pytest.mark.parametrize("kind", ["messages", "gather"])
def test_a_rank_that_waits_leaves_its_core_to_others(told, kind):
    """Of a second of waiting for the other rank, most is slept."""
    _, waiting = told
    assert waiting[kind] < 0.5
