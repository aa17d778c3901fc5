"""Maps of sweeps: the cheapest step of each family, break-even, and the page of a small map."""

import math
import re

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from sweeps import make_sweep

from swe_sphere.cli.main import main
from swe_sphere.errors import ConfigError
from swe_sphere.studies import words
from swe_sphere.studies.regimes import best_steps, break_even, write_map
from swe_sphere.studies.sweep.record import runs_of
from swe_sphere.studies.sweep.sweep_plan import Recipe, load_recipe

RECIPE = """title = "a small map"
map = "froude"
steppers = ["rk4", "forward-backward", "bdf2"]
ne = 2
np = 4
days = 1
repeats = 1
slow = true
target-kind = "slow"
target-error = [1e-2, 3e-3]
[[sweep]]
scene = "williamson5"
[sweep.each]
"scene.speed" = [20, 5]
"hyperviscosity.nu" = ["", "default"]
"""


def place(speed: float, *runs: tuple[str, float, float, float], **others) -> xr.Dataset:
    """A search for 1e-3 with a wind: stepper, step, cost and error of the runs."""
    rows = [
        {"stepper": stepper, "dt": dt, "cpu_seconds": cost, "role": "target",
         "errors": {("slow", "vorticity"): error}, "settings": f"scene.speed={speed:g}",
         "gravity_limit": 300.0, "advective_limit": 300.0 * (1.0 + 240.0 / speed)} | others
        for stepper, dt, cost, error in runs
    ]  # fmt: skip
    return make_sweep(*rows, plan='{"target_error": [1e-3], "target_kind": "slow"}')


def mapped(*places: xr.Dataset, axis: str = "froude") -> pd.DataFrame:
    return best_steps({str(n): dataset for n, dataset in enumerate(places)}, axis)


def test_froude_number_is_wind_over_wave_speed() -> None:
    here = mapped(place(20.0, ("rk4", 1.0, 1.0, 1e-4)))
    assert here["x"].item() == here["froude"].item() == pytest.approx(20.0 / 240.0)


def test_families_are_those_of_the_classes_and_the_cheapest_stands_for_each() -> None:
    here = mapped(place(
        20.0, ("rk4", 1.0, 50.0, 1e-5), ("kg5", 1.0, 40.0, 1e-5),
        ("bdf2", 9.0, 20.0, 1e-3), ("tr-bdf2", 9.0, 30.0, 1e-4), ("ark2", 9.0, 1.0, 2e-3),
    )).set_index("family")  # fmt: skip
    assert here.loc["explicit", ["stepper", "dt", "cost"]].tolist() == ["kg5", 1.0, 40.0]
    assert here.loc["implicit", ["stepper", "dt", "cost"]].tolist() == ["bdf2", 9.0, 20.0]
    assert here.loc["implicit", ["ratio", "beside"]].tolist() == [0.5, 0.4]
    assert "imex" not in here.index


def test_break_even_is_where_the_ratio_passes_one() -> None:
    def part(*costs: tuple[float, float, float]) -> tuple[float, float]:
        """Of places by wind, cost and error of the implicit step."""
        found = mapped(*(
            place(speed, ("rk4", 1.0, 10.0, 1e-5), ("bdf2", 9.0, cost, error))
            for speed, cost, error in costs
        ))  # fmt: skip
        ratios = found.pivot(index="x", columns="family", values="ratio")
        ratios = ratios.reindex(columns=["implicit"])
        return break_even(ratios.index.to_numpy(), ratios["implicit"].to_numpy())

    assert part((20.0, 40.0, 1e-5), (5.0, 2.5, 1e-5)) == (0.0, pytest.approx(10.0 / 240.0))
    assert part((20.0, 2.5, 1e-5), (5.0, 40.0, 1e-5)) == (pytest.approx(10.0 / 240.0), math.inf)
    assert np.isnan(part((5.0, 11.0, 1e-5))).all()
    assert part((5.0, 9.0, 1e-5)) == (0.0, math.inf)
    assert part((20.0, 1.0, 0.1), (5.0, 2.5, 1e-5)) == (0.0, pytest.approx(5.0 / 240.0))


def test_break_even_next_to_a_state_at_rest_and_with_gaps(tmp_path) -> None:
    x, ratios = np.array([0.0, 1.0, 2.0]), np.array([0.5, 2.0, 2.0])
    assert break_even(x, ratios) == (0.0, pytest.approx(0.5))
    datasets = {
        str(speed): place(speed, ("rk4", 1.0, 10.0, 1e-5), ("bdf2", 9.0, cost, 1e-5)).assign_attrs(
            created="2026-01-01", machine="here", cores=1
        )
        for speed, cost in ((5.0, 1.0), (10.0, 40.0), (20.0, 1.0))
    }
    page = write_map(datasets, tmp_path, recipe=Recipe("gaps", (), axis="scene.speed"))
    assert page.read_text().count("everywhere, with gaps") == 2
    with pytest.raises(ConfigError, match=r"has no axis \(speed"):
        best_steps(datasets, "(speed")


def test_the_axis_is_a_setting_or_one_of_the_mesh() -> None:
    places = [place(20.0, ("rk4", 1.0, 1.0, 1e-4), ne=ne) for ne in (16, 8)]
    assert mapped(*places, axis="ne")["x"].tolist() == [8.0, 16.0]
    winds = [place(speed, ("rk4", 1.0, 1.0, 1e-4)) for speed in (20.0, 5.0)]
    assert mapped(*winds, axis="scene.speed")["x"].tolist() == [5.0, 20.0]
    with pytest.raises(ConfigError, match=r"map: a sweep of williamson5 has no number scene\.sped"):
        mapped(*winds, axis="scene.sped")
    with pytest.raises(ConfigError, match="map: no timed run of these sweeps reaches"):
        mapped(place(20.0, ("rk4", 1.0, 1.0, 1.0)))


def test_series_differ_in_refinement_and_settings() -> None:
    run = ("rk4", 1.0, 1.0, 1e-4)
    places = [place(20.0, run), place(5.0, run), place(5.0, run, stretch=4.0),
              place(5.0, run, settings="hyperviscosity.nu=default scene.speed=5")]  # fmt: skip
    assert sorted({*mapped(*places)["series"]}) == [
        "williamson5, ne 16, np 4",
        "williamson5, ne 16, np 4, hyperviscosity.nu=default",
        "williamson5, ne 16, np 4, stretch 4",
    ]


# --- a small map


@pytest.fixture(scope="module")
def small_map(tmp_path_factory):
    folder = tmp_path_factory.mktemp("map")
    (folder / "small.toml").write_text(RECIPE)
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
    assert names == {
        "williamson5-speed20", "williamson5-speed5", "williamson5-speed20-nudefault",
        "williamson5-speed5-nudefault",
    }  # fmt: skip


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
    page = (small_map / "out" / "README.md").read_text()
    runs = sorted((small_map / "out").glob("*/runs/*"))
    sweep(small_map)
    assert sorted((small_map / "out").glob("*/runs/*")) == runs
    assert page.startswith("# a small map\n")
    pictures = re.findall(r"!\[[^]]*\]\(([^)]*)\)", page)
    assert set(pictures) == {path.name for path in (small_map / "out").glob("*.svg")}
    assert len(pictures) == 2
    datasets = {path.parent.name: xr.load_dataset(path) for path in small_map.rglob("sweep.nc")}
    best = best_steps(datasets, "froude")
    assert best["froude"].max() == pytest.approx(4.0 * best["froude"].min(), rel=0.05)
    assert best["froude"].max() == pytest.approx(20.0 / 241.8, rel=0.02)
    for run in best[best["family"] == "explicit"].itertuples():
        assert f"`{run.stepper}` {words.step(run.dt)}, {words.seconds(run.cost)}" in page
    for table in re.findall(r"(?:^\|.*\n)+", page, re.MULTILINE):
        assert len({line.count("|") for line in table.splitlines()}) == 1


def test_a_map_of_no_sweeps_is_refused(tmp_path) -> None:
    with pytest.raises(ConfigError, match="no timed run"):
        write_map({}, tmp_path, recipe=Recipe("none", (), axis="ne"))
    (tmp_path / "old.toml").write_text("map = true\n")
    with pytest.raises(ConfigError, match="map names an axis"):
        load_recipe(str(tmp_path / "old.toml"))


@pytest.mark.parametrize(
    ("axis", "flags", "said"),
    [
        ("scene.sped", {}, "map: a sweep of williamson5 has no axis scene.sped"),
        ("nE", {}, "map: a sweep of williamson5 has no axis nE"),
        ("hyperviscosity.nu", {}, "has no axis hyperviscosity.nu"),
        ("scene.speed", {"settings": "viscosity.nu=1e5"}, "has no axis scene.speed"),
        ("ne", {"target_error": []}, "map: a sweep of williamson5 has no target-error"),
    ],
)
def test_a_map_that_cannot_be_drawn_is_refused_before_its_runs(axis, flags, said, tmp_path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(RECIPE.replace("froude", axis))
    with pytest.raises(ConfigError, match=re.escape(said)):
        load_recipe(str(path)).plans(flags)
    path.write_text(RECIPE.replace("froude", "scene.speed"))
    assert len(load_recipe(str(path)).plans({})) == 4


def test_lists_of_a_recipe_are_lists(tmp_path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text('scene = "lauter"\nsteppers = ["imex"]\n[[sweep]]\n[sweep.each]\nne = 4\n')
    with pytest.raises(ConfigError, match=r"\[sweep\.each\] has a list of values for each key"):
        load_recipe(str(path))


def test_places_of_a_scene_file_are_folders_of_their_own(tmp_path) -> None:
    path = tmp_path / "recipe.toml"
    path.write_text(
        'map = "ne"\nscene = "there/mine.toml"\nsteppers = ["rk4"]\n[each]\nspeed = [5, 20]\n'
    )
    assert [values["name"] for values in load_recipe(str(path)).sweeps] == [
        "mine-speed5",
        "mine-speed20",
    ]
