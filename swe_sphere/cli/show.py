"""What a run shows on the terminal: warnings, progress, the table at the end."""

import sys

from swe_sphere.simulation.config import RunConfig
from swe_sphere.simulation.progress import ProgressBar
from swe_sphere.simulation.summary import Summary


class Terminal(ProgressBar):
    """Warnings on stderr; a progress bar there too if it is a terminal and nobody minds."""

    def __init__(self, config: RunConfig) -> None:
        super().__init__(not (config.quiet or config.as_json) and sys.stderr.isatty())
        self._quiet = config.quiet

    def warn(self, text: str) -> None:
        """Print it, unless asked to be quiet."""
        if not self._quiet:
            sys.stderr.write(f"swe-sphere: warning: {text}\n")

    def compiling(self) -> None:
        """Say why nothing happens, unless asked to be quiet."""
        if not self._quiet:
            text = "compiling kernels for this scene, the first time only ..."
            sys.stderr.write(f"swe-sphere: {text}\n")


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


def _print_table(summary: Summary, config: RunConfig) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(show_header=False, title=summary.title)
    for name, text in summary.rows():
        table.add_row(name, text)
    for name, path in {"frames": config.out, "picture": config.plot}.items():
        if path is not None:
            table.add_row(name, str(path))
    Console(markup=False, highlight=False).print(table)
