"""Models of the sphere in turns on one core: time to an error.

python benchmarks/time_to_error.py
python benchmarks/time_to_error.py williamson5 --python /opt/peers/bin/python
python benchmarks/time_to_error.py galewsky --python shtns=/opt/a/bin/python --rounds 1
"""

from __future__ import annotations

import os
import sys
import tempfile
import tomllib
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from peer_picture import draw
from peer_process import HERE, Measured, Peer, Setting
from sections import PAGES, Section, load, measure

PATIENCE = 8.0
"""CPU time after which a setting is not run again [s]."""
BOUNDS = (1e-3, 3e-4, 1e-4, 4e-5)
OWN, BESIDE = "swe-sphere", "shtns"
COLUMNS = ["model", "resolution", "stepper", "Δt [s]", "numbers", "steps", "l2", "CPU [s]",
           "median", "wall [s]", "runs"]  # fmt: skip
NUMBERS, L2, CPU = (COLUMNS.index(name) for name in ("numbers", "l2", "CPU [s]"))


def settings(scene: str) -> list[Setting]:
    """What is to be run of a scene."""
    with (HERE / "settings.toml").open("rb") as file:
        table = tomllib.load(file)[scene]
    days = table.pop("days")
    return [Setting(scene, days, model, *row) for model, rows in table.items() for row in rows]


def race(scene: str, pythons: Mapping[str, str], core: int, rounds: int) -> Section:
    """All settings of a scene in turns, by the models that are there."""
    found = [Measured(setting) for setting in settings(scene)]
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        peers, missing = start(dict.fromkeys(m.setting.model for m in found), pythons, core, folder)
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
    return Section(scene, note, COLUMNS, [row(m) for m in found if m.setting.model in peers])


def start(
    models: Sequence[str], pythons: Mapping[str, str], core: int, folder: Path
) -> tuple[dict[str, Peer], list[str]]:
    """The models that can be started, and the names of those that cannot."""
    peers, missing = {}, []
    for model in models:
        try:
            peers[model] = Peer(model, interpreter(model, pythons), core, folder)
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
    head = [of.model, of.resolution, of.stepper, f"{of.days * 86400 / of.steps:.0f}",
            of.precision, str(of.steps)]  # fmt: skip
    if m.failure:
        return [*head, m.failure, *[""] * 4]
    if not np.isfinite(m.error):
        return [*head, "blew up", *[""] * 4]
    times = min(m.cpu), float(np.median(m.cpu)), min(m.wall)
    return [*head, f"{m.error:.2e}", *(f"{t:.3g}" for t in times), str(len(m.cpu))]


def kind(line: Sequence[str]) -> str:
    """The model of a row, and its numbers where they are not double precision."""
    return line[0] if line[NUMBERS] == "float64" else f"{line[0]}, {line[NUMBERS]}"


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
    tables = {scene: store[scene]["rows"] for scene in scenes() if scene in store}
    draw(tables, PAGES / "peers.svg")
    lines = []
    for scene, rows in tables.items():
        for bound in BOUNDS:
            best = quickest(rows, bound)
            for name in dict.fromkeys(kind(line) for line in rows):
                if name in best:
                    lines.append(
                        [scene, f"{bound:.0e}", name, *_told(best[name], best.get(BESIDE))]
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


def scenes() -> list[str]:
    """Those of settings.toml."""
    with (HERE / "settings.toml").open("rb") as file:
        return list(tomllib.load(file))


def main(
    names: Annotated[list[str] | None, typer.Argument(help="Scenes; all by default.")] = None,
    python: Annotated[
        list[str] | None, typer.Option(help="PATH, or NAME=PATH for one model; may be repeated.")
    ] = None,
    core: Annotated[int, typer.Option(help="That runs everything; by default the last.")] = -1,
    rounds: Annotated[int, typer.Option(min=1, help="Runs of each setting, in turns.")] = 3,
) -> None:
    """Run scenes and store what was measured."""
    pythons = dict(each.rpartition("=")[::2] for each in python or ())
    core = core if core >= 0 else max(os.sched_getaffinity(0))
    sections = {scene: partial(race, scene, pythons, core, rounds) for scene in scenes()}
    chosen = dict.fromkeys([*(names or scenes()), "reached"])
    measure("peers", sections | {"reached": reached}, [*chosen])


if __name__ == "__main__":
    typer.run(main)
