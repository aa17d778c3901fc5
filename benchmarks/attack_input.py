"""Input that is wrong in thousands of ways: each case must end in one clear line.

    python benchmarks/attack_input.py [--cases 2000] [--seed 1] [--only KIND]

Cases are valid inputs into which faults are inserted: flags of all commands, TOML files of runs,
scenes and sweeps, Python files with scenes and steppers, checkpoints, netCDF files and Zarr stores.
They run in one process, so that most of them take milliseconds.  A case fails if it ends with a
traceback, with an unexpected error, without a line that states the reason, after a minute, or with
status 0 although its input is wrong.
"""

from __future__ import annotations

import io
import json
import os
import random
import re
import shutil
import signal
import sys
import tempfile
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import netCDF4
import numpy as np
import typer

import swe_sphere.cli.main as program
from swe_sphere.io.checkpoint import checkpoint_path
from swe_sphere.pictures import plot
from swe_sphere.simulation.simulation import Simulation

SECONDS = 60
"""Time [s] after which a case counts as hanging."""
WRONG = (
    "", " ", "x", "nan", "inf", "-inf", "1e400", "-1", "0x10", "1,2", "[1]", "{}", "None", "true",
    "9" * 400, "1e-400", "\u0660", "x/y", "a" * 300, "\udcff", "--", "'", "%s", "{0}", "\x1b[31m",
    "\n",
)  # fmt: skip
"""Texts that are invalid values of most flags."""
VALUES: tuple[Any, ...] = (
    True, -1, 0, 2**70, 1.5, -1.0, 1e300, "x", "", "\u20ac", [], [1], ["x"], [[1]], {}, {"a": 1},
    None,
)  # fmt: skip
"""Values of JSON and of attributes."""
SMALL = ("--ne=2", "--np=4", "--dt=1800", "--days=0", "--quiet")
FLAGS = {
    "run": (
        "stepper", "preconditioner", "tolerance", "dt", "adaptive", "days", "ne", "np", "precision",
        "set", "diagnostics", "out", "fields", "every", "plot", "live", "restart", "trust",
        "reference", "time-limit", "stretch", "centre-lon", "centre-lat", "spin", "alpha", "device",
        "launch", "tracer-steps", "config", "ranks",
    ),
    "sweep": (
        "steppers", "dt", "levels", "ne", "np", "precision", "preconditioner", "tolerance", "days",
        "report-days", "repeats", "jobs", "time-limit", "budget", "target-error", "target-kind",
        "target-field", "target-norm", "reference", "set", "stretch", "alpha", "device", "recipe",
        "out",
    ),
    "plot": (
        "field", "time", "out", "compare", "projection", "centre", "region", "limits", "colours",
    ),
    "animate": ("field", "out", "rate", "projection", "limits"),
    "compare": ("field", "time"),
    "regrid": ("grid", "out", "fields"),
    "ensemble": ("seeds", "members", "field", "out", "stepper", "days", "ne"),
    "advise": ("error", "steppers", "days", "ne", "np", "budget"),
    "verify": ("launch", "out", "jobs"),
    "stress": ("steppers", "out", "jobs"),
}  # fmt: skip
"""Flags by command."""
TOML = {
    "run": 'scene = "williamson2"\nne = 2\nnp = 4\ndt = 1800\ndays = 0\nquiet = true\n'
    'set = ["scene.alpha=0.1"]\nevery = 1.5\nstepper = "rk4"\n',
    "scene": 'base = "williamson2"\nname = "mine"\ntitle = "t"\nne = 2\nnp = 4\ndt = 1800\n'
    "days = 0.0625\n[parameters]\nalpha = 0.5\n[effects]\nviscosity = { nu = 1e5 }\n",
    "recipe": 'title = "t"\nscene = "williamson2"\nsteppers = ["rk4"]\nne = 2\nnp = 4\n'
    "days = 0.0625\nrepeats = 1\nlevels = 1\n[[sweep]]\nname = 'a'\n[sweep.each]\nalpha = [0.1]\n",
}
PYTHON = {
    "scene": "import numpy as np\nfrom dataclasses import replace\n"
    "from swe_sphere.testcases import get_scene\n\n\ndef scene(depth: float = 1000.0):\n"
    "    def initial(lon, lat):\n        return 9.0 * np.cos(lat), 0.0 * lat, depth + 0.0 * lat\n\n"
    "    return replace(get_scene('williamson2'), name='mine', initial=initial, exact=None)\n",
    "stepper": "from swe_sphere import RungeKutta\n\n\nclass Mine(RungeKutta):\n"
    '    """Mine."""\n\n    name, order = "mine", 2\n    a = ((1 / 2,),)\n    b = (0, 1)\n',
}


@dataclass
class Case:
    """Command line of a case; is_wrong: True if its input is certainly invalid."""

    kind: str
    words: list[str]
    is_wrong: bool


class Attack:
    """Builds cases in the current folder from a valid run in the folder beside it."""

    def __init__(self, seed: int, sound: Path) -> None:
        self.chance, self.sound = random.Random(seed), sound

    def flags(self) -> Case:
        """Return a command with one or two flags that have invalid values."""
        command = self.chance.choice([*FLAGS])
        words = {
            "run": ["williamson2", *SMALL], "advise": ["williamson2"], "compare": ["run.nc"] * 2,
            "sweep": ["williamson2", "--steppers=rk4", *SMALL[:2], "--days=0.0625", "--levels=1"],
            "plot": ["run.nc"], "animate": ["run.nc"], "regrid": ["run.nc", "--grid=latlon:7x12"],
            "verify": ["--scenes=none"], "stress": ["--groups=none"],
            "ensemble": ["galewsky", "--ne=2", "--days=0.01", "--out=e"],
        }.get(command, [])  # fmt: skip
        if command == "sweep":
            words += ["--out=s", "--repeats=1"]
        name, value = self.chance.choice(FLAGS[command]), self.chance.choice(WRONG)
        words = [word for word in words if not word.startswith(f"--{name}=")]
        if self.chance.random() < 0.1:
            name = name[:-1] + self.chance.choice("qxz")  # a flag that does not exist
        self._run_files()
        numeric = name in {
            "tolerance", "dt", "adaptive", "days", "ne", "np", "every", "time-limit", "stretch",
            "spin", "alpha", "ranks", "levels", "repeats", "jobs", "budget", "error", "rate",
        }  # fmt: skip
        wrong = numeric and value not in ("\u0660", "1,2", " ", "")
        wrong &= (name, value) not in (("alpha", "-1"), ("spin", "-1"))
        return Case("flags", [command, *words, f"--{name}={value}"], wrong)

    def _run_files(self) -> None:
        for path in self.sound.iterdir():
            (shutil.copytree if path.is_dir() else shutil.copy)(path, path.name)

    def _text(self, text: str) -> str:
        """Return the text with a few bytes removed, doubled, exchanged or replaced."""
        for _ in range(self.chance.randint(1, 3)):
            at, length = self.chance.randrange(len(text)), self.chance.randint(1, 8)
            part = text[at : at + length]
            other = self.chance.choice(["", part + part, self.chance.choice(WRONG), "[", '"', "="])
            text = text[:at] + other + text[at + length :]
        return text

    def _table(self, text: str) -> str:
        """Return the TOML text with one value replaced."""
        lines = text.splitlines()
        places = [k for k, line in enumerate(lines) if "=" in line]
        key = lines[at := self.chance.choice(places)].partition("=")[0]
        values = ['"x"', "nan", "-1", "[]", "{}", "true", "1e400", "2001-01-01", "[[1]]"]
        lines[at] = f"{key}= {self.chance.choice(values)}"
        return "\n".join(lines) + "\n"

    def toml(self) -> Case:
        """Return a run, scene or sweep from a TOML file with faults."""
        which = self.chance.choice([*TOML])
        change = self.chance.choice([self._text, self._table])
        data = change(TOML[which]).encode("utf-8", "surrogateescape")
        if self.chance.random() < 0.05:
            data = TOML[which].encode("utf-16")
        Path("mine.toml").write_bytes(data)
        words = {
            "run": ["run", "--config=mine.toml"], "scene": ["run", "mine.toml", *SMALL],
            "recipe": ["sweep", "--recipe=mine.toml", "--out=s", "--quiet"],
        }[which]  # fmt: skip
        return Case("TOML", words, False)

    def python(self) -> Case:
        """Return a command that uses a scene or stepper in a Python file with faults."""
        which = self.chance.choice([*PYTHON])
        text = self._text(PYTHON[which])
        Path("mine.py").write_bytes(text.encode("utf-8", "surrogateescape"))
        words = ["mine.py"] if which == "scene" else ["williamson2", "--stepper=mine.py"]
        return Case("Python", ["run", *words, *SMALL], False)

    def checkpoint(self) -> Case:
        """Return a restart from a checkpoint with a fault in a value, an array or a byte."""
        self._run_files()
        path = checkpoint_path(Path("run.nc"))
        if self.chance.random() < 0.3:
            self._bytes(path)
        else:
            with np.load(path) as file:
                arrays = dict(file)
            header = json.loads(arrays["header"].item())
            self._spoil(header, arrays)
            arrays["header"] = np.array(json.dumps(header))
            with path.open("wb") as file:
                np.savez(file, **arrays)
        words = ["--restart=run.nc", "--days=0.125", "--quiet"]
        words += ["--out=run.nc"] if self.chance.random() < 0.3 else []
        return Case("restarts", ["run", "williamson2", *words], False)

    def _spoil(self, header: dict[str, Any], arrays: dict[str, Any]) -> None:
        what = self.chance.randrange(4)
        value = self.chance.choice(VALUES)
        if what == 0:
            header[self.chance.choice([*header])] = value
        elif what == 1:
            header["attributes"][self.chance.choice([*header["attributes"]])] = value
        elif what == 2:
            name = self.chance.choice(["configuration", "identity"])
            table = json.loads(header["attributes"][name])
            table[self.chance.choice([*table])] = value
            header["attributes"][name] = json.dumps(table)
        else:
            name = self.chance.choice([n for n in arrays if n != "header"])
            shape = self.chance.choice([(0,), (3,), (2, 2), arrays[name].shape])
            kind = self.chance.choice(["f8", "f4", "i4", "U3", "c16", "?"])
            arrays[name] = np.full(shape, 1).astype(kind)

    def _bytes(self, path: Path) -> None:
        data = bytearray(path.read_bytes())
        for _ in range(self.chance.randint(1, 4)):
            data[self.chance.randrange(len(data))] = self.chance.randrange(256)
        size = self.chance.choice([len(data), len(data), self.chance.randrange(len(data))])
        path.write_bytes(data[:size])

    def frames(self) -> Case:
        """Return a command that reads a netCDF file or Zarr store of frames with a fault."""
        self._run_files()
        file = "run.zarr" if (store := self.chance.random() < 0.3) else "run.nc"
        if store:
            names = [path for path in Path(file).rglob("*") if path.is_file()]
            path = self.chance.choice(names)
            if path.suffix == ".zmetadata" or path.name.startswith(".z"):
                path.write_text(self._text(path.read_text()), errors="surrogateescape")
            else:
                self._bytes(path)
        elif self.chance.random() < 0.4:
            self._bytes(Path(file))
        else:
            self._attribute(Path(file))
        words = self.chance.choice(
            [
                ["compare", file, "run2.nc"], ["compare", "run2.nc", file],
                ["compare", "--json", file, file], ["plot", file, "--out=p.png"],
                ["regrid", file, "--grid=latlon:7x12", "--out=g.nc"],
                ["plot", file, "--compare=exact", "--out=p.png"],
                ["run", "williamson2", f"--restart={file}", "--days=0.125", f"--out={file}"],
                ["run", "williamson2", *SMALL, f"--out={file}"],
            ]
        )  # fmt: skip
        return Case("outputs", words, False)

    def _attribute(self, path: Path) -> None:
        with netCDF4.Dataset(path, "a") as file:
            names = [*file.ncattrs()]
            value = self.chance.choice([1.5, -1, 2**30, "x", "", [1.0, 2.0], "{}", float("nan")])
            if self.chance.random() < 0.8:
                file.setncattr(self.chance.choice(names), value)
            else:
                file.delncattr(self.chance.choice(names))

    KINDS = (flags, toml, python, checkpoint, frames)


class Late(BaseException):
    """Raised if a case takes too long."""


@contextmanager
def limited() -> Iterator[None]:
    """Raise Late in a block that takes longer than a case may."""

    def late(*_: object) -> None:
        raise Late

    signal.signal(signal.SIGALRM, late)
    signal.alarm(SECONDS)
    try:
        yield
    finally:
        signal.alarm(0)


def verdict(case: Case) -> str:
    """Run a case; return what is wrong with the way it ended, empty if nothing is."""
    out, err = io.StringIO(), io.StringIO()
    status: object = None
    try:
        with limited(), redirect_stdout(out), redirect_stderr(err):
            program.main(case.words)
    except SystemExit as end:
        status = end.code
    except Late:
        return "hangs"
    except BaseException as error:
        return f"traceback: {type(error).__name__}: {error}"
    told = err.getvalue()
    lines = [line for line in told.splitlines() if line.startswith("swe-sphere: ")]
    lines = [line for line in lines if "warning:" not in line]
    if "Traceback" in told:
        return "traceback"
    if "SWE_SPHERE_DEBUG" in told:
        return f"unexpected: {told.strip()[:300]}"
    if status and (len(lines) != 1 or status not in (1, 2)):
        return f"status {status} with {len(lines)} lines: {told.strip()[:300]}"
    if not status and case.is_wrong:
        return "silent"
    return ""


def sound_run(folder: Path) -> None:
    """Write the valid files that the cases damage."""
    folder.mkdir()
    for name in ("run.nc", "run2.nc", "run.zarr"):
        sim = Simulation("williamson2", ne=2, np=4, dt=1800.0)
        sim.run(days=0.0625, every=0.5, out=folder / name, progress=False)


def main(cases: int = 2000, seed: int = 1, only: str = "") -> None:
    """Print a table of cases by kind, and every case that fails; the exit status is their number.

    only: part of the names of the kinds to try.
    """
    warnings.simplefilter("ignore")
    plot.ROWS, plot.DOTS_PER_INCH = 19, 30
    commands = typer.main.get_command(program.program())
    program.program = lambda _: commands  # built once, and not for every case
    tried: Counter[str] = Counter()
    failed: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as name:
        home = Path(name)
        sound_run(home / "sound")
        attack = Attack(seed, home / "sound")
        kinds: list[Callable[[Attack], Case]] = [
            kind for kind in Attack.KINDS if only in kind.__name__
        ]
        for number in range(cases):
            place = home / f"case{number}"
            place.mkdir()
            os.chdir(place)
            case = kinds[number % len(kinds)](attack)
            wrong = verdict(case)
            tried[case.kind] += 1
            if wrong:
                failed[case.kind] += 1
                words = re.sub(re.escape(name), "", " ".join(map(ascii, case.words)))
                sys.stdout.write(f"{number} {case.kind}: {words[:200]}\n    {wrong!a}\n")
                sys.stdout.flush()
            beside = {path.name for path in home.iterdir()} - {"sound", place.name}
            if beside:
                failed[case.kind] += 1
                sys.stdout.write(f"{number} {case.kind}: wrote {beside} outside of its folder\n")
            os.chdir(home)
            shutil.rmtree(place, ignore_errors=True)
    for kind, count in tried.items():
        sys.stdout.write(f"| {kind} | {count} | {failed[kind]} |\n")
    raise typer.Exit(min(failed.total(), 100))


if __name__ == "__main__":
    typer.run(main)
