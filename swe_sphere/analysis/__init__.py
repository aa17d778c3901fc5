"""Analysis of runs: other grids, spectra, streamfunctions, as the xarray accessor `ds.swe`."""
