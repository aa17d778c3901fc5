"""The map along resolution: the cheapest step of each family, fitted rules, a small map."""

import math
import re

import pandas as pd
import pytest
import resolution
import xarray as xr
from resolution import COLUMNS, best_steps, by_machine, fitted, merged, page, read_table
from sweeps import make_sweep

from swe_sphere.cli.main import main
from swe_sphere.errors import ConfigError
from swe_sphere.studies import words
from swe_sphere.studies.sweep.record import runs_of
from swe_sphere.studies.sweep.sweep_plan import Recipe, folder_of, load_recipe

RECIPE = """title = "a small map"
steppers = ["rk4", "forward-backward", "bdf2"]
np = 4
days = 1
repeats = 1
slow = true
target-kind = "slow"
target-error = [1e-2, 3e-3]
[[sweep]]
scene = "williamson5"
[sweep.each]
ne = [2, 3]
"scene.speed" = [20, 5]
"""


def place(speed: float, *runs: tuple[str, float, float, float], **others) -> xr.Dataset:
    """A search for 1e-3 with a wind: stepper, step, cost and error of the runs."""
    rows = [
        {"stepper": stepper, "dt": dt, "cpu_seconds": cost, "role": "target",
         "errors": {("slow", "vorticity"): error}, "settings": f"scene.speed={speed:g}",
         "gravity_limit": 300.0, "advective_limit": 300.0 * (1.0 + 240.0 / speed)} | others
        for stepper, dt, cost, error in runs
    ]  # fmt: skip
    return make_sweep(
        *rows, plan='{"target_error": [1e-3], "target_kind": "slow"}',
        created="2026-01-01T10:00:00", machine="here", cores=1,
    )  # fmt: skip


def mapped(*places: xr.Dataset) -> pd.DataFrame:
    return by_machine(best_steps(places))[0]


def test_the_cheapest_step_of_each_family_is_compared_with_explicit_steps() -> None:
    here = mapped(place(
        20.0, ("rk4", 1.0, 50.0, 1e-5), ("kg5", 1.0, 40.0, 1e-5),
        ("bdf2", 9.0, 20.0, 1e-3), ("tr-bdf2", 9.0, 30.0, 1e-4), ("ark2", 9.0, 1.0, 2e-3),
    )).set_index("family")  # fmt: skip
    assert here.loc["explicit", ["stepper", "dt", "cost"]].tolist() == ["kg5", 1.0, 40.0]
    assert here.loc["implicit", ["stepper", "dt", "cost"]].tolist() == ["bdf2", 9.0, 20.0]
    assert here.loc["implicit", ["explicit", "rk4"]].tolist() == [0.5, 0.4]
    assert here["froude"].tolist() == pytest.approx([20.0 / 240.0] * 3)
    assert "imex" not in here.index and here["order"].eq(1).all()


def law(ne: float, speed: float) -> float:
    """Cost of the implicit step over the explicit one, in the datasets of `power_law`."""
    return 12.0 / ne * (speed / 20.0) ** 0.5


def power_law(*meshes: int, **attributes) -> list[xr.Dataset]:
    """Sweeps in two winds whose costs follow the law; "rk4" costs twice as much as "kg5"."""
    return [
        place(
            speed, ("kg5", 1.0, 10.0, 1e-5), ("rk4", 1.0, 20.0, 1e-5),
            ("bdf2", 9.0, 10.0 * law(ne, speed), 1e-5), ne=ne,
        ).assign_attrs(attributes) for ne in meshes for speed in (20.0, 5.0)
    ]  # fmt: skip


def test_the_rule_is_the_power_law_of_the_ratios() -> None:
    best = mapped(*power_law(8, 16))
    implicit = best[best["family"] == "implicit"]
    for base, over in (("explicit", 1.0), ("rk4", 0.5)):
        found = fitted(implicit, base)
        assert found[1:] == pytest.approx((-1.0, 0.5, 1.0, 4))
        for speed in (20.0, 5.0):
            ratio = found.ratio(240.0, speed / 240.0)
            assert ratio == pytest.approx(over * law(240.0, speed))
            assert found.even(speed / 240.0) == pytest.approx(240.0 * ratio)
    assert fitted(best[best["family"] == "explicit"], "explicit").even(0.1) == math.inf
    assert fitted(implicit[implicit["ne"] == 8], "explicit") is None
    slow = fitted(implicit[implicit["series"] == "williamson5, np4, scene.speed=5"], "explicit")
    assert slow.even(5.0 / 240.0) == pytest.approx(6.0)


@pytest.mark.parametrize(
    ("ratios", "expected"),
    [
        ([4.0, 1.0, 0.5], 16.0), ([2.0, 0.5, 0.25], 8.0 * math.sqrt(2.0)), ([0.9, 0.5, 0.2], 8.0),
        ([3.0, 2.0, 1.0], math.inf), ([0.5, 2.0, 0.5], 16.0 * math.sqrt(2.0)),
        ([4.0, math.nan, 0.25], 16.0), ([math.nan] * 3, math.inf),
    ],
)  # fmt: skip
def test_break_even_is_interpolated_between_the_last_meshes_around_one(ratios, expected) -> None:
    steps = pd.DataFrame({"ne": [8, 16, 32], "explicit": ratios})
    assert resolution.break_even(steps, "explicit") == pytest.approx(expected)


def test_rules_are_fitted_to_three_meshes_and_checked_on_the_finest() -> None:
    coarse = place(20.0, ("rk4", 1.0, 1.0, 1e-5), ("bdf2", 9.0, 99.0, 1e-5), ne=4)
    sweeps = [*power_law(8, 16, 32, 64), coarse.assign_attrs(created="2026-01-02")]
    there, third = power_law(8, machine="a far one", cores=7), power_law(16, machine="a third one")
    table = best_steps([*there, *sweeps, *third])
    text = page(table, Recipe("a map", ({},) * 10), "* Found.\n")
    row = re.search(r"^\| williamson5, np4, 20 m/s \| 64, explicit \|(.*)", text, re.M)
    assert [each.strip() for each in row[1].split("|")] == ["–", "–", "0.19 (0.19)", ""]
    assert "| – | not measured | – | 0.094 to 0.19 | 8.0 to 12 |" in text
    assert "ne 12, 0.050, 0.012 |" in text and "ne 6.0, 0.025, 0.0059 |" in text
    assert "9 of the 10 sweeps of the recipe" in text and "\n* Found.\n" in text
    assert "measured on 2026-01-01, 2026-01-02 (here, 1 cores)." in text
    assert "0 of the 27 steps that these ratios compare were timed once" in text
    beside, third = text.partition("on a far one, 7 cores")[2].split("on a third one, 1 cores")
    assert re.search(r"^\| williamson5, np4, 5 m/s \| 16 \|.* 0.38 \(0.38\) \|$", third, re.M)
    row = re.search(r"^\| williamson5, np4, 20 m/s \| 8 \|.*\| (\S+) \((\S+)\) \|$", beside, re.M)
    assert row[1] == row[2] == "1.5"
    assert {*resolution.figures(table)} == {*re.findall(r"!\[[^]]*\]\(([^)]*)\)", text)}
    rows = [line for line in text.splitlines() if line.startswith("|")]
    assert len(rows) > 20 and not [line for line in rows if not line.endswith("|")]


def test_panels_of_a_figure_show_all_ratios() -> None:
    best = mapped(*power_law(8, 16, 32))
    here = best[best["family"] == "implicit"]
    for axes in resolution._figure(here).axes:
        low, high = axes.get_ylim()
        assert low <= here["rk4"].min() and here["explicit"].max() <= high


def test_series_differ_in_settings_and_not_in_resolution() -> None:
    run = ("rk4", 1.0, 1.0, 1e-4)
    places = [place(20.0, run), place(20.0, run, ne=8), place(5.0, run, stretch=4.0),
              place(5.0, run, settings="hyperviscosity.nu=default scene.speed=5")]  # fmt: skip
    best = mapped(*places)
    assert sorted({*best["series"]}) == [
        "williamson5, np4, hyperviscosity.nu=default scene.speed=5",
        "williamson5, np4, scene.speed=20",
        "williamson5, np4, stretched 4, scene.speed=5",
    ]
    assert "williamson5, np4, hyperviscosity.nu=default" in {*best["group"]}


def test_sweeps_without_ratios_are_refused() -> None:
    with pytest.raises(ConfigError, match="map: no timed run of these sweeps reaches"):
        mapped(place(20.0, ("rk4", 1.0, 1.0, 1.0)))
    with pytest.raises(ConfigError, match="map: williamson5 begins without wind"):
        mapped(place(20.0, ("rk4", 1.0, 1.0, 1e-4), advective_limit=math.inf))


def test_merged_steps_replace_those_of_the_same_machine_and_place() -> None:
    table = best_steps([*power_law(8, 16), *power_law(16, machine="a far one")])
    again = place(20.0, ("kg5", 1.0, 30.0, 1e-5), ne=16, spread=math.nan)
    both = merged(table, best_steps([again, *power_law(32)]))
    assert len(table) == 18 and len(both) == 18 - 3 + 1 + 6
    here = both[(both["ne"] == 16) & (both["machine"] == "here")]
    here = here[here["series"] == "williamson5, np4, scene.speed=20"]
    assert here[["stepper", "cost", "repeated"]].values.tolist() == [["kg5", 30.0, False]]
    back = merged(both, table)
    pd.testing.assert_frame_equal(
        back[back["ne"] < 32].reset_index(drop=True), merged(table.head(0), table)
    )


def test_the_command_stores_the_steps_of_the_recipe(tmp_path) -> None:
    sweeps = power_law(2, 3)
    for values, dataset in zip(new_map(tmp_path).sweeps, sweeps, strict=True):
        folder = tmp_path / "out" / folder_of(values)
        folder.mkdir(parents=True)
        dataset.to_netcdf(folder / "sweep.nc")
    table = stored(tmp_path)
    expected = merged(table.head(0), best_steps(sweeps))
    pd.testing.assert_frame_equal(
        table, expected, check_dtype=False, check_column_type=False, rtol=1e-5
    )
    pd.testing.assert_frame_equal(table, stored(tmp_path))


def test_the_figures_of_the_page_are_those_of_the_stored_table() -> None:
    """Their text depends on the version of matplotlib."""
    files = {path.name for path in resolution.PAGE.parent.glob("*.svg")}
    assert files == {*resolution.figures(read_table())}


# --- a small map


def new_map(folder) -> Recipe:
    (folder / "small.toml").write_text(RECIPE)
    (folder / "map.csv").write_text(",".join(COLUMNS) + "\n")
    return load_recipe(str(folder / "small.toml"))


def stored(folder) -> pd.DataFrame:
    """The table map.csv after the command has stored the sweeps in the folder `out`."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(resolution, "RECIPE", folder / "small.toml")
        patch.setattr(resolution, "TABLE", folder / "map.csv")
        resolution.main([folder / "out"])
        return read_table()


@pytest.fixture(scope="module")
def small_map(tmp_path_factory):
    folder = tmp_path_factory.mktemp("map")
    new_map(folder)
    sweep(folder)
    return folder


def sweep(folder, *more: str) -> None:
    with pytest.raises(SystemExit) as end:
        main(["sweep", "--recipe", str(folder / "small.toml"), "--out", str(folder / "out"),
              "--quiet", *more])  # fmt: skip
    assert end.value.code == 0


@pytest.mark.thorough
def test_every_combination_of_a_recipe_has_a_folder(small_map) -> None:
    names = {path.name for path in (small_map / "out").iterdir() if path.is_dir()}
    assert names == {f"williamson5-ne{ne}-speed{speed}" for ne in (2, 3) for speed in (20, 5)}


@pytest.mark.thorough
def test_every_target_is_searched_for_and_timed(small_map) -> None:
    for path in (small_map / "out").glob("*/runs"):
        runs = [run for run in runs_of(path.parent).records if run.role == "target"]
        errors = {
            run.key: error.l2 for run in runs for error in run.errors if error.kind == "slow"
            and error.field == "vorticity" and run.config.stepper == "bdf2"
        }  # fmt: skip
        assert any(error <= 3e-3 for error in errors.values())
        assert any(3e-3 < error <= 1e-2 for error in errors.values())


@pytest.mark.thorough
def test_the_page_tells_the_numbers_of_the_map_and_nothing_is_run_again(small_map) -> None:
    best = stored(small_map)
    text = page(best, load_recipe(str(small_map / "small.toml")))
    runs = sorted((small_map / "out").glob("*/runs/*"))
    sweep(small_map)
    assert sorted((small_map / "out").glob("*/runs/*")) == runs
    pd.testing.assert_frame_equal(stored(small_map), best)
    assert text.startswith("# a small map\n")
    pictures = re.findall(r"!\[[^]]*\]\(([^)]*)\)", text)
    assert {*pictures} == {*resolution.figures(best)}
    assert len(pictures) == 2
    assert best["froude"].max() == pytest.approx(4.0 * best["froude"].min(), rel=0.05)
    assert best["froude"].max() == pytest.approx(20.0 / 241.8, rel=0.02)
    for run in best[best["family"] == "explicit"].itertuples():
        assert f"`{run.stepper}` {words.step(run.dt)}, {words.seconds(run.cost)}" in text
    for table in re.findall(r"(?:^\|.*\n)+", text, re.MULTILINE):
        assert len({line.count("|") for line in table.splitlines()}) == 1


def test_maps_that_cannot_be_drawn_are_refused(tmp_path) -> None:
    with pytest.raises(ConfigError, match="no timed run"):
        best_steps([])
    path = tmp_path / "mine.toml"
    path.write_text(RECIPE)
    assert len(load_recipe(str(path)).plans({})) == 4


def test_lists_of_a_recipe_are_lists(tmp_path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text('scene = "lauter"\nsteppers = ["imex"]\n[[sweep]]\n[sweep.each]\nne = 4\n')
    with pytest.raises(ConfigError, match=r"\[sweep\.each\] has a list of values for each key"):
        load_recipe(str(path))


def test_places_of_a_scene_file_are_folders_of_their_own(tmp_path) -> None:
    path = tmp_path / "recipe.toml"
    path.write_text('scene = "there/mine.toml"\nsteppers = ["rk4"]\n[each]\nspeed = [5, 20]\n')
    assert [values["name"] for values in load_recipe(str(path)).sweeps] == [
        "mine-speed5",
        "mine-speed20",
    ]
