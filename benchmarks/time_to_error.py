"""Time to an error: models of the sphere in turns on one core, and two of them on all cores.

python benchmarks/time_to_error.py
python benchmarks/time_to_error.py williamson5 --python /opt/peers/bin/python
python benchmarks/time_to_error.py galewsky --python shtns=/opt/a/bin/python --rounds 1
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterable, Mapping, Sequence, Set
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from peer_picture import draw
from peer_process import HERE, Measured, Peer, Setting
from sections import PAGES, Section, load, measure

PATIENCE = 8.0
"""CPU time after which a setting is not run again [s]."""
BOUNDS = (1e-3, 3e-4, 1e-4, 4e-5)
"""Errors of the table of least times, for scenes without bounds in settings.toml."""
OWN, BESIDE = "swe-sphere", "shtns"
COLUMNS = ["model", "resolution", "stepper", "Δt [s]", "precision", "steps", "l2", "CPU [s]",
           "median", "wall [s]", "runs"]  # fmt: skip
PRECISION, L2, CPU = (COLUMNS.index(name) for name in ("precision", "l2", "CPU [s]"))


def tables() -> dict[str, dict[str, Any]]:
    """Return settings.toml."""
    with (HERE / "settings.toml").open("rb") as file:
        return tomllib.load(file)


def settings(name: str) -> list[Setting]:
    """Return the settings of a table of settings.toml."""
    table = tables()[name]
    days, scene, models = table["days"], table.get("scene", name), table["models"]
    return [Setting(scene, days, model, *row) for model, rows in models.items() for row in rows]


def race(name: str, pythons: Mapping[str, str], core: int, rounds: int) -> Section:
    """Run all settings of a table in turns, by the models that are installed."""
    found = [Measured(setting) for setting in settings(name)]
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        models = dict.fromkeys(m.setting.model for m in found)
        peers, missing = start(models, pythons, {core}, folder)
        for peer in peers.values():
            stack.enter_context(peer)
        for _ in range(rounds):
            for measured in found:
                if measured.setting.model in peers and sum(measured.cpu) < PATIENCE:
                    peers[measured.setting.model].run(measured)
        versions = ", ".join(f"{name} {peer.version}" for name, peer in peers.items())
    note = f"Day {found[0].setting.days:g}.  {versions}."
    if missing:
        note += f"  Not there: {', '.join(missing)}."
    return Section(name, note, COLUMNS, [row(m) for m in found if m.setting.model in peers])


def cores(pythons: Mapping[str, str], rounds: int) -> Section:
    """Time the same steps on one core and on all: threads of SHTns, ranks of this model."""
    every = os.sched_getaffinity(0)
    lines, sets = [], ({max(every)}, every)
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        peers = [start([BESIDE], pythons, each, folder)[0] for each in sets]
        for peer in peers:
            for each in peer.values():
                stack.enter_context(each)
        pairs = [*zip(peers, map(len, sets), strict=True)]
        known = [of for of in settings("all-cores") if of.model == OWN or all(peers)]
        for of in known:
            walls = [[wall_time(of, *each, folder) for each in pairs] for _ in range(rounds)]
            one, more = map(min, zip(*walls, strict=True))
            numbers = f"{of.step:.0f}", f"{one:.3g}", f"{more:.3g}", f"{one / more:.2f}"
            lines.append([of.scene, of.model, of.resolution, of.stepper, *numbers])
    many = len(every)
    note = (
        f"Wall times of the steps of one day, the shortest of {rounds} runs in turns: on one core,"
        f" and on {many} cores with a thread (shtns) or a rank (swe-sphere) on each."
    )
    columns = ["scene", "model", "resolution", "stepper", "Δt [s]"]
    columns += ["one core [s]", f"{many} cores [s]", "speed-up"]
    return Section("One core and all cores", note, columns, lines)


def wall_time(of: Setting, peers: Mapping[str, Peer], count: int, folder: Path) -> float:
    """Return the wall time [s] of the steps of a setting: in its peer, or on ranks of this model.

    peers: models in processes with `count` cores.
    """
    if of.model != OWN:
        peers[of.model].run(measured := Measured(of), compare=False)
        return min(measured.wall)
    ne, np_ = of.mesh
    command = [
        sys.executable, "-m", "swe_sphere", "run", of.scene, "--ne", str(ne), "--np", str(np_),
        "--stepper", of.stepper, "--dt", repr(of.step), "--days", f"{of.days:g}",
        "--ranks", str(count), "--out", str(folder / "run.nc"), "--overwrite", "--json",
    ]  # fmt: skip
    told = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    return float(json.loads(told)["wall_seconds"])


def start(
    models: Iterable[str], pythons: Mapping[str, str], among: Set[int], folder: Path
) -> tuple[dict[str, Peer], list[str]]:
    """Start models on the cores `among`; return them and the names of those that fail to start."""
    peers, missing = {}, []
    for model in models:
        try:
            peers[model] = Peer(model, interpreter(model, pythons), among, folder)
        except OSError as error:
            typer.echo(f"{model} is left out: {error}", err=True)
            missing.append(model)
    return peers, missing


def interpreter(model: str, pythons: Mapping[str, str]) -> str:
    """The one named for the model, or that of all others, or this one, which always runs ours."""
    return pythons.get(model) or (pythons.get("") if model != OWN else None) or sys.executable


def row(m: Measured) -> list[str]:
    """A line of the table."""
    of = m.setting
    head = [of.model, of.resolution, of.stepper, f"{of.step:.0f}",
            of.precision, str(of.steps)]  # fmt: skip
    if m.failure:
        return [*head, m.failure, *[""] * 4]
    if not np.isfinite(m.error):
        return [*head, "blew up", *[""] * 4]
    times = min(m.cpu), float(np.median(m.cpu)), min(m.wall)
    return [*head, f"{m.error:.2e}", *(f"{t:.3g}" for t in times), str(len(m.cpu))]


def kind(line: Sequence[str]) -> str:
    """The model of a row, and its numbers where they are not double precision."""
    return line[0] if line[PRECISION] == "float64" else f"{line[0]}, {line[PRECISION]}"


def quickest(rows: Sequence[Sequence[str]], bound: float) -> dict[str, Sequence[str]]:
    """Of each kind the cheapest row of a table whose error is no larger than the bound."""
    best: dict[str, Sequence[str]] = {}
    for line in rows:
        if not line[CPU] or float(line[L2]) > bound:
            continue
        if kind(line) not in best or float(line[CPU]) < float(best[kind(line)][CPU]):
            best[kind(line)] = line
    return best


def reached() -> Section:
    """The least time of each kind to each error, from the tables that there are."""
    store = load("peers")
    known = {name: of for name, of in tables().items() if name in store and name != "all-cores"}
    bounds = {name: of.get("bounds") for name, of in known.items()}
    draw({name: store[name]["rows"] for name, of in bounds.items() if not of}, PAGES / "peers.svg")
    lines = []
    for scene in bounds:
        rows = store[scene]["rows"]
        for bound in bounds[scene] or BOUNDS:
            best = quickest(rows, bound)
            for name in dict.fromkeys(kind(line) for line in rows):
                if name in best:
                    lines.append(
                        [scene, f"{bound:.1e}", name, *_told(best[name], best.get(BESIDE))]
                    )
    return Section(
        "The least time to an error",
        f"The cheapest setting of each model whose error is no larger; the ratio is to {BESIDE}.",
        ["scene", "l2 ≤", "model", "setting", "CPU [s]", "ratio"],
        lines,
    )


def _told(line: Sequence[str], beside: Sequence[str] | None) -> list[str]:
    """Setting, time, and the time over that of the other."""
    ratio = f"{float(line[CPU]) / float(beside[CPU]):.2f}" if beside else ""
    return [f"{line[1]}, {line[2]}, {line[3]} s", line[CPU], ratio]


def main(
    names: Annotated[
        list[str] | None, typer.Argument(help="Tables of settings.toml; all by default.")
    ] = None,
    python: Annotated[
        list[str] | None, typer.Option(help="PATH, or NAME=PATH for one model; may be repeated.")
    ] = None,
    core: Annotated[int, typer.Option(help="That runs everything; by default the last.")] = -1,
    rounds: Annotated[int, typer.Option(min=1, help="Runs of each setting, in turns.")] = 3,
) -> None:
    """Run scenes and store what was measured."""
    pythons = dict(each.rpartition("=")[::2] for each in python or ())
    core = core if core >= 0 else max(os.sched_getaffinity(0))
    sections = {name: partial(race, name, pythons, core, rounds) for name in tables()}
    sections |= {"all-cores": partial(cores, pythons, rounds), "reached": reached}
    measure("peers", sections, [*dict.fromkeys([*(names or sections), "reached"])])


if __name__ == "__main__":
    typer.run(main)
