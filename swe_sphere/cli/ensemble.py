"""`swe-sphere ensemble`: a scene from several seeds, and how far apart the runs drift."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import typer

from swe_sphere.cli.options import given, option, with_flags
from swe_sphere.errors import ConfigError
from swe_sphere.settings.values import names_in
from swe_sphere.simulation.config import RunConfig, make_config

WITHOUT = ("out", "plot", "live", "restart", "reference", "as_json", "quiet")


@with_flags(RunConfig, argument="scene", without=WITHOUT)
def ensemble(
    seeds: str = option("A,B,...|FIRST-LAST", "Seeds of the members.", "1-8"),
    field: str = option("NAME", "Whose spread: vorticity, h, u, ...", "vorticity"),
    folder: Path | None = option("FOLDER", "Files of the members (SCENE_ensemble)."),
    **values: Any,
) -> None:
    """Run a scene from several seeds, and show how their spread grows."""
    from swe_sphere.io.scalar_fields import check_field, derive
    from swe_sphere.studies.ensemble import run_members, spread, write_spread

    config = make_config(given(values, RunConfig))
    if not config.diagnostics:  # whose names are known when they are loaded
        check_field(field)
    if config.fields:
        derive(dict.fromkeys((*config.fields, "b"), np.zeros(1)), field)
    place = folder or Path(f"{Path(config.scene).stem}_ensemble")
    members = run_members(config, _seeds(seeds), place, typer.echo)
    found = spread(members, field)
    typer.echo(f"{'day':>6}  {'spread':>10}  growth [1/day]")
    for day, value, rate in found.itertuples(index=False):
        typer.echo(f"{day:6.4g}  {value:10.4g}  {rate:.3f}")
    for path in write_spread(found, field, place):
        typer.echo(path)


def _seeds(text: str) -> Sequence[int]:
    first, dash, last = text.partition("-")
    try:
        if dash:
            return range(int(first), int(last) + 1)
        return [int(part) for part in names_in(text)]
    except ValueError:
        raise ConfigError(f"seeds: give whole numbers, 1,2,3 or 1-8, not {text!r}") from None
