"""A mesh dealt out to several ranks: the same bits, whatever their number."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
import warp as wp
import xarray as xr
from ranks import fingerprint

from swe_sphere.cli.main import main
from swe_sphere.cli.run import PROCESS, start_ranks
from swe_sphere.compiling import COMPILING
from swe_sphere.errors import ConfigError
from swe_sphere.kernels.simd.memory import MOST_RUNS
from swe_sphere.mesh import Mesh
from swe_sphere.mesh.cubed_sphere import BLOCK
from swe_sphere.mesh.partition import Partition, rings, single_part
from swe_sphere.operators import DeviceMesh, Launcher
from swe_sphere.operators.device_mesh import LEAST_AWAY
from swe_sphere.ranks.communicator import (
    RANK_VARIABLES,
    SIZE_VARIABLES,
    Communicator,
    started_ranks,
)
from swe_sphere.solvers.preconditioners import PRECONDITIONERS
from swe_sphere.steppers import STEPPERS
from swe_sphere.testcases import SCENES

from .support import thorough

MPIEXEC = [str(Path(sys.executable).with_name("mpiexec")), "-n"]


def parts_of(mesh, ranks):
    partition = Partition(mesh, ranks)
    return [partition.part(rank) for rank in range(ranks)]


@pytest.fixture(scope="module")
def mesh():
    return Mesh.build(4, 3)


@pytest.fixture(scope="module")
def parts(mesh):
    return parts_of(mesh, 5)


@pytest.mark.parametrize("ne", [1, 3, 4, 5, 6])
def test_rings_touch_only_their_neighbours(ne):
    """Rings have the latitude of their belt, or are squares about a pole."""
    mesh, order = Mesh.build(ne, 3), rings(ne)
    assert sorted(order) == list(range(mesh.elements))
    sizes = [4 * (side - 1) or 1 for side in range(2 - ne % 2, ne + 1, 2)]
    sizes = [*sizes, *[4 * ne] * ne, *sizes[::-1]]
    nodes = [set(mesh.nodes[e].ravel()) for e in np.split(order, np.cumsum(sizes)[:-1])]
    for k, one in enumerate(nodes):
        touched = [j for j, other in enumerate(nodes) if one & other]
        assert touched == [j for j in (k - 1, k, k + 1) if 0 <= j < len(nodes)]


class OneOfFive(Communicator):
    """The first of five ranks, told by hand what the others have."""

    size, shared = 5, True

    def __init__(self, fields, parts):
        self._owned = [part.node_numbers[part.owned] for part in parts]
        self._fields, self.rooms = iter(fields), []

    def allgather(self, mine):
        assert np.array_equal(mine, self._owned[0])
        return self._owned

    def allgather_arrays(self, mine, counts, out=None):
        field = next(self._fields)
        assert np.array_equal(mine, field[self._owned[0]])
        self.rooms.append(out.size)
        out[:] = field[np.concatenate(self._owned)]
        return out


def test_fields_of_all_ranks_are_joined_one_after_the_other(mesh, parts):
    fields = np.random.default_rng(2).standard_normal((4, mesh.size))
    comm = OneOfFive(fields, parts)
    layout = DeviceMesh(mesh, "cpu", wp.float64, "node", comm, parts[0], Launcher("cpu"))
    state = layout.scatter(fields.ravel())
    np.testing.assert_array_equal(layout.collect(state), fields.ravel())
    assert comm.rooms == [mesh.size] * 4


def test_every_element_and_every_node_is_counted_once(mesh, parts):
    elements = np.concatenate([part.element_numbers for part in parts])
    assert sorted(elements) == list(range(mesh.elements))
    owned = np.concatenate([part.node_numbers[part.owned] for part in parts])
    assert sorted(owned) == list(range(mesh.size))
    for part in parts:
        assert np.array_equal(part.node_numbers[part.nodes], mesh.nodes[part.element_numbers])


def test_contributors_meet_in_the_order_of_the_whole_mesh(mesh, parts):
    """Numbered by their place in the mesh, and sent as ranks send them."""
    points, everything = mesh.np**2, single_part(mesh, "node")
    own = [(p.element_numbers[:, None] * points + np.arange(points)).ravel() for p in parts]
    expected = np.split(everything.contributors, np.cumsum(everything.counts)[:-1])
    for rank, part in enumerate(parts):
        sent = [own[other][parts[other].sends[rank]] for other in part.receives]
        assert [len(each) for each in sent] == [*part.receives.values()]
        there = np.concatenate([own[rank], np.concatenate(sent)[::-1]])  # -1 - k is the k-th sent
        found = np.split(there[part.contributors], np.cumsum(part.counts)[:-1])
        assert all(map(np.array_equal, found, [expected[node] for node in part.node_numbers]))


def test_elements_away_from_the_rim_stand_in_front():
    mesh = Mesh.build(9, 3)
    parts = parts_of(mesh, 5)
    holders = np.zeros(mesh.size, dtype=int)
    for part in parts:
        holders[part.node_numbers] += 1
    for part in parts:
        shared = (holders[part.node_numbers][part.nodes] > 1).any(axis=(1, 2))
        assert 0 < part.interior_elements < part.element_numbers.size
        assert not shared[: part.interior_elements].any()


def test_the_finest_meshes_here_have_elements_to_compute_behind_messages():
    cases = [[*each[4:6], lanes] for each, lanes in ((EXPLICIT[-1], 8), (SUMMING[-1], 16))]
    for ne, np_, lanes in cases:
        parts = parts_of(Mesh.build(ne, np_), 3)
        assert min(part.interior_elements // lanes for part in parts) >= LEAST_AWAY


@pytest.mark.parametrize(("ne", "points", "rank"), [(8, 4, 4), (12, 3, 2)])
def test_loads_of_whole_registers_end_inside_fields(ne, points, rank):
    """The values received on these ranks almost fill whole groups of registers."""
    mesh = Mesh.build(ne, points)
    part = Partition(mesh, 6).part(rank)
    device_mesh = DeviceMesh(mesh, "cpu", wp.float64, "element", part=part)
    runs = device_mesh.contributors["runs"].numpy().reshape(-1, 2 * MOST_RUNS)
    places = runs[runs[:, -1] > 0, :MOST_RUNS]
    assert places.min() >= 0
    assert places.max() + device_mesh.lanes <= device_mesh.rows * device_mesh.lanes


def test_large_meshes_are_dealt_out_in_blocks():
    """Inner nodes of a block of elements stand as they do in the mesh itself."""
    mesh = Mesh.build(14, 3)
    for part in parts_of(mesh, 3):
        inner = part.nodes[: part.element_numbers.size // BLOCK * BLOCK, 1, 1]
        assert inner.size > 0 and np.array_equal(inner, np.arange(inner.size))


EXPLICIT = [
    ["williamson5", "rk4", 900.0, 3, 4, 4, {}],
    ["williamson5", "leapfrog", 400.0, 4, 3, 4, {"effects": {"viscosity.nu": 1e5}}],
    ["galewsky", "forward-backward", 400.0, 4, 3, 4, {"effects": {"edge-penalty.c": 1.0}}],
    ["galewsky", "forward-backward", 100.0, 2, 18, 4, {}],
    [
        "galewsky",
        "fb-rk3",
        100.0,
        2,
        18,
        4,
        {"effects": {"viscosity.nu": 1e5, "drag.linear": 1e-5}},
    ],
    ["williamson4", "rk4", 100.0, 2, 16, 4, {"effects": {"drag.quadratic": 1e-8}}],
    ["williamson5", "rk4", 200.0, 2, 18, 4, {"effects": {"viscosity.nu": 1e5}}],
]
SUMMING = [
    ["deformational", "ssprk3", 1800.0, 3, 3, 4, {"effects": {"tracers.limiter": True}}],
    ["williamson5", "semi-implicit", 1200.0, 3, 3, 4, {}],
    ["williamson5", "bdf2", 3600.0, 3, 3, 4, {}],
    ["deformational", "ssprk3", 600.0, 2, 18, 4, {"effects": {"tracers.limiter": True}}],
    ["williamson5", "semi-implicit", 300.0, 2, 24, 4, {}],
]
"""On the finest meshes, messages go on their way before all elements are computed."""


SOME = [EXPLICIT[0], *SUMMING[:3]]
LONG = [["williamson5", "bdf2", 43200.0, 1, 6, 4, {"preconditioner": "none"}]]
"""GMRES takes more iterations than it may keep vectors."""
BY_NODE = [[*case[:6], case[6] | {"launch": "node"}] for case in (*EXPLICIT[::3], *SUMMING[1:3])]
BY_NODE[0][6]["precision"] = "float32"
MODES = {
    1: {"as-gpu reached": BY_NODE},
    2: {"plain": EXPLICIT + SUMMING, "small-basis": LONG, "as-gpu": BY_NODE},
    3: {"plain": EXPLICIT + SUMMING, "as-gpu reached": BY_NODE},
    5: {"plain": SOME, "small-basis": LONG},
}
"""By number of ranks: what they do, all of it once they have been started, which takes longer."""
CUT = [[*case[:3], 18, 8, 4, case[6]] for case in (*EXPLICIT[:3], EXPLICIT[4])]
CUT += [[*case[:3], 5, 8, 4, case[6]] for case in SUMMING[:3]]
"""Cases with enough steps for recordings, which launch strips; explicit steps are taken at once."""
FEW = [EXPLICIT[0], SUMMING[2]]
"""Cases of two ranks in the tests that are not thorough."""


@pytest.fixture(scope="module")
def mpi():
    """Skips where there is none."""
    pytest.importorskip("mpi4py")


@pytest.fixture(scope="module")
def found(mpi):
    """By number of ranks and mode: what `ranks.py` tells of each case."""
    return {ranks: fingerprints(ranks, modes) for ranks, modes in MODES.items()}


@pytest.fixture(scope="module")
def few(mpi):
    """Return what `ranks.py` prints for `FEW` on two ranks."""
    return fingerprints(2, {"plain": FEW})["plain"]


@pytest.mark.parametrize("ranks", [1, 2, thorough(3)])
def test_strips_away_from_the_rim_have_the_same_bits(mpi, ranks):
    """Messages are in transit while the strips are computed."""
    told = fingerprints(ranks, {"plain": CUT, "strips": CUT, "mixed": CUT[::3]})
    assert told["strips"] == told["plain"] and told["launched"] > 50
    assert told["mixed"] == told["plain"][::3]  # ranks without strips do not wait for the others


def fingerprints(ranks, modes):
    script = str(Path(__file__).with_name("ranks.py"))
    command = [*MPIEXEC, str(ranks), sys.executable, script, json.dumps(modes)]
    told = subprocess.check_output(command, text=True, timeout=600)
    return json.loads(told.splitlines()[-1])


def test_two_ranks_find_what_one_process_finds(few):
    """Explicit steps have the same bits; a single process sums up in another order."""
    alone = [fingerprint(*case) for case in FEW]
    assert few[0][:2] == [*alone[0][:2]]
    assert [told[1] for told in few] == pytest.approx([told[1] for told in alone], rel=1e-9)


@pytest.mark.parametrize("case", range(len(EXPLICIT)))
@pytest.mark.thorough
def test_explicit_steps_have_the_bits_of_one_process(found, case):
    expected = [*fingerprint(*EXPLICIT[case])][:2]
    two, three = (found[ranks]["plain"][case][:2] for ranks in (2, 3))
    assert two == three == expected


@pytest.mark.exhaustive
def test_every_stepper_and_every_scene_has_the_same_bits_on_any_number_of_ranks(mpi):
    """On a mesh so fine that no rank has all coarse functions of the preconditioner."""
    cases = [["williamson5", name, 600.0, 2, 12, 3, {}] for name in STEPPERS]
    cases += [
        ["williamson5", "bdf2", 600.0, 2, 12, 3, {"preconditioner": p}] for p in PRECONDITIONERS
    ]
    cases += [[name, "rk4", 60.0, 2, 2, 4, {}] for name in SCENES]
    told = (fingerprints(ranks, {"plain": cases})["plain"] for ranks in (1, 3, 6))
    one, three, six = ([each[:2] for each in of_cases] for of_cases in told)
    same = [a == b == c for a, b, c in zip(one, three, six, strict=True)]
    assert [case for case, is_same in zip(cases, same, strict=True) if not is_same] == []


def test_nothing_is_sent_but_what_others_need(few):
    """Each element node at a node that others hold goes to each of them: three float64 fields."""
    mesh = Mesh.build(*FEW[0][4:6])
    owner = {e: rank for rank, part in enumerate(parts_of(mesh, 2)) for e in part.element_numbers}
    holders = [set() for _ in range(mesh.size)]
    for e, nodes in enumerate(mesh.nodes.reshape(mesh.elements, -1)):
        for node in nodes:
            holders[node].add(owner[e])
    needed = sum(len(holders[node]) - 1 for node in mesh.nodes.ravel())
    assert few[0][2] == 24 * needed > 0


@pytest.mark.parametrize("case", range(len(SUMMING)))
@pytest.mark.thorough
def test_steps_that_sum_up_have_the_same_bits_on_any_number_of_ranks(found, case):
    """A single process sums up in another order."""
    both = (found[ranks]["plain"][len(EXPLICIT) + case] for ranks in (2, 3))
    (two, depth, _), (three, *_) = both
    assert two == three
    assert depth == pytest.approx(fingerprint(*SUMMING[case])[1], rel=1e-9)


@pytest.mark.thorough
def test_more_ranks_than_cores_have_the_same_bits(found):
    expected = [found[2]["plain"][(EXPLICIT + SUMMING).index(case)] for case in SOME]
    assert [each[:2] for each in found[5]["plain"]] == [each[:2] for each in expected]


@pytest.mark.thorough
def test_ranks_whose_parts_differ_begin_gmres_again_together(found):
    """Else they would wait for each other for ever."""
    (two,), (five,) = (found[ranks]["small-basis"] for ranks in (2, 5))
    assert two[:2] == five[:2]


@pytest.mark.thorough
def test_ranks_of_gpus_have_the_same_bits_on_any_number(found):
    """Copies by way of the host, pieces of graphs and sums by kernels, tried on a CPU."""
    modes = ["as-gpu reached", "as-gpu", "as-gpu reached"]
    one, two, three = (found[k + 1][mode] for k, mode in enumerate(modes))
    same = [a[0] == b[0] == c[0] for a, b, c in zip(one, two, three, strict=True)]
    assert same == [True] * len(BY_NODE)
    expected = [fingerprint(*case)[1] for case in BY_NODE]
    assert [told[1] for told in two] == pytest.approx(expected, rel=1e-9)


SOLVERS = {"semi-implicit", "bdf2"}


@pytest.mark.skipif(wp.get_cuda_device_count() == 0, reason="no GPU on this machine")
@pytest.mark.parametrize(
    "solves",
    [
        False,
        pytest.param(
            True, marks=pytest.mark.xfail(reason="last bits differ: docs/howto/parallel.md")
        ),
    ],
)
def test_gpus_have_the_same_bits_on_any_number_of_ranks(mpi, solves):
    """Ranks share the GPUs of the machine."""
    chosen = [case for case in (*EXPLICIT, *SUMMING) if (case[1] in SOLVERS) == solves]
    cases = [[*case[:6], case[6] | {"device": "cuda"}] for case in chosen]
    one, two, three = (fingerprints(ranks, {"plain": cases})["plain"] for ranks in (1, 2, 3))
    assert [a[0] == b[0] == c[0] for a, b, c in zip(one, two, three, strict=True)] == [True] * len(
        cases
    )


def program(*arguments, ranks=None):
    command = [sys.executable, "-m", "swe_sphere", *map(str, arguments)]
    if ranks is not None:
        command = [*MPIEXEC, str(ranks), *command]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)


def status_here(*arguments):
    """The exit status of the program in this process, which has loaded already what it needs."""
    with pytest.raises(SystemExit) as ended:
        main([*map(str, arguments)])
    return ended.value.code


def test_the_table_states_the_number_of_ranks(mpi):
    ended = program("run", "williamson2", "--ne", 2, "--days", 0.1, "--ranks", 2)
    assert "cpu, float64, 2 ranks" in ended.stdout + ended.stderr


@pytest.mark.thorough
def test_the_page_on_processes_says_how_to_start_them(mpi, tmp_path):
    """Its commands, shortened."""
    page = Path(__file__).parents[1] / "docs" / "howto" / "parallel.md"
    beside = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    env = os.environ | {"PATH": beside}
    lines = re.findall(r"^    (.*swe-sphere run .*)$", page.read_text(), re.MULTILINE)
    assert len(lines) == 2
    for line in lines:
        shortened = line.replace("--ne 30", "--ne 4").replace("--days 15", "--days 0.01 --quiet")
        program, *words = shortened.split()
        command = [str(Path(sys.executable).with_name(program)), *words]
        (tmp_path / program).mkdir()
        subprocess.run(command, cwd=tmp_path / program, check=True, timeout=300, env=env)


@pytest.mark.thorough
def test_a_run_begun_on_two_ranks_goes_on_on_one_and_on_three(mpi, tmp_path):
    run = ["run", "williamson5", "--ne", 2, "--dt", 1800, "--every", 3, "--quiet"]
    alone, several = tmp_path / "alone.nc", tmp_path / "several.nc"
    assert status_here(*run, "--days", 0.5, "--out", alone) == 0
    assert program(*run, "--days", 0.25, "--out", several, ranks=2).returncode == 0
    rest = ["--restart", several, "--out", several]
    assert status_here(*run, "--days", 0.375, *rest) == 0
    ended = program(*run, "--days", 0.5, *rest, "--ranks", 3)
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "", "")
    with xr.open_dataset(alone) as one, xr.open_dataset(several) as other:
        assert one.equals(other) and one.sizes["time"] == 5


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--ne", 1, "--ranks", 7], "at most 6 ranks"),
        pytest.param(
            ["--ne", 2, "--dt", 40000, "--days", 5, "--ranks", 2],
            "take a smaller dt",
            marks=pytest.mark.thorough,
        ),
    ],
)
def test_ranks_that_fail_say_so_in_one_line(mpi, arguments, said):
    ended = program("run", "williamson5", *arguments, "--every", 24)
    told = ended.stderr.replace(f"swe-sphere: {COMPILING}\n", "").splitlines()
    lines = [line for line in told if "warning" not in line]
    assert ended.returncode in (1, 2) and len(lines) == 1 and said in lines[0]


@pytest.mark.parametrize(
    ("deed", "said"),
    [
        # mpiexec may name several processes, or another one, if the machine is busy
        ("os.kill(os.getpid(), signal.SIGKILL)", "was killed; all frames written so far"),
        (
            "raise ValueError('what a pity')",
            "rank 1 of 3: the diagnostic fails_on_day fails: ValueError",
        ),
    ],
)
@pytest.mark.thorough
def test_a_rank_that_fails_alone_ends_the_job(mpi, tmp_path, deed, said):
    """In one line, with the frames before it in the file, from which the run goes on."""
    own, out = tmp_path / "own.py", tmp_path / "run.nc"
    own.write_text(f"""
import os, signal
from swe_sphere.ranks.communicator import world
from swe_sphere.simulation.diagnostics import diagnostic

@diagnostic(units="1", long_name="nothing")
def fails_on_day(sim):
    if sim.time > 40000 and world().rank == 1:
        {deed}
    return 0.0
""")
    run = ["run", "williamson5", "--ne", 2, "--dt", 1800, "--every", 3, "--days", 1, "--quiet"]
    ended = program(*run, "--out", out, "--diagnostics", own, "--ranks", 3)
    assert ended.returncode != 0 and ended.stdout == "" and ended.stderr.count("\n") == 1
    assert said in ended.stderr
    with xr.open_dataset(out) as frames:
        assert frames.sizes["time"] == 4
    own.write_text(own.read_text().replace(deed, "pass"))
    assert status_here(*run, "--restart", out, "--out", out, "--diagnostics", own) == 0
    with xr.open_dataset(out) as frames:
        assert frames.sizes["time"] == 9


ALONE = """
from swe_sphere import Observer, Simulation
from swe_sphere.ranks.communicator import world

class Mine(Observer):
    def begin(self, plan, snapshot):
        self.last = snapshot

    def due(self, step):
        return step % 2 == 0

    def observe(self, snapshot):
        self.last = snapshot
        if world().rank == 1 and snapshot.steps == 4:
            raise RuntimeError("only here")

    def end(self):
        self.last.fields

Simulation("williamson2", ne=2, np=4, dt=600.0).run(1.0, callbacks=[Mine()], progress=False)
"""


@pytest.mark.thorough
def test_an_observer_that_fails_on_one_rank_ends_all(mpi):
    """Before its `end`, which takes all ranks, is called."""
    command = [*MPIEXEC, "2", sys.executable, "-c", ALONE]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert ended.returncode != 0
    assert "rank 1 of 2: the observer Mine fails: RuntimeError: only here" in ended.stderr


WRONG = """
from dataclasses import dataclass
from swe_sphere import Simulation
from swe_sphere.equations.effects import PointwiseEffect
from swe_sphere.errors import ConfigError

@dataclass(frozen=True)
class Wrong(PointwiseEffect):
    name = "wrong"

    @staticmethod
    def wind_tendency(c, i, u, v, h):
        return nothing_known(u), v

told = []
try:
    Simulation("williamson2", ne=1, np=3, dt=600.0, effects=[Wrong()])
except ConfigError as error:
    told.append(str(error))
assert len(told) == 1
Simulation("williamson2", ne=1, np=3, dt=600.0).step()
"""


@pytest.mark.thorough
def test_what_fails_on_all_ranks_may_be_caught_on_all(mpi, tmp_path):
    """Rank 0 compiles for all; where it cannot, the others find so too, and none waits."""
    (tmp_path / "wrong.py").write_text(WRONG)  # Warp reads the source of a formula
    command = [*MPIEXEC, "2", sys.executable, str(tmp_path / "wrong.py")]
    ended = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    assert (ended.returncode, ended.stderr) == (0, "")


@pytest.mark.thorough
def test_ranks_may_have_fewer_nodes_than_a_register(mpi):
    run = ["williamson5", "--ne", 1, "--np", 3, "--stepper", "forward-backward", "--days", 0.1]
    ended = program("run", *run, "--precision", "float32", "--quiet", ranks=6)
    assert (ended.returncode, ended.stderr) == (0, "")


def test_more_ranks_than_there_is_memory_for_are_not_started(mpi, monkeypatch):
    monkeypatch.setattr("swe_sphere.cli.run.available_memory", lambda: 10.5 * PROCESS)
    monkeypatch.setattr(subprocess, "Popen", lambda *_, **__: pytest.fail("ranks were started"))
    with pytest.raises(ConfigError, match="ranks=300: there is memory for about 10 processes"):
        start_ranks(300, 30, ["run", "williamson2"])


@pytest.mark.parametrize("last", [["--ne", "1", "--ranks", "7"], ["--ranks", "100000"]])
def test_more_ranks_than_pieces_of_the_mesh_are_not_started(monkeypatch, capsys, last):
    monkeypatch.setattr(subprocess, "Popen", lambda *_, **__: pytest.fail("ranks were started"))
    with pytest.raises(SystemExit) as ended:
        main(["run", "williamson2", *last])
    told = capsys.readouterr()
    assert ended.value.code == 2 and told.out == "" and told.err.count("\n") == 1
    assert "ranks, got" in told.err


def test_other_commands_refuse_ranks(mpi):
    ended = program("list", ranks=2)
    assert ended.returncode == 2 and ended.stderr.count("\n") == 1


@pytest.mark.parametrize(("said", "started"), [
    ({}, None), ({"PMI_SIZE": "3"}, 3), ({"PMI_SIZE": "3", "PMI_FD": "999999"}, None),
    ({"PMI_SIZE": "1", "PMI_FD": "999999", "OMPI_COMM_WORLD_SIZE": "2"}, 2),
    ({"PMIX_RANK": "0"}, 0), ({"PMIX_RANK": "0", "SLURM_STEP_NUM_TASKS": "4"}, 4),
    ({"PMI_SIZE": "many"}, None),
])  # fmt: skip
def test_those_who_started_ranks_say_how_many(monkeypatch, said, started):
    """The inner one first, where one MPI starts another; what a rank starts hears of a socket."""
    for name in (*SIZE_VARIABLES, *RANK_VARIABLES, "PMI_FD", "SLURM_STEP_NUM_TASKS"):
        monkeypatch.delenv(name, raising=False)
    for name, value in said.items():
        monkeypatch.setenv(name, value)
    assert started_ranks() == started


def test_more_ranks_than_were_started_are_refused(mpi):
    ended = program("run", "williamson2", "--ne", 2, "--ranks", 5, ranks=2)
    assert ended.returncode == 2 and "2 are running already" in ended.stderr


@pytest.mark.thorough
def test_a_file_says_how_many_ranks(mpi, tmp_path):
    """As the flag does, which goes first; the file holds when the run goes on, too."""
    file, out = tmp_path / "run.toml", tmp_path / "run.nc"
    file.write_text(f'scene = "williamson2"\nranks = 3\nne = 2\ndays = 0.1\nout = "{out}"\n')
    run = ["run", "--config", file, "--quiet"]
    ended = program(*run, ranks=2)
    assert ended.returncode == 2 and ended.stderr.count("\n") == 1
    assert "ranks=3: 2 are running already" in ended.stderr
    for more in [("--ranks", 2), ("--restart", out, "--days", 0.2, "--out", out)]:
        ended = program(*run, *more)
        assert (ended.returncode, ended.stderr) == (0, "")


@pytest.mark.parametrize("value", ['"two"', "2.5", "true", "0", "100000"])
def test_numbers_of_ranks_that_a_file_cannot_ask_for(monkeypatch, capsys, tmp_path, value):
    monkeypatch.setattr(subprocess, "Popen", lambda *_, **__: pytest.fail("ranks were started"))
    file = tmp_path / "run.toml"
    file.write_text(f'scene = "williamson2"\nranks = {value}\n')
    with pytest.raises(SystemExit) as ended:
        main(["run", "--config", str(file)])
    told = capsys.readouterr()
    assert ended.value.code == 2 and told.out == "" and told.err.count("\n") == 1
    assert "ranks" in told.err


@pytest.mark.parametrize(("ranks", "status", "lines"), [thorough(1, 0, 0), (2, 2, 1)])
def test_a_single_rank_needs_no_mpi4py(mpi, ranks, status, lines):
    program = "import sys; sys.modules['mpi4py'] = None; from swe_sphere.cli import main; main()"
    run = ["run", "williamson2", "--ne", "2", "--days", "0.1", "--quiet"]
    command = [*MPIEXEC, str(ranks), sys.executable, "-c", program, *run]
    ended = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    told = ended.stderr.splitlines()
    assert ended.returncode == status and len(told) == lines
    assert all("no mpi4py" in line for line in told)


SCRIPTS = {
    "sim = s.Simulation('williamson2', ne=2, np=4)\nsim.step()\n"
    "if sim.comm.rank == 1: raise OverflowError('of my own')\nsim.run(days=1)": (
        "OverflowError: of my"
    ),
    "s.sweep('williamson2', 'rk4', dt=600)": "only runs of a scene support",
    "s.verify('lake-at-rest', quick=True)": "only runs of a scene support",
}


@pytest.mark.parametrize("script", SCRIPTS)
@pytest.mark.thorough
def test_a_script_that_fails_ends_on_all_ranks(mpi, script):
    command = [*MPIEXEC, "2", sys.executable, "-c", "import swe_sphere as s\n" + script]
    ended = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    assert ended.returncode != 0 and SCRIPTS[script] in ended.stderr


@pytest.mark.parametrize(("asked", "found"), [(None, 1), ("2", 2)])
def test_linear_algebra_of_a_rank_has_one_thread_unless_told_otherwise(mpi, asked, found):
    """Of libraries that are loaded before and after; threads of several ranks spin for cores."""
    code = (
        "import sys, numpy; from swe_sphere.ranks.communicator import world; world();"
        "import scipy.linalg;"
        "from threadpoolctl import threadpool_info as info;"
        "sys.exit(10 * len(info()) + max(i['num_threads'] for i in info()))"
    )
    given = {"OPENBLAS_NUM_THREADS": asked} if asked else {}
    environment = {k: v for k, v in os.environ.items() if k != "OPENBLAS_NUM_THREADS"} | given
    command = [*MPIEXEC, "2", sys.executable, "-m", "mpi4py", "-c", code]
    ended = subprocess.run(command, check=False, env=environment, timeout=300)
    threads, cores = ended.returncode % 10, len(os.sched_getaffinity(0))
    assert threads == min(found, cores) and ended.returncode > 10


@pytest.mark.parametrize(("code", "status"), [("3", 3), ("'of my own'", 1)])
def test_a_program_that_mpi4py_runs_may_exit_on_one_rank(mpi, tmp_path, code, status):
    """As the page on processes says; without, the others would wait for ever."""
    (tmp_path / "my.py").write_text(
        "from swe_sphere.ranks.communicator import world\n"
        f"if world().rank == 1: raise SystemExit({code})\nworld().allgather('all is well')"
    )
    page = (Path(__file__).parents[1] / "docs" / "howto" / "parallel.md").read_text()
    (line,) = re.findall(r"`mpiexec -n 2 python (.* my\.py)`", page)
    command = [*MPIEXEC, "2", sys.executable, *line.split()]
    ended = subprocess.run(command, check=False, cwd=tmp_path, stderr=subprocess.PIPE, timeout=300)
    assert ended.returncode == status


@pytest.mark.thorough
def test_one_rank_may_have_jobs(mpi):
    """What it starts are no ranks."""
    verify = ["verify", "--quick", "--scenes", "start-williamson2,start-williamson5", "--jobs", 2]
    ended = program(*verify, ranks=1)
    assert ended.returncode == 0 and "MPI" not in ended.stderr


@pytest.mark.skipif(sys.platform != "linux", reason="processes are found in /proc")
@pytest.mark.thorough
def test_a_rank_that_was_killed_is_named(mpi, tmp_path):
    out = tmp_path / "run.nc"
    run = ["run", "williamson5", "--ne=2", "--dt=60", "--days=20000", "--every=1", "--ranks=2"]
    command = [sys.executable, "-m", "swe_sphere", *run, f"--out={out}"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as job:
        within(300.0, out.exists)
        found = {}
        for pid in children(job.pid) - {job.pid}:
            with suppress(OSError):
                given = Path(f"/proc/{pid}/environ").read_bytes().split(b"\0")
                found |= {int(x[9:]): pid for x in given if x.startswith(b"PMI_RANK=")}
        os.kill(found[1], signal.SIGKILL)
        _, told = job.communicate(timeout=300)
    last = "swe-sphere: rank 1 of 2 was killed; all frames written so far can be read"
    assert told.splitlines()[-1] == last and job.returncode


def test_a_killed_rank_is_named_after_other_lines_too(mpi, tmp_path, monkeypatch, capfd):
    """Lines of progress do not state why the job ends."""
    (tmp_path / "mpiexec").write_text(
        "#!/bin/sh\n"
        "echo 'swe-sphere rank: 1 77' >&2; echo 'swe-sphere: day 1 of 9 after 30 s' >&2\n"
        "echo '=   PID 77 RUNNING AT here'\n"
        "echo 'YOUR APPLICATION TERMINATED WITH THE EXIT STRING: Killed (signal 9)'\n"
        "exit 9\n"
    )
    (tmp_path / "mpiexec").chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(tmp_path / "python"))
    monkeypatch.setattr(signal, "signal", lambda *_: None)  # this process goes on
    assert start_ranks(2, 4, []) == 9
    out, told = capfd.readouterr()
    last = "swe-sphere: rank 1 of 2 was killed; all frames written so far can be read"
    assert not out and told.splitlines()[-1] == last


def test_ranks_without_a_library_of_mpi_end_in_one_line(mpi, monkeypatch):
    monkeypatch.setenv("MPI4PY_LIBMPI", "/nowhere/libmpi.so")
    command = [sys.executable, "-m", "swe_sphere", "run", "williamson2", "--ne=2", "--ranks=2"]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert ended.returncode == 2 and not ended.stdout
    assert ended.stderr.splitlines() == [
        "swe-sphere: several ranks were started, but there is no MPI library for them: pip install"
        " 'spectral-swe-sphere[mpi]'"
    ]


@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGUSR1])
@pytest.mark.thorough
def test_ranks_hear_of_what_is_sent_to_what_started_them(mpi, tmp_path, sent):
    out = tmp_path / "run.nc"
    run = ["run", "williamson5", "--ne", "4", "--every", "1", "--ranks", "2", "--out", str(out)]
    run += ["--days", "20000", "--set", "hyperviscosity.nu=default"]
    command = [sys.executable, "-m", "swe_sphere", *run]
    job = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    while job.poll() is None and frames_in(out) < 2:  # before, it may not listen yet
        time.sleep(0.1)
    job.send_signal(sent)
    _, told = job.communicate(timeout=300)
    assert job.returncode == 130 and "interrupted" in told


def frames_in(file):
    """How many there are so far, in a file that comes with the first of them."""
    if not file.exists():
        return 0
    with xr.open_dataset(file) as frames:
        return frames.sizes["time"]


def children(pid):
    """All processes below one, itself included, that have not ended."""
    parents = {}
    for entry in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            state, parent = (entry / "stat").read_text().rpartition(")")[2].split()[:2]
            if state != "Z":
                parents[int(entry.name)] = int(parent)
    found = {pid}
    while more := {child for child, parent in parents.items() if parent in found} - found:
        found |= more
    return found


@pytest.mark.skipif(sys.platform != "linux", reason="processes are found in /proc")
@pytest.mark.parametrize("victim", ["swe_sphere", "mpiexec", "hydra_pmi_proxy"])
def test_no_rank_outlives_what_started_it(mpi, tmp_path, victim):
    out = tmp_path / "run.nc"
    run = ["run", "williamson5", "--ne=2", "--dt=60", "--days=20000", "--every=1", "--quiet"]
    command = [sys.executable, "-m", "swe_sphere", *run, f"--out={out}", "--ranks=2"]
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as job:
        within(300.0, out.exists)
        all_of_it = {pid: name_of(pid) for pid in children(job.pid)}
        ranks = [pid for pid, name in all_of_it.items() if name == all_of_it[job.pid]]
        assert len(ranks) == 3
        names = all_of_it | {job.pid: "swe_sphere"}
        os.kill(next(pid for pid, name in names.items() if name == victim), signal.SIGKILL)
        try:
            within(60.0, lambda: not any(name_of(pid) for pid in all_of_it))
        finally:
            for pid in filter(name_of, all_of_it):
                os.kill(pid, signal.SIGKILL)


def name_of(pid):
    """The program of a process; empty where it has ended."""
    with suppress(OSError):
        return Path(Path(f"/proc/{pid}/cmdline").read_text().split("\0")[0]).name
    return ""


def within(seconds, condition):
    begin = time.monotonic()
    while not condition():
        assert time.monotonic() - begin < seconds
        time.sleep(0.05)
