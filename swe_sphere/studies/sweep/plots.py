"""The xarray accessor `ds.sweep`: figures of a sweep for print."""

from __future__ import annotations

from typing import TYPE_CHECKING

import xarray as xr

from swe_sphere.errors import ConfigError, unknown_name

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@xr.register_dataset_accessor("sweep")  # type: ignore[no-untyped-call]
class SweepFigures:
    """Figures of the first mesh of a sweep: those of errors on its page, and `plot_limits`.

    `sweep` registers this accessor; so does `import swe_sphere.studies.sweep`, for a dataset read
    from sweep.nc.  Methods return the axes; with more than eight curves each family has a panel,
    and the first one is returned.  `axes.figure.savefig("cost.pdf")` writes a file.

    ax: axes to draw into, None for a new figure.  width: width of a new figure [mm].  kind:
    "time", "total" or "slow" error, None for the one that ranks the steppers.

    Every method raises ConfigError if the dataset is not of a sweep, or lacks that error.
    """

    def __init__(self, data: xr.Dataset) -> None:
        self._data = data if "run" in data.dims else data.expand_dims("run")

    def plot_cost(
        self, ax: Axes | None = None, width: float = 84.0, kind: str | None = None
    ) -> Axes:
        """Draw the error against the time of the steps."""
        return self._drawn("cost", ax, width, kind)

    def plot_step_size(
        self, ax: Axes | None = None, width: float = 84.0, kind: str | None = None
    ) -> Axes:
        """Draw the error against the step, with limits of leapfrog and wind, and breakdowns."""
        return self._drawn("dt", ax, width, kind)

    def plot_limits(self, ax: Axes | None = None, width: float = 84.0) -> Axes:
        """Draw the steps of each stepper: markers for completed runs, crosses for breakdowns."""
        return self._drawn("", ax, width, None)

    def _drawn(self, x: str, ax: Axes | None, width: float, kind: str | None) -> Axes:
        from swe_sphere.studies.report import figures, page

        section = page.read_sections(self._data)[0]
        draw, known = figures.draw_limits, {of.metric.kind: of for of in section.rankings}
        if x and not known:
            raise ConfigError(section.headline)
        if kind is not None and kind not in known:
            raise unknown_name("kind of error", kind, known)
        if x:
            ranking = known[kind or next(iter(known))]
            draw = figures.Curves(x, ranking.metric, ranking.floor).draw
        if ax is None:
            from matplotlib import pyplot

            return figures.figure_of(draw, section.runs, width, pyplot.figure).axes[0]
        draw(ax, section.runs)
        return ax
