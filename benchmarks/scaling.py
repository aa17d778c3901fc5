"""What a step takes on one rank and on two, what is sent, and what a model makes of it.

    python benchmarks/scaling.py [--rounds 5] [--ne 30] [--write FILE.md]

Runs on one process, on one rank and on two go in turns, so that a busy moment of the machine meets
all of them; told are the least and the median time of pieces of a few steps.
"""

from __future__ import annotations

import json
import statistics
import subprocess
import sys
import time
from pathlib import Path
from typing import Annotated, Any

import matplotlib.pyplot as plt
import numpy as np
import typer

from swe_sphere import Simulation
from swe_sphere.machine import machine
from swe_sphere.mesh import Mesh
from swe_sphere.mesh.partition import partition
from swe_sphere.parallel import Alone, world

MPIEXEC = Path(sys.executable).with_name("mpiexec")
STEPPERS = {"rk4": (200.0, 4), "semi-implicit": (900.0, 2), "tr-bdf2": (1800.0, 1)}
"""Steps [s], and how many of them are timed at once."""
PIECES = 12
SIZES = (8, 1024, 16384, 131072)
"""Of messages between two ranks [bytes]."""
ROUND_TRIPS = 200


def measure(stepper: str, ne: int) -> dict[str, Any]:
    """Seconds a step, piece by piece; halo bytes and reductions a step."""
    dt, at_once = STEPPERS[stepper]
    sim = Simulation("williamson5", ne=ne, np=4, stepper=stepper, dt=dt)
    for _ in range(3):
        sim.step()
    mesh, gathered = sim.model.device_mesh, _counted(sim.comm)
    sent, times = mesh.bytes_sent, []
    for _ in range(PIECES):
        start = time.perf_counter()
        for _ in range(at_once):
            sim.step()
        times.append((time.perf_counter() - start) / at_once)
    steps = PIECES * at_once
    sent = sum(sim.comm.tell_all(mesh.bytes_sent - sent)) / steps
    return {"times": times, "bytes": sent, "reductions": len(gathered) / steps}


def _counted(comm: Alone) -> list[int]:
    """Grows by one at every message of all to all."""
    calls, gather = list[int](), comm.gather

    def counting(*arguments: Any) -> Any:
        calls.append(1)
        return gather(*arguments)

    comm.gather = counting  # type: ignore[method-assign]
    return calls


def ping_pong() -> dict[int, float]:
    """Least seconds that a message takes from one rank to the next, by its size."""
    comm, found = world(), {}
    for size in SIZES:
        mine, theirs = np.zeros(size, np.int8), np.zeros(size, np.int8)
        other = 1 - comm.rank
        back, forth = comm.channel({other: mine}, {}), comm.channel({}, {other: theirs})
        times = []
        for _ in range(ROUND_TRIPS):
            start = time.perf_counter()
            for channel in (back, forth) if comm.rank == 0 else (forth, back):
                channel.start()
                channel.wait()
            times.append(0.5 * (time.perf_counter() - start))
        found[size] = min(times)
    return found


def child(ranks: int, *arguments: str) -> dict[str, Any]:
    """What this script says on so many ranks; 0: without MPI."""
    command = [sys.executable, __file__, *arguments]
    command = [str(MPIEXEC), "-n", str(ranks), *command] if ranks else command
    told = subprocess.check_output(command, text=True)
    found: dict[str, Any] = json.loads(told.splitlines()[-1])
    return found


def predicted_bytes(mesh: Mesh, ranks: int) -> int:
    """Sent by all ranks for one right-hand side of three fields in float64.

    Counted from the mesh: an element node at a node that other ranks hold goes to each of them.
    """
    owner = np.empty(mesh.elements, dtype=int)
    for rank in range(ranks):
        owner[partition(mesh, rank, ranks).elements] = rank
    of_entry = owner[mesh.gather_entries // mesh.np**2]
    pieces = np.split(of_entry, mesh.gather_offsets[1:-1])
    return 24 * sum(p.size * (np.unique(p).size - 1) for p in pieces if p.size > 1)


def model(
    elements: float, ranks: np.ndarray, seconds: float, latency: float, bandwidth: float
) -> np.ndarray:
    """Seconds of a right-hand side, of `seconds` an element, on so many ranks.

    A compact piece of n elements has 4 sqrt(n) edges on its rim, and eight neighbours.
    """
    mine = elements / ranks
    halo = np.where(ranks > 1, 8.0 * latency + 4.0 * np.sqrt(mine) * 4 * 24 / bandwidth, 0.0)
    return mine * seconds + halo


def picture(path: Path, seconds: float, latency: float, bandwidth: float) -> None:
    """Parallel efficiency of a right-hand side by the model, for several meshes."""
    ranks = np.logspace(0, 5, 200)
    figure, axes = plt.subplots(figsize=(6.0, 3.6), layout="constrained")
    for ne in (30, 120, 512, 1024):
        elements = 6.0 * ne**2
        there = ranks[ranks <= elements]
        took = model(elements, there, seconds, latency, bandwidth)
        axes.semilogx(there, took[0] / (there * took), label=f"ne {ne}")
    axes.set(xlabel="ranks", ylabel="parallel efficiency", ylim=(0.0, 1.05))
    axes.legend(frameon=False)
    figure.savefig(path, metadata={"Date": None})


def page(found: dict[tuple[str, int], dict[str, Any]], ne: int, pings: dict[int, float]) -> str:
    """Tables of what was measured."""
    rows = [
        "| stepper | ranks | least [ms] | median [ms] | over one process, least (median)"
        " | halo [kB a step] | reductions a step |",
        "|---|---|---|---|---|---|---|",
    ]
    for (stepper, ranks), each in found.items():
        times, alone = each["times"], found[stepper, 0]["times"]
        least, median = min(times), statistics.median(times)
        ratio = f"{min(alone) / least:.2f} ({statistics.median(alone) / median:.2f})"
        rows.append(
            f"| {stepper} | {ranks or 'no MPI'} | {1e3 * least:.2f} | {1e3 * median:.2f} | {ratio}"
            f" | {each['bytes'] / 1e3:.1f} | {each['reductions']:.1f} |"
        )
    told = ", ".join(f"{1e6 * t:.1f} µs for {size} bytes" for size, t in pings.items())
    return (
        f"Measured on: {machine()}.  williamson5, ne {ne} np 4.\n\n" + "\n".join(rows)
        + f"\n\nA message from one rank to the other takes, at the least, {told}.\n"
    )  # fmt: skip


def main(
    rounds: int = 5,
    ne: int = 30,
    write: Path | None = None,
    job: Annotated[str, typer.Option(hidden=True)] = "",
) -> None:
    if job:
        told = ping_pong() if job == "ping" else measure(job, ne)
        if world().rank == 0:
            sys.stdout.write(json.dumps(told) + "\n")
        return
    found: dict[tuple[str, int], dict[str, Any]] = {}
    for _ in range(rounds):
        for stepper in STEPPERS:
            for ranks in (0, 1, 2):
                told = child(ranks, "--job", stepper, "--ne", str(ne))
                before = found.setdefault((stepper, ranks), {"times": []})
                found[stepper, ranks] = told | {"times": before["times"] + told["times"]}
    pings = {int(size): t for size, t in child(2, "--job", "ping").items()}
    text = page(found, ne, pings)
    expected, counted = 4 * predicted_bytes(Mesh.build(ne, 4), 2), found["rk4", 2]["bytes"]
    text += f"\nHalo of rk4 on two ranks: {counted:.0f} bytes a step, {expected} predicted.\n"
    sys.stdout.write(text)
    if write is not None:
        small, large = SIZES[0], SIZES[-1]
        bandwidth = (large - small) / (pings[large] - pings[small])
        seconds = min(found["rk4", 1]["times"]) / 4 / (6 * ne**2)
        picture(write.with_suffix(".svg"), seconds, pings[small], bandwidth)
        write.write_text(text)


if __name__ == "__main__":
    typer.run(main)
