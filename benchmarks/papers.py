"""Redraw figures of the literature, in docs/results/papers.

    python benchmarks/papers.py [NAME ...]

Runs williamson5, williamson6, galewsky, lauter and deformational, or those named, and draws them as
the papers do: about three minutes of CPU time. `docs/results/papers.md` describes the figures.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from cartopy import crs
from matplotlib.figure import Figure
from mixing import BELLS
from xarray import Dataset

from swe_sphere import Simulation

FOLDER = Path(__file__).resolve().parents[1] / "docs" / "results" / "papers"
DOTS = 110
SEEN = {"williamson5": 300.0, "williamson6": 0.0}
"""Central longitude of the maps [degrees]."""


def main(*names: str) -> None:
    """Draw the figures named, or all."""
    FOLDER.mkdir(exist_ok=True)
    others = {"galewsky": galewsky, "lauter": lauter, "deformational": deformational}
    for name in names or (*SEEN, *others):
        figure = others[name]() if name in others else height(name)
        figure.savefig(FOLDER / f"{name}.png", dpi=DOTS)


def height(name: str) -> Figure:
    """Draw the surface height of a case of Williamson et al. (1992) at three times."""
    days = (5, 10, 15) if name == "williamson5" else (0, 7, 14)
    damped = {} if name == "williamson5" else {"edge-penalty.c": "default"}
    sim = Simulation(name, ne=8, np=6, days=days[-1], every=24, settings=damped)
    assert sim.run(progress=False, keep=True).completed
    figure = Figure(figsize=(7.0, 9.6), layout="constrained")
    for n, day in enumerate(days):
        map_ = figure.add_subplot(3, 1, n + 1, projection=crs.PlateCarree(SEEN[name]))
        map_.set_global()
        sim.frames.swe.plot("surface", time=day, ax=map_, levels=20)
    return figure


def at_day_6(ne: int, viscosity: float) -> Dataset:
    """Return the last state of the unstable jet."""
    settings = {"viscosity.nu": viscosity} if viscosity else {}
    sim = Simulation("galewsky", ne=ne, np=6, days=6, settings=settings)
    assert sim.run(progress=False).completed
    return sim.to_xarray()


def galewsky() -> Figure:
    """Draw the vorticity of the jet at day 6 on three meshes, without and with viscosity."""
    figure = Figure(figsize=(11.0, 7.4), layout="constrained")
    for row, ne in enumerate((4, 8, 16)):
        for column, viscosity in enumerate((0.0, 1e5)):
            state = at_day_6(ne, viscosity)
            place = 2 * row + column + 1
            map_ = figure.add_subplot(3, 2, place, projection=crs.PlateCarree(180.0))
            map_.set_extent((0.0, 359.9, 10.0, 80.0), crs.PlateCarree())
            map_.set_title(f"ne{ne} np6" + (", viscosity 1e5 m²/s" if viscosity else ""))
            state.swe.plot("vorticity", ax=map_, limits=(-1.6e-4, 1.6e-4), levels=14)
    return figure


def lauter() -> Figure:
    """Draw the error of the depth in the unsteady flow of Läuter et al. (2005) over five days."""
    figure = Figure(figsize=(6.0, 4.0), layout="constrained")
    axes = figure.add_subplot(xlabel="day", ylabel="relative l2 error of the depth", yscale="log")
    for ne, np_ in ((4, 4), (8, 4), (16, 4), (4, 6), (8, 6), (4, 8)):
        sim = Simulation("lauter", ne=ne, np=np_)
        days, errors = np.arange(1, 31) / 6.0, []
        for day in days:
            assert sim.run(days=day, progress=False).completed
            errors.append(sim.diagnostics["l2_h"])
        (line,) = axes.plot(days, errors, f"C{np_ // 2 - 2}", ls={4: ":", 8: "--", 16: "-"}[ne])
        axes.annotate(
            f" ne{ne} np{np_}", (days[-1], errors[-1]), color=line.get_color(), va="center"
        )
    axes.set_xlim(0.0, 5.8)
    return figure


def deformational() -> Figure:
    """Draw two related tracers at half time of the deformational flow, without and with limiter."""
    figure = Figure(figsize=(8.0, 4.0), layout="constrained")
    curve = np.linspace(BELLS.low, BELLS.high, 100)
    for n, limiter in enumerate((False, True)):
        settings = {"tracers.limiter": limiter}
        sim = Simulation("deformational", ne=20, np=4, days=6, settings=settings)
        assert sim.run(progress=False).completed
        state = sim.to_xarray()
        axes = figure.add_subplot(
            1, 2, n + 1, xlabel="cosine bells", ylabel="correlated tracer",
            title="with the limiter" if limiter else "without limiter",
        )  # fmt: skip
        pairs = state.q_cosine_bells.values.ravel(), state.q_correlated.values.ravel()
        axes.plot(*pairs, ".", ms=1.5)
        axes.set(xlim=(-0.15, 1.05), ylim=(0.05, 1.2))
        axes.plot(curve, BELLS(curve), "k", lw=0.8)
        axes.plot(curve, BELLS.chord(curve), "k--", lw=0.8)
    return figure


if __name__ == "__main__":
    main(*sys.argv[1:])
