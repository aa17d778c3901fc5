"""`swe-sphere run`: flags and configuration file to a run, and its result to the terminal."""

from pathlib import Path
from typing import Any

import typer

from swe_sphere.cli.options import given, option, with_flags
from swe_sphere.cli.ranks import start_ranks
from swe_sphere.cli.show import Stopped, explain, progress, show_summary, show_warning
from swe_sphere.compiling import on_compile
from swe_sphere.errors import ConfigError
from swe_sphere.ranks.communicator import world
from swe_sphere.settings.values import validated
from swe_sphere.simulation.build import make_scene
from swe_sphere.simulation.config import RunConfig, Whole, load_config, make_config
from swe_sphere.simulation.restart import adopt, read_restart
from swe_sphere.simulation.simulation import run as run_scene
from swe_sphere.simulation.summary import Summary, failed_summary


class Asked(RunConfig):
    """What flags and the file say."""

    ranks: Whole | None = None
    """Processes that share the mesh, by MPI."""

    def of_run(self) -> RunConfig:
        """Without the number of processes, on which the run does not depend."""
        return make_config({name: x for name, x in self.given().items() if name != "ranks"})


@with_flags(RunConfig, argument="scene")
def run(
    context: typer.Context,
    config: Path | None = option("FILE.toml", "Options by name; flags go first."),
    ranks: int | None = option("P", "Processes that share the mesh, by MPI."),
    **values: Any,
) -> int:
    """Run a scene and report errors, conservation and cost."""
    comm = world()
    said = given(values | {"ranks": ranks}, Asked)
    try:
        said = said if config is None else load_config(config) | said
        told = validated(Asked, said)
        asked, ranks = told.of_run(), told.ranks
        if ranks is not None and not comm.shared:
            return start_ranks(ranks, _ne(asked), context.obj)
        if ranks not in (None, comm.size):
            raise ConfigError(f"ranks={ranks}: {comm.size} have been started: leave ranks out")
        summary = _run(asked)
    except Exception as error:
        if said.get("as_json") and comm.rank == 0:
            typer.echo(failed_summary(said, *explain(error)).as_json())
        raise
    if comm.rank == 0:
        show_summary(summary, asked)
    return summary.exit_status


def _ne(asked: RunConfig) -> int:
    """Of the mesh that the run will have."""
    before = asked if asked.restart is None else adopt(asked, read_restart(asked))
    return make_scene(before).ne if before.ne is None else before.ne


def _run(asked: RunConfig) -> Summary:
    if world().rank:
        return run_scene(asked)
    try:
        if asked.quiet:
            with on_compile(lambda: None):
                return run_scene(asked)
        return run_scene(asked, progress(asked), show_warning)
    except KeyboardInterrupt:
        raise Stopped("interrupted by Ctrl-C") from None
