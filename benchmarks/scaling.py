"""Messages and time of a step on several ranks, and a model of many ranks.

    python benchmarks/scaling.py [SECTION ...]      counts, measured, model, growth; all by default

Runs on one process and on two ranks alternate, so that other load on the machine affects all.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
from functools import cache
from itertools import product
from pathlib import Path
from time import perf_counter
from typing import Annotated, Any

import numpy as np
import typer
from memory import per_node
from scaling_bytes import Traffic
from scaling_model import NEIGHBOURS, Network, Step, as_it_is, in_trees, picture
from scaling_ranks import PIECES, STEPPERS
from sections import PAGES, Section, measure

from swe_sphere import Simulation
from swe_sphere.mesh import Mesh
from swe_sphere.mesh.partition import chunking
from swe_sphere.solvers.preconditioners.coarse import FINEST

MPIEXEC = Path(sys.executable).with_name("mpiexec")
ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1"}
"""Environment that gives BLAS one thread, as in runs on several ranks."""
ROUNDS = 6
NE, TINY, SMALL = 30, 4, 6
"""ne of the mesh on which the model is based, of few elements, and for more ranks than cores."""
HALF = {NE: 21, 60: 42}
"""ne of the timed meshes, and of those with half as many elements."""
APART = -2
"""Number of ranks that stands for two independent processes."""
CASES = [(TINY, 0), *product(HALF, (0, 2)), *product(HALF.values(), (0, APART))]
"""The timed cases: ne and number of ranks."""
BUSY = 1.5
"""Ratio of median to least time above which other programs must have been running."""
LARGE = 1024
SUPPOSED = Network(latency=2e-6, bandwidth=1e9)
"""Of a large machine: an assumption, in the range that vendors of networks give (one to two
microseconds; 25 GB/s a node, shared by its ranks)."""
GROWTH = {"rk4": (4, 8, 16, 30, 60, 120), "tr-bdf2": (4, 8, 16, 30, 60)}


def child(ranks: int, job: str, ne: int = 0, pieces: int = PIECES) -> Any:
    """Return the output of scaling_ranks.py on a number of ranks; 0: without MPI."""
    return beside(1, ranks, job, ne, pieces)[0]


def beside(copies: int, ranks: int, job: str, ne: int, pieces: int = PIECES) -> list[Any]:
    """Return the outputs of several independent copies of `child` that run at the same time."""
    script = str(Path(__file__).with_name("scaling_ranks.py"))
    command = [sys.executable, script, job, str(ne), str(pieces)]
    command = [str(MPIEXEC), "-n", str(ranks), *command] if ranks else command
    environment = ONE_THREAD | os.environ
    started = [
        subprocess.Popen(command, text=True, env=environment, stdout=subprocess.PIPE)
        for _ in range(copies)
    ]
    told = [process.communicate()[0] for process in started]
    if any(process.returncode for process in started):
        raise SystemExit(f"{' '.join(command)} has failed")
    return [json.loads(each.splitlines()[-1]) for each in told]


@cache
def timed() -> dict[tuple[int, int], dict[str, Any]]:
    """Return the measurements of all rounds by (ne, ranks), then by stepper."""
    found: dict[tuple[int, int], dict[str, Any]] = {}
    for _ in range(ROUNDS):
        for which in CASES:
            ne, ranks = which
            several = beside(2, 0, "steps", ne) if ranks == APART else [child(ranks, "steps", ne)]
            for name, told in (pair for each in several for pair in each.items()):
                of = found.setdefault(which, {})
                before = of.get(name, {"times": []})
                of[name] = told | {"times": before["times"] + told["times"]}
    return found


@cache
def network() -> Network:
    """Return latency and bandwidth between two ranks on this machine."""
    pings = {int(size): seconds for size, seconds in child(2, "ping").items()}
    small, large = min(pings), max(pings)
    return Network(pings[small], (large - small) / (pings[large] - pings[small]))


def least(times: list[float]) -> float:
    """Return the mean of the least times of all segments of a run [s]."""
    return float(np.reshape(times, (-1, PIECES)).min(axis=0).mean())


def disturbed() -> str:
    """Return a note if other programs disturbed the timings, otherwise an empty text."""
    of_all = (told["times"] for of in timed().values() for told in of.values())
    busy = any(statistics.median(times) > BUSY * least(times) for times in of_all)
    return " The machine was busy with other programs: the times here are rough." if busy else ""


@cache
def traffic(ne: int, ranks: int) -> Traffic:
    """Return the traffic between a number of ranks on a mesh."""
    return Traffic(Mesh.build(ne, 4), ranks)


@cache
def rim() -> float:
    """Return the element nodes that one of two ranks sends, over the sides on its boundary."""
    return traffic(NE, 2).on_the_rim / 2 / (4 * NE)


def step(name: str, ne: int = NE) -> Step:
    """Return times [s] of a step on one process and counts on two ranks."""
    alone, two = timed()[ne, 0][name], timed()[ne, 2][name]
    did = {key: two["traffic"].get(key, 0.0) for key in (
        "exchanges", "bytes", "sums", "sums bytes", "coarse", "coarse bytes",
    )}  # fmt: skip
    of_rank = {key: did[key] / 2 for key in ("exchanges", "sums", "coarse")}
    sent = traffic(ne, 2).on_the_rim
    large, tiny = least(alone["times"]), least(timed()[TINY, 0][name]["times"])
    fixed = max(0.0, tiny - TINY**2 * (large - tiny) / (ne**2 - TINY**2))
    return Step(
        6 * ne**2, large, fixed, alone["sweeps seconds"],
        alone["longest seconds"], of_rank["exchanges"],
        did["bytes"] / sent / of_rank["exchanges"], of_rank["sums"],
        did["sums bytes"] / max(of_rank["sums"], 1.0), of_rank["coarse"],
        did["coarse bytes"] / max(of_rank["coarse"], 1.0),
    )  # fmt: skip


def counts() -> Section:
    """Messages of a step, by number of ranks."""
    rows, bits, launched = [], {}, child(1, "launches", SMALL, 4)
    for ranks in (1, 2, 4, 8):
        to_tell = traffic(SMALL, ranks)
        for name, told in child(ranks, "steps", SMALL, 4).items():
            did, expected = told["traffic"], to_tell.bytes_sent(launched[name])
            same = bits.setdefault(name, told["bits"]) == told["bits"]
            rows.append([
                name, str(ranks), f"{np.mean(to_tell.neighbours):.1f}",
                *(f"{did.get(key, 0.0) / ranks:.1f}" for key in ("exchanges", "messages")),
                *(f"{sent:.0f}" for sent in (did.get("bytes", 0.0), expected)),
                *(f"{did.get(key, 0.0) / ranks:.1f}" for key in ("sums", "coarse")),
                "the same" if same else "OTHERS",
            ])  # fmt: skip
    rows.sort(key=lambda row: [*STEPPERS].index(row[0]))
    return Section(
        "What a step does",
        f"Counted in a run on ne {SMALL}: exchanges, messages and sums of one rank, and bytes of "
        "all ranks. Expected: counted from the mesh and from the launches of one rank; both "
        "agree byte for byte. For each node that ranks share, an element sends three fields for "
        "a right-hand side or a tangent, two for a gradient and one for a divergence, in "
        "float64, and in float32 inside the preconditioner. Each coarse correction sends the "
        "integrals over the elements around a partition and, after each sweep, one number for "
        "each coarse function in the ring around it. Sums and coarse integrals, which go from "
        "all ranks to all, are not among these bytes. Runs with more ranks than the machine has "
        "cores show only counts and bits of the state.",
        ["stepper", "ranks", "neighbours", "exchanges", "messages", "sent [B]", "expected [B]",
         "sums", "coarse integrals to all", "bits"],
        rows,
    )  # fmt: skip


def measured() -> Section:
    """Times of two ranks and of one process, measured and by the model."""
    found, net, rows = timed(), network(), []
    for (ne, small), name in product(HALF.items(), STEPPERS):
        one, two, half, apart = (
            found[which][name]["times"] for which in ((ne, 0), (ne, 2), (small, 0), (small, APART))
        )
        of, two_ranks = step(name, ne), np.array([2.0])
        model = as_it_is(of, of.elements, two_ranks, net, rim())[0]
        by_model = of.fixed + (of.seconds - of.fixed) * small**2 / ne**2
        usual = statistics.median(one) / statistics.median(two)
        possible = small**2 / ne**2 * least(one) / least(apart) * 2.0
        rows.append([
            f"{name}, ne {ne}",
            *(f"{1e3 * least(t):.2f} ({1e3 * statistics.median(t):.2f})" for t in (one, two)),
            f"{least(one) / least(two):.2f} × ({usual:.2f} ×)", f"{possible:.2f} ×",
            f"{of.seconds / model:.2f} ×", f"{least(half) / least(two):.2f}",
            f"{by_model / model:.2f}",
        ])  # fmt: skip
    return Section(
        "Two ranks, measured and by the model",
        f"Time of a step: the mean over {PIECES} segments of a run, each the shortest of {ROUNDS} "
        "rounds; the median of all is in brackets. Weak: time of a step on a mesh of half as "
        f"many elements less 2 % (ne {' and '.join(map(str, HALF.values()))}) with one process "
        "over the time with two ranks; 0.98 would be no loss. Apart: gain of two independent "
        "processes on that mesh at the same time, which is an upper bound for two cores and "
        "their memory. The model includes neither caches that two ranks "
        "share nor the iterations of another mesh. It therefore overestimates weak scaling, and "
        "the gain of two ranks with a solver. A message between the two ranks takes "
        f"{1e6 * net.latency:.1f} µs, and {net.bandwidth / 1e9:.1f} GB/s." + disturbed(),
        ["stepper", "one process [ms]", "two ranks [ms]", "gain", "apart", "by the model", "weak",
         "by the model"],
        rows,
    )  # fmt: skip


def model() -> Section:
    """Time of a step on many ranks, by the model."""
    steps = {name: step(name) for name in STEPPERS}
    picture(PAGES / "scaling.svg", steps, LARGE, SUPPOSED, rim())
    rows = []
    for name, of in steps.items():
        for ranks in (1, 64, 512, 4096, 32768, chunking(LARGE)[0]):
            given = of, 6.0 * LARGE**2, np.array([float(ranks)]), SUPPOSED, rim()
            trees, is_now = in_trees(*given)[0], as_it_is(*given)[0]
            alone = in_trees(of, 6.0 * LARGE**2, np.array([1.0]), SUPPOSED, rim())[0]
            rows.append([
                name, str(ranks), f"{6 * LARGE**2 / ranks:.0f}",
                f"{is_now:.3g}", f"{trees:.3g}", f"{100 * alone / ranks / trees:.0f} %",
            ])  # fmt: skip
    return Section(
        f"Many ranks on ne {LARGE}: a model",
        "Not measured. The time of a step is the sum of four parts: the time on a tiny mesh, "
        "which is that of Python and does not fall with more ranks; the number of elements "
        "times the time of one more element; for each exchange the latency of two messages "
        f"(of {NEIGHBOURS} for less than a ring of elements) and the bytes on the boundary of a "
        f"belt, {rim():.1f} element nodes a side (counted on ne {NE}, two ranks); and for each "
        f"sum the latency along a tree. The assumptions are {1e6 * SUPPOSED.latency:.0f} µs and "
        f"{SUPPOSED.bandwidth / 1e9:.0f} GB/s a rank, the memory bandwidth of one core here for "
        "each core, steps proportional to 1/ne, and as many iterations as on ne 30. In the "
        "present program every rank receives the sums of a few large branches from every other "
        "rank and solves for the longest waves, which ends the gain of implicit steps early. "
        "The number of partitions in the last rows is the largest number of ranks. The model "
        f"omits that the waves solved for exactly have a mesh of at most ne {FINEST}, so that ne "
        f"{LARGE} would need a further level. The last columns show the model with trees of "
        "sums and a fully distributed coarse level that is visited twice." + disturbed(),
        ["stepper", "ranks", "elements a rank", "present program [s a step]",
         "sums along trees [s a step]", "efficiency of sums along trees"],
        rows,
    )  # fmt: skip


def least_step(name: str, ne: int) -> float:
    """Return the least time of a step [s], after the steps that load kernels and start schemes."""
    sim = Simulation("williamson5", ne=ne, np=4, stepper=name)
    times = []
    for _ in range(12):
        begin = perf_counter()
        sim.step()
        times.append(perf_counter() - begin)
    return min(times[4:])


def memory_per_node(name: str, ne: int) -> float:
    """Return the peak memory of a short run beyond that of a tiny run [bytes per element node]."""
    return per_node(ne, 4, ["--stepper", name, "--days", str(0.9 / ne)])


def growth() -> Section:
    """Time and memory of one process on increasing meshes."""
    runs = [(name, ne) for name, meshes in GROWTH.items() for ne in meshes]
    # before this process is large: a child's peak begins with the memory of its parent
    taken = {run: memory_per_node(*run) for run in runs if run[1] >= NE}
    rows = []
    for name, ne in runs:
        seconds, nodes = least_step(name, ne), 6 * (4 * ne) ** 2
        memory = f"{taken[name, ne]:.0f}" if (name, ne) in taken else ""
        rows.append([
            name, str(ne), str(nodes), f"{1e3 * seconds:.3g}", f"{1e9 * seconds / nodes:.0f}",
            memory,
        ])  # fmt: skip
    return Section(
        "One process, larger and larger meshes",
        "Automatic steps: the shortest of eight after the fourth. Peak memory is that beyond a "
        "tiny run, with the set-up, which hides a part of it on small meshes. A node takes "
        "longer where arrays outgrow the caches.",
        ["stepper", "ne", "element nodes", "a step [ms]", "ns an element node",
         "bytes an element node"],
        rows,
    )  # fmt: skip


def main(sections: Annotated[list[str] | None, typer.Argument()] = None) -> None:
    """Measure sections."""
    made = {"counts": counts, "measured": measured, "model": model, "growth": growth}
    measure("scaling", made, sections or [])


if __name__ == "__main__":
    typer.run(main)
