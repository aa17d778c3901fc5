"""More ranks than a machine has: how fine meshes are dealt out, what ranks sum up and send."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scaling_bytes import Traffic

from swe_sphere.mesh import Mesh, partition
from swe_sphere.mesh.cubed_sphere import BLOCK
from swe_sphere.mesh.partition import Partition, chunking
from swe_sphere.operators.chunks import Chunks
from swe_sphere.operators.launch import Launcher
from swe_sphere.ranks.communicator import Communicator

from .support import thorough

NE, PIECES = 74, 2054
"""The coarsest mesh of more than 512 pieces has 514; in blocks as small as may be, so many."""


@pytest.mark.parametrize(
    ("ne", "found"),
    [
        (1, (6, 1)),
        (9, (486, 1)),
        (13, (507, 2)),
        (14, (74, 16)),
        (30, (338, 16)),
        (73, (500, 64)),
        (74, (514, 64)),
        (1024, (98304, 64)),
    ],
)
def test_pieces_grow_no_further_on_fine_meshes(ne, found):
    assert chunking(ne) == found


@pytest.fixture(scope="module")
def mesh():
    return Mesh.build(NE, 3)


@pytest.fixture
def dealt_out(mesh, monkeypatch):
    """By number of ranks: the parts of all of them."""
    monkeypatch.setattr(partition, "LARGEST_CHUNK", BLOCK)
    assert chunking(NE) == (PIECES, BLOCK)

    def deal(ranks):
        dealt = Partition(mesh, ranks)
        return [dealt.part(rank) for rank in range(ranks)]

    return deal


@pytest.mark.parametrize("ranks", [700, thorough(PIECES)])
def test_thousands_of_ranks_have_each_element_and_each_node_once(mesh, dealt_out, ranks):
    parts = dealt_out(ranks)
    elements = np.concatenate([part.element_numbers for part in parts])
    owned = np.concatenate([part.node_numbers[part.owned] for part in parts])
    assert min(part.element_numbers.size for part in parts) > 0
    assert np.array_equal(np.sort(elements), np.arange(mesh.elements))
    assert np.array_equal(np.sort(owned), np.arange(mesh.size))
    sent = sum(place.size for part in parts for place in part.sends.values())
    assert sent == sum(sum(part.receives.values()) for part in parts) > 0


class OneOfMany(Communicator):
    """A rank whose others are told by hand what it sends, in `told`."""

    shared = True

    def __init__(self, rank, counts, told):
        self.rank, self.size, self._counts, self._told = rank, len(counts), counts, told

    def _wait_for_all(self):
        """All ranks are in one process."""

    def allgather(self, mine):
        assert mine == self._counts[self.rank]
        return self._counts

    def allgather_arrays(self, mine, counts, out=None):
        self._told[self.rank] = mine.copy()
        if len(self._told) == self.size:
            assert [self._told[rank].size for rank in range(self.size)] == counts
            out[:] = np.concatenate([self._told[rank] for rank in range(self.size)])
        return out


def sums(parts, fields):
    """(ranks, width) what each rank makes of the sums of all fields (width, N)."""
    told, counts = {}, [part.spans.shape[1] for part in parts]
    ranks = [
        Chunks(part, Launcher("cpu", OneOfMany(r, counts, told))) for r, part in enumerate(parts)
    ]
    for _ in range(2):  # all have sent theirs when they are asked the second time
        found = []
        for part, chunks in zip(parts, ranks, strict=True):
            nodal, sums = fields[:, part.node_numbers], chunks.partial_sums(len(fields))
            sums[: chunks.count] = [
                sum(nodal[:, slice(*span)].copy().sum(axis=1) for span in spans)
                for spans in part.spans.swapaxes(0, 1)
            ]
            found.append(chunks.total(len(fields)).copy())
    return np.array(found)


@pytest.mark.thorough
def test_sums_of_many_ranks_have_the_bits_of_one(mesh, dealt_out):
    """Of numbers whose sum has others in any other order."""
    generator = np.random.default_rng(5)
    fields = generator.standard_normal((2, mesh.size)) * 10.0 ** generator.uniform(-8, 8, mesh.size)
    (alone,), many = sums(dealt_out(1), fields), sums(dealt_out(700), fields)
    assert (many == alone).all()
    assert not np.array_equal(alone, fields.sum(axis=1))
    np.testing.assert_allclose(alone, fields.sum(axis=1), atol=1e-12 * np.abs(fields).sum())


def told_by(ranks, job):
    script = Path(__file__).parents[1] / "benchmarks" / "scaling_ranks.py"
    mpiexec = str(Path(sys.executable).with_name("mpiexec"))
    command = [mpiexec, "-n", str(ranks), sys.executable, str(script), job, "6", "1"]
    return json.loads(subprocess.check_output(command, text=True, timeout=300).splitlines()[-1])


@pytest.mark.thorough
def test_ranks_send_what_follows_from_mesh_and_launches():
    """Byte for byte, with explicit, semi-implicit and implicit steps."""
    pytest.importorskip("mpi4py")
    launched, ran, mesh = told_by(1, "launches"), told_by(2, "steps"), Mesh.build(6, 4)
    expected = {name: Traffic(mesh, 2).bytes_sent(did) for name, did in launched.items()}
    assert {name: told["traffic"]["bytes"] for name, told in ran.items()} == expected
