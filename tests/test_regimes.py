"""The map of regimes: costs at an error, break-even Froude numbers, and the page of a small map."""

import math
import re
from itertools import pairwise

import pandas as pd
import pytest

from swe_sphere.cli.main import main
from swe_sphere.errors import ConfigError
from swe_sphere.studies import words
from swe_sphere.studies.regimes import (
    RegimeMap,
    break_even,
    cheapest_step,
    ordered_places,
    read_map,
    write_map,
)
from swe_sphere.studies.sweep.record import runs_of
from swe_sphere.studies.sweep.sweep_plan import load_recipe

RECIPE = """title = "a small map"
map = true
steppers = ["rk4", "forward-backward", "bdf2"]
ne = 2
np = 4
days = 1
longest = 21600
levels = 4
repeats = 1
slow = true
target-kind = "slow"
enough = 3e-3
[[sweep]]
scene = "williamson5"
[sweep.each]
"scene.speed" = [20, 5]
"hyperviscosity.nu" = ["", "default"]
"""


def regimes(*places: tuple[float, list[tuple]], stretch: float = 1.0) -> RegimeMap:
    """A map of winds with the runs there: stepper, step, cost, error."""
    firsts = pd.DataFrame([
        {"place": f"wind {speed:g}", "scene": "williamson5", "stretch": stretch,
         "days_planned": 1.0, "settings": f"scene.speed={speed:g}", "gravity_limit": 300.0,
         "advective_limit": 300.0 * (1.0 + 240.0 / speed)} for speed, _ in places
    ])  # fmt: skip
    lines = [(f"wind {speed:g}", *run) for speed, runs in places for run in runs]
    runs = pd.DataFrame(lines, columns=["place", "stepper", "dt", "cost", "error"])
    return RegimeMap(ordered_places(firsts.set_index("place")), runs)


def best(found: RegimeMap, family: str, error: float) -> tuple | None:
    """Stepper, step and cost of the first place."""
    offers = found.best(error)
    lines = offers.loc[offers["family"] == family, ["stepper", "dt", "cost"]]
    return None if lines.empty else tuple(lines.iloc[0])


def test_froude_number_is_wind_over_wave_speed() -> None:
    assert regimes((20.0, [])).places["froude"].item() == pytest.approx(20.0 / 240.0)


def test_cost_between_two_steps_is_interpolated_and_beyond_them_is_not() -> None:
    runs = pd.DataFrame({"dt": [2.0, 1.0], "cost": [100.0, 400.0], "error": [1e-2, 1e-4]})
    assert cheapest_step(runs, 1e-3) == pytest.approx((math.sqrt(2.0), 200.0))
    assert cheapest_step(runs, 1e-4) == pytest.approx((1.0, 400.0))
    assert cheapest_step(runs, 1.0) == (2.0, 100.0)
    assert cheapest_step(runs, 0.9e-4) is None
    # a solver that struggles with long steps: the shorter one is cheaper, whatever the error
    assert cheapest_step(runs.assign(cost=[900.0, 400.0]), 1.0) == (1.0, 400.0)


def test_families_are_those_of_the_classes_and_the_cheapest_stands_for_each() -> None:
    here = regimes((20.0, [
        ("rk4", 1.0, 50.0, 1e-5), ("kg5", 1.0, 40.0, 1e-5),
        ("bdf2", 9.0, 20.0, 1e-3), ("tr-bdf2", 9.0, 30.0, 1e-4),
    ]))  # fmt: skip
    assert best(here, "explicit", 1e-3) == ("kg5", 1.0, 40.0)
    assert best(here, "implicit", 1e-3) == ("bdf2", 9.0, 20.0)
    assert best(here, "implicit", 1e-4) == ("tr-bdf2", 9.0, 30.0)
    assert best(here, "imex", 1e-3) is None
    offers = here.best(1e-3).set_index("family")
    assert offers.loc["implicit", ["ratio", "beside"]].tolist() == [0.5, 0.4]


def test_break_even_is_where_the_ratio_passes_one() -> None:
    def limit(*costs: tuple[float, float, float]) -> float:
        """Of places by wind, cost and error of the implicit step."""
        found = regimes(*(
            (speed, [("rk4", 1.0, 10.0, 1e-5), ("bdf2", 9.0, cost, error)])
            for speed, cost, error in costs
        ))  # fmt: skip
        offers = found.best(1e-3)
        ratios = offers[offers["family"] == "implicit"].set_index("place")["ratio"]
        froude = found.places["froude"]
        assert froude.is_monotonic_increasing
        return break_even([*froude], [*ratios.reindex(froude.index)])

    assert limit((20.0, 40.0, 1e-5), (5.0, 2.5, 1e-5)) == pytest.approx(10.0 / 240.0)
    assert limit((5.0, 11.0, 1e-5)) == 0.0
    assert limit((5.0, 9.0, 1e-5)) == math.inf
    assert math.isnan(limit((5.0, 9.0, 0.1)))
    assert limit((20.0, 1.0, 0.1), (5.0, 2.5, 1e-5)) == pytest.approx(5.0 / 240.0)


def test_series_differ_in_refinement_and_hyperviscosity() -> None:
    lines = [("scene.speed=20", 1.0), ("scene.speed=5", 1.0), ("scene.speed=5", 4.0),
             ("hyperviscosity.nu=default", 1.0)]  # fmt: skip
    firsts = pd.DataFrame(lines, columns=["settings", "stretch"]).assign(
        scene="williamson5", gravity_limit=1.0, advective_limit=2.0, days_planned=1.0
    )
    assert ordered_places(firsts)["title"].tolist() == [
        "williamson5", "williamson5", "williamson5, refined 4 times", "williamson5, hyperviscosity"
    ]  # fmt: skip


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


def test_steps_are_halved_until_the_error_is_small_enough(small_map) -> None:
    for path in (small_map / "out").glob("*/runs"):
        runs = [run for run in runs_of(path.parent).records if run.role == "grid"]
        for name in ("rk4", "forward-backward", "bdf2"):
            of = [run for run in runs if run.config.stepper == name]
            errors = [
                e.l2 for run in of for e in run.errors if (e.kind, e.field) == ("slow", "vorticity")
            ]
            assert len(errors) == len(of) <= 4
            assert all(error > 3e-3 for error in errors[:-1])
            for longer, shorter in pairwise(of):
                assert shorter.config.dt == pytest.approx(0.5 * longer.config.dt, rel=0.2)


def test_places_are_told_apart_by_wind_and_diffusion(small_map) -> None:
    found = read_map(small_map / "out")
    froude, diffusive = found.places["froude"], found.places["diffusive"]
    fast, slow = froude["williamson5-speed20"], froude["williamson5-speed5"]
    assert fast == pytest.approx(4.0 * slow, rel=0.05)
    assert fast == pytest.approx(20.0 / 241.8, rel=0.02)
    assert diffusive["williamson5-speed5-nudefault"] and not diffusive["williamson5-speed5"]


def test_the_page_tells_the_numbers_of_the_map_and_nothing_is_run_again(small_map) -> None:
    page = (small_map / "out" / "README.md").read_text()
    runs = sorted((small_map / "out").glob("*/runs/*"))
    sweep(small_map)
    assert sorted((small_map / "out").glob("*/runs/*")) == runs
    assert page.startswith("# a small map\n")
    pictures = re.findall(r"!\[[^]]*\]\(([^)]*)\)", page)
    assert set(pictures) == {path.name for path in (small_map / "out").glob("*.svg")} != set()
    offers = read_map(small_map / "out").best(3e-3).set_index(["place", "family"])
    stepper, dt, cost = offers.loc[("williamson5-speed20", "explicit"), ["stepper", "dt", "cost"]]
    assert f"`{stepper}` {dt:.4g} s, {words.seconds(cost)}" in page


def test_a_folder_without_sweeps_has_no_map(tmp_path) -> None:
    with pytest.raises(ConfigError, match="there is no sweep in"):
        write_map(tmp_path, title="none")


def test_lists_of_a_recipe_are_lists(tmp_path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text('scene = "lauter"\nsteppers = ["imex"]\n[[sweep]]\n[sweep.each]\nne = 4\n')
    with pytest.raises(ConfigError, match=r"\[sweep\.each\] has a list of values for each key"):
        load_recipe(str(path))


def test_places_of_a_scene_file_are_folders_of_their_own(tmp_path) -> None:
    path = tmp_path / "recipe.toml"
    path.write_text(
        'map = true\nscene = "there/mine.toml"\nsteppers = ["rk4"]\n[each]\nspeed = [5, 20]\n'
    )
    assert [values["name"] for values in load_recipe(str(path)).sweeps] == [
        "mine-speed5",
        "mine-speed20",
    ]
