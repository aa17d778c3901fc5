"""Files of runs as xarray datasets."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from swe_sphere.io.runfile import RunFile

if TYPE_CHECKING:
    import xarray as xr


def open_run(path: str | os.PathLike[str], chunks: Mapping[str, int] | None = None) -> xr.Dataset:
    """The file of a run as an xarray dataset: fields on (time, node), series of diagnostics.

    Times are seconds since the start; what the summary of the run says is among the attributes.
    `ds.swe` makes other grids, spectra, streamfunctions, errors and pictures of it: see
    `swe_sphere.analysis.accessor`.

    Args:
        chunks: None: all is read at once.  {"time": 1}: frames are read when they are needed, by
            dask, which must be installed.

    Examples:
        >>> from swe_sphere import Simulation, open_run
        >>> sim = Simulation("williamson2", ne=2, np=4, dt=3600)
        >>> summary = sim.run(days=1, every=6, out="quick.nc")
        >>> run = open_run("quick.nc")
        >>> run.h.dims, run.sizes["time"], run.attrs["completed"]
        (('time', 'node'), 5, True)
        >>> run.swe.to_latlon(19, 36).h.shape
        (5, 19, 36)

    Raises:
        ConfigError: the file is missing, damaged or of another kind.
    """
    import xarray as xr

    from swe_sphere.analysis import accessor  # noqa: F401 - registers `ds.swe`

    found = RunFile(path).attributes
    raw: dict[str, Any] = {"decode_times": False, "mask_and_scale": False}  # whole numbers stay so
    if chunks is not None:
        return xr.open_dataset(path, **raw, chunks=dict(chunks)).assign_attrs(found)
    with xr.open_dataset(path, **raw) as dataset:
        return dataset.load().assign_attrs(found)
