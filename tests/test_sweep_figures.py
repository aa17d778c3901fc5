"""Figures of a sweep from Python: `ds.sweep.plot_cost`, `plot_step_size` and `plot_limits`."""

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.colors import to_hex
from sweeps import make_sweep, plausible_sweep

import swe_sphere.studies.sweep  # registers the accessor
from swe_sphere.errors import ConfigError
from swe_sphere.studies.report.figures import PALE

mpl.use("Agg")
MANY = (
    "rk4", "kg5", "ssprk3", "leapfrog", "ark2", "semi-implicit", "bdf2", "tr-bdf2", "sdirk3", "mine"
)  # fmt: skip


@pytest.fixture(scope="module")
def dataset():
    return plausible_sweep()


@pytest.fixture(autouse=True)
def figures_are_closed():
    yield
    plt.close("all")


def labels(axes):
    return [text.get_text() for text in axes.get_legend().get_texts()]


def texts(axes):
    return [text.get_text() for text in axes.texts]


def test_a_new_figure_has_the_width_of_a_column(dataset):
    for width in (84.0, 174.0):
        figure = dataset.sweep.plot_cost(width=width).figure
        assert figure.get_size_inches()[0] * 25.4 == pytest.approx(width)


@pytest.mark.parametrize("name", ["plot_cost", "plot_step_size", "plot_limits"])
def test_figures_are_drawn_into_axes_of_the_user(dataset, name, tmp_path):
    _, (left, right) = plt.subplots(1, 2)
    assert getattr(dataset.sweep, name)(ax=right) is right
    assert right.lines and not left.lines
    right.figure.savefig(tmp_path / "figure.pdf")
    assert b"/FontFile" in (pdf := (tmp_path / "figure.pdf").read_bytes()) or b"/Type3" in pdf


def test_curves_are_named_in_the_order_of_families(dataset):
    expected = ["leapfrog", "rk4", "semi-implicit", "ars343", "tr-bdf2", "bdf2", "esdirk4"]
    assert labels(dataset.sweep.plot_cost()) == expected
    rows = [text.get_text() for text in dataset.sweep.plot_limits().get_yticklabels()]
    assert rows == expected


def test_a_bar_marks_the_spectral_limit_of_each_stepper_that_has_one(dataset):
    drawn = dataset.sweep.plot_limits().lines
    bars = {line.get_ydata()[0]: line.get_xdata()[0] for line in drawn if line.get_marker() == "|"}
    runs = dataset.to_dataframe().groupby("stepper")["stable_dt"].max()
    rows = ["leapfrog", "rk4", "semi-implicit", "ars343", "tr-bdf2", "bdf2", "esdirk4"]
    expected = {row: runs[name] for row, name in enumerate(rows) if np.isfinite(runs[name])}
    assert bars == pytest.approx(expected) and 0 < len(bars) < len(rows)


def test_axes_say_that_errors_are_relative(dataset):
    label = dataset.sweep.plot_cost(kind="total").get_ylabel()
    assert label == "relative total error\nl2(h)"
    assert "potential vorticity" in dataset.sweep.plot_step_size().get_ylabel()


def test_the_error_of_the_reference_is_a_band_where_errors_are_against_it(dataset):
    assert "error of the reference" in texts(dataset.sweep.plot_step_size(kind="time"))
    assert "error of the reference" not in texts(dataset.sweep.plot_step_size(kind="total"))


@pytest.mark.parametrize("order", [2, 4])
def test_triangles_show_the_slopes_of_the_curves(order):
    runs = [
        {"dt": dt, "cpu_seconds": 1e3 / dt, "errors": {("total", "h"): 1e-12 * dt**order}}
        for dt in (100.0, 200.0, 400.0)
    ]
    figures = make_sweep(*runs).sweep
    for axes in (figures.plot_cost(), figures.plot_step_size()):
        assert f"{order}" in texts(axes)
        triangle = axes.lines[-1]
        x, y = np.log(triangle.get_data())
        assert abs((y[1] - y[0]) / (x[1] - x[0])) == pytest.approx(order)


def test_failed_runs_are_crosses_at_the_top(dataset):
    failed = {line.get_ydata()[0] for line in dataset.sweep.plot_step_size().lines
              if line.get_marker() == "x"}  # fmt: skip
    assert failed == {0.98}


def test_many_curves_get_a_panel_for_each_family_with_the_others_in_grey():
    runs = [
        {"stepper": name, "dt": dt, "errors": {("total", "h"): dt * 1e-6 * (n + 1)}}
        for n, name in enumerate(MANY)
        for dt in (100.0, 200.0)
    ]
    panels = make_sweep(*runs).sweep.plot_cost(width=174.0).figure.axes
    assert [panel.get_legend().get_title().get_text() for panel in panels] == [
        "explicit", "imex", "implicit", "other",
    ]  # fmt: skip
    assert sorted(name for panel in panels for name in labels(panel)) == sorted(MANY)
    for panel in panels:
        grey = [line for line in panel.lines if to_hex(line.get_color()) == PALE]
        assert len(grey) + len(labels(panel)) == len(MANY)


def test_what_is_not_there_is_one_clear_line(dataset):
    with pytest.raises(ConfigError, match="unknown kind of error 'slo'; did you mean 'slow'"):
        dataset.sweep.plot_step_size(kind="slo")
    with pytest.raises(ConfigError, match="No run of williamson5 has an error"):
        make_sweep({}).sweep.plot_cost()
    with pytest.raises(ConfigError, match="not one of a sweep"):
        dataset.drop_vars("stepper").sweep.plot_limits()
    assert swe_sphere.studies.sweep.SweepFigures


def test_a_single_run_has_a_figure(dataset):
    axes = dataset.isel(run=0).sweep.plot_cost()
    assert axes.get_ylabel() == dataset.isel(run=[0]).sweep.plot_cost().get_ylabel()


@pytest.mark.filterwarnings("error")
def test_a_family_without_values_has_an_empty_legend():
    """Matplotlib warns of a legend for which it finds no curves itself."""
    runs = [
        {"stepper": name, "dt": dt, "errors": {("total", "h"): dt * 1e-6 if n > 3 else np.nan}}
        for n, name in enumerate(MANY)
        for dt in (100.0, 200.0, 300.0)
    ]
    runs += [run | {"stepper": f"{run['stepper']}-like"} for run in runs[-9:]]
    panels = make_sweep(*runs).sweep.plot_cost(width=174.0).figure.axes
    legends = {panel.get_legend().get_title().get_text(): labels(panel) for panel in panels}
    assert legends["explicit"] == [] and len(legends["implicit"]) == 3
