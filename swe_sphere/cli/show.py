"""What a run shows on the terminal: warnings, progress, the table at the end."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from swe_sphere.planet import DAY
from swe_sphere.simulation.config import RunConfig
from swe_sphere.simulation.prepare import Prepared
from swe_sphere.simulation.summary import Summary
from swe_sphere.simulation.watcher import Watcher

if TYPE_CHECKING:
    from rich.progress import Progress

__all__ = ["Terminal", "show_summary"]

GROUPS = {
    "error of depth": {"l1": "l1_h", "l2": "l2_h", "linf": "linf_h"},
    "error of wind": {"l1": "l1_v", "l2": "l2_v", "linf": "linf_v"},
    "drift": {"mass": "mass_drift", "energy": "energy_drift", "enstrophy": "enstrophy_drift"},
    "mean": {"vorticity": "total_vorticity", "divergence": "total_divergence"},
    "Courant number": {"gravity": "courant_gravity", "advective": "courant_advective"},
    "largest wind [m/s]": {"": "max_wind"},
}
"""Rows of the table: what stands in them, and the names in the JSON line."""


class Terminal(Watcher):
    """Warnings on stderr; a progress bar there too if it is a terminal and nobody minds."""

    def __init__(self, config: RunConfig) -> None:
        self._quiet = config.quiet
        self._wants_bar = not (config.quiet or config.as_json) and sys.stderr.isatty()
        self._bar: Progress | None = None
        self._task: Any = None

    def warn(self, text: str) -> None:
        """Print it, unless asked to be quiet."""
        if not self._quiet:
            sys.stderr.write(f"swe-sphere: warning: {text}\n")

    def compiling(self) -> None:
        """Say why nothing happens, unless asked to be quiet."""
        if not self._quiet:
            text = "compiling kernels for this scene, the first time only ..."
            sys.stderr.write(f"swe-sphere: {text}\n")

    def begin(self, prepared: Prepared) -> None:
        """Show the bar."""
        if not self._wants_bar:
            return
        plan, self._dt = prepared.plan, prepared.plan.dt
        self._end = plan.time(plan.steps) / DAY
        self._bar = _progress_bar()
        done = prepared.stepper.steps
        label = f"{prepared.scene.name}  dt {plan.dt:.4g} s"
        self._task = self._bar.add_task(label, total=plan.steps, completed=done, day="", rate="")
        self._bar.start()

    def tick(self, step: int) -> None:
        """Move the bar."""
        if self._bar is not None:
            day = f"day {step * self._dt / DAY:.2f} of {self._end:g}"
            speed = self._bar.tasks[0].speed
            rate = "" if speed is None else f"{speed:.3g} steps/s"
            self._bar.update(self._task, completed=step, day=day, rate=rate)

    def end(self) -> None:
        """Take the bar away."""
        if self._bar is not None:
            self._bar.stop()


def show_summary(summary: Summary, config: RunConfig) -> None:
    """The result as a table or a line of JSON; why it stopped early in one line on stderr."""
    if summary.reason is not None:
        named = config.out is None or str(config.out) in summary.reason
        kept = "" if named else f"; {config.out} keeps what was written"
        sys.stderr.write(f"swe-sphere: {' '.join(summary.reason.split())}{kept}\n")
    if config.as_json:
        sys.stdout.write(summary.as_json() + "\n")
    elif not config.quiet:
        _print_table(summary, config)


def _progress_bar() -> Progress:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.fields[day]}"),
        TextColumn("{task.fields[rate]}"),
        TimeRemainingColumn(),
        console=Console(stderr=True),
        transient=True,
    )


def _print_table(summary: Summary, config: RunConfig) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(show_header=False, title=_title(summary))
    for name, text in _rows(summary.as_dict(), config):
        table.add_row(name, text)
    Console(markup=False, highlight=False).print(table)


def _title(summary: Summary) -> str:
    scheme = "" if summary["scheme"] == summary["stepper"] else f" ({summary['scheme']})"
    return f"{summary['scene']} with {summary['stepper']}{scheme}"


def _rows(n: dict[str, Any], config: RunConfig) -> Iterator[tuple[str, str]]:
    """The lines of the table from the numbers of the JSON line."""
    yield "scene", str(n["title"])
    ended = "completed" if n["completed"] else "stopped early"
    yield "result", f"{ended} at day {n['days']:.6g} after {n['steps']} steps"
    yield "mesh", f"ne {n['ne']}, np {n['np']}" + _stretched(n["stretch"])
    yield "time step", _step(n)
    yield "stability limit", _limit(n)
    yield "machine", f"{n['device']}, {n['precision']}"
    yield "time", f"{n['wall_seconds']:.3g} s stepping, {n['compile_seconds']:.3g} s compiling"
    yield "right-hand sides", str(n["rhs_evaluations"])
    if n["krylov_iterations"]:
        yield "iterations", f"{n['newton_iterations']} Newton, {n['krylov_iterations']} Krylov"
    if "accepted_steps" in n:
        yield "steps in these", f"{n['accepted_steps']}, {n['rejected_steps']} taken back"
    elif n["rejected_steps"]:
        yield "rejected steps", str(n["rejected_steps"])
    if n["setups"]:
        yield "preconditioner", _preconditioner(n)
    for title, names in GROUPS.items():
        values = [
            f"{label} {n[name]:.3g}".strip() for label, name in names.items() if _there(n, name)
        ]
        if values:
            yield title, ", ".join(values)
    for name, path in {"frames": config.out, "picture": config.plot}.items():
        if path is not None:
            yield name, str(path)


def _there(numbers: dict[str, Any], name: str) -> bool:
    return numbers.get(name) is not None


def _stretched(factor: float) -> str:
    return "" if factor == 1.0 else f", refined {factor:g} times"


def _preconditioner(n: dict[str, Any]) -> str:
    name = n.get("preconditioner", "built in")
    times = "once" if n["setups"] == 1 else f"{n['setups']} times"
    return (
        f"{name}: {n['preconditioner_applications']} applications,"
        f" set up {times} in {n['setup_seconds']:.3g} s"
    )


def _limit(n: dict[str, Any]) -> str:
    return "none" if n["stable_dt"] is None else f"{n['stable_dt']:.5g} s"


def _step(n: dict[str, Any]) -> str:
    text = f"{n['dt']:.6g} s ({n['dt_rule']})"
    if abs(n["dt"] - n["dt_wanted"]) > 1e-9 * n["dt"]:
        text += f", shortened from {n['dt_wanted']:.6g} s to fit the frames"
    return text
