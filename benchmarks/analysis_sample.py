"""The sample of analysed winds: tests/data/analysis.nc.

    python benchmarks/analysis_sample.py

The file is not an analysis of the atmosphere but a state of this model two days after the synthetic
initial state of williamson7, on a grid of 5 degrees.  Names, dimensions, units and packing are as
in files of ERA5.
"""

from __future__ import annotations

from pathlib import Path

import netCDF4
import numpy as np

from swe_sphere import Simulation
from swe_sphere.planet import EARTH

OUT = Path(__file__).resolve().parents[1] / "tests" / "data" / "analysis.nc"
AXES = {
    "valid_time": ([0], "hours since 2000-01-03"),
    "pressure_level": ([500.0], "hPa"),
    "latitude": (np.linspace(90.0, -90.0, 37), "degrees_north"),
    "longitude": (np.arange(0.0, 360.0, 5.0), "degrees_east"),
}
MEAN = 5500.0
"""Height [m] that replaces the mean depth of the model: roughly that of 500 hPa."""


def main() -> None:
    """Run the model and write the file."""
    sim = Simulation("williamson7", ne=8, np=6, dt=300.0)
    sim.run(days=2.0)
    grid = sim.to_xarray().swe.to_latlon(37, 72).isel(lat=slice(None, None, -1)).squeeze()
    height = grid.h - 1e4 + MEAN
    fields = {"u": (grid.u, "m s**-1"), "v": (grid.v, "m s**-1"),
              "z": (height * EARTH.gravity, "m**2 s**-2")}  # fmt: skip
    with netCDF4.Dataset(OUT, "w") as file:
        file.title = "state of swe_sphere after two days of williamson7; no analysis"
        for name, (values, units) in AXES.items():
            file.createDimension(name, len(values))
            file.createVariable(name, "f8", (name,))[:] = values
            file[name].units = units
        for name, (values, units) in fields.items():
            variable = file.createVariable(name, "i2", tuple(AXES), zlib=True)
            low, high = float(values.min()), float(values.max())
            variable.setncatts({"units": units, "scale_factor": (high - low) / 65000.0,
                                "add_offset": 0.5 * (low + high)})  # fmt: skip
            variable[:] = values.values[None, None]


if __name__ == "__main__":
    main()
