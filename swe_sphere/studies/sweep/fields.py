"""Fields of reference runs on disk, so that a sweep that goes on need not make them again."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from swe_sphere.durable import write_whole
from swe_sphere.studies.sweep.bench import FIELDS, Fields

__all__ = ["load_fields", "save_fields"]


def save_fields(path: Path, fields: Mapping[float, Fields], label: str) -> None:
    """Write u, v, h and vorticity (N,) at report days to a netCDF file, whole or not at all.

    Raises:
        RunFailed: the disk does not take it.
    """
    import netCDF4

    file = netCDF4.Dataset(path.name, "w", memory=0)
    file.title = label
    file.createDimension("report_day", len(fields))
    file.createDimension("node", next(iter(fields.values()))["h"].size)
    file.createVariable("report_day", "f8", ("report_day",))[:] = list(fields)
    for name in FIELDS:
        values = np.stack([moment[name] for moment in fields.values()])
        file.createVariable(name, "f8", ("report_day", "node"))[:] = values
    write_whole(path, bytes(file.close()))


def load_fields(path: Path) -> dict[float, Fields] | None:
    """What `save_fields` wrote; None where there is no such file or it cannot be read."""
    import netCDF4

    try:
        with netCDF4.Dataset(path) as file:
            days = file["report_day"][:].data.tolist()
            arrays = {name: file[name][:].data for name in FIELDS}
        return {day: {name: arrays[name][i] for name in FIELDS} for i, day in enumerate(days)}
    except (OSError, RuntimeError, LookupError):
        return None
