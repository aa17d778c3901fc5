"""The map of regimes: costs at an error, break-even Froude numbers, and the page of a small map."""

import json
import math
import re
import shutil
from itertools import pairwise

import pytest

from swe_sphere.cli.main import main
from swe_sphere.errors import ConfigError
from swe_sphere.simulation.config import make_config
from swe_sphere.studies.regimes import Point, read_points, write_map
from swe_sphere.studies.regimes.points import Run, break_even, cheapest_step, ratio, series
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
finer = 0
target-kind = "slow"
enough = 3e-3
[[sweep]]
scene = "williamson5"
[sweep.each]
"scene.speed" = [20, 5]
"hyperviscosity.nu" = ["", "default"]
"""


def run(stepper: str, dt: float, cost: float, error: float) -> Run:
    return Run(stepper, dt, 1.0, error, cost)


def place(speed: float, *runs: Run, stretch: float = 1.0, **more: object) -> Point:
    config = make_config(
        {"scene": "williamson5", "settings": (f"scene.speed={speed}",), "stretch": stretch,
         "days": 1.0, **more}
    )  # fmt: skip
    return Point("here", config, 300.0, 300.0 * (1.0 + 240.0 / speed), runs)


def test_froude_number_is_wind_over_wave_speed() -> None:
    assert place(20.0).froude == pytest.approx(20.0 / 240.0)


def test_cost_between_two_steps_is_interpolated_and_beyond_them_is_not() -> None:
    runs = [run("bdf2", 2.0, 100.0, 1e-2), run("bdf2", 1.0, 400.0, 1e-4)]
    assert cheapest_step(runs, 1e-3) == pytest.approx(("bdf2", math.sqrt(2.0), 200.0))
    assert cheapest_step(runs, 1e-4) == pytest.approx(("bdf2", 1.0, 400.0))
    assert cheapest_step(runs, 1.0) == ("bdf2", 2.0, 100.0)
    assert cheapest_step(runs, 0.9e-4) is None
    # a solver that struggles with long steps: the shorter one is cheaper, whatever the error
    assert cheapest_step([run("bdf2", 2.0, 900.0, 1e-2), runs[1]], 1.0) == ("bdf2", 1.0, 400.0)


def test_families_are_those_of_the_classes_and_the_cheapest_stands_for_each() -> None:
    here = place(
        20.0, run("rk4", 1.0, 50.0, 1e-5), run("kg5", 1.0, 40.0, 1e-5),
        run("bdf2", 9.0, 20.0, 1e-3), run("tr-bdf2", 9.0, 30.0, 1e-4),
    )  # fmt: skip
    assert here.best("explicit", 1e-3) == ("kg5", 1.0, 40.0)
    assert here.best("implicit", 1e-3) == ("bdf2", 9.0, 20.0)
    assert here.best("implicit", 1e-4) == ("tr-bdf2", 9.0, 30.0)
    assert here.best("imex", 1e-3) is None
    assert ratio(here, "implicit", 1e-3) == 0.5 and math.isnan(ratio(here, "imex", 1e-3))


def test_break_even_is_where_the_ratio_passes_one() -> None:
    def costing(speed: float, cost: float) -> Point:
        return place(speed, run("rk4", 1.0, 10.0, 1e-5), run("bdf2", 9.0, cost, 1e-5))

    (line,) = series([costing(20.0, 40.0), costing(5.0, 2.5)])
    assert [point.froude for point in line.points] == sorted(p.froude for p in line.points)
    assert break_even(line, "implicit", 1e-3) == pytest.approx(10.0 / 240.0)  # both logarithms
    assert break_even(series([costing(5.0, 11.0)])[0], "implicit", 1e-3) == 0.0
    assert break_even(series([costing(5.0, 9.0)])[0], "implicit", 1e-3) == math.inf
    assert math.isnan(break_even(line, "exponential", 1e-3))
    out_of_reach = place(20.0, run("rk4", 1.0, 10.0, 1e-5), run("bdf2", 9.0, 1.0, 0.1))
    (cut,) = series([out_of_reach, costing(5.0, 2.5)])
    assert break_even(cut, "implicit", 1e-3) == pytest.approx(5.0 / 240.0)


def test_series_differ_in_refinement_and_hyperviscosity() -> None:
    diffusive = make_config(
        {"scene": "williamson5", "settings": ("hyperviscosity.nu=default",), "days": 1.0}
    )
    points = [place(20.0), place(5.0), place(5.0, stretch=4.0),
              Point("there", diffusive, 1.0, 2.0, ())]  # fmt: skip
    titles = [(line.title, len(line.points)) for line in series(points)]
    assert titles == [("williamson5", 2), ("williamson5, refined 4 times", 1),
                      ("williamson5, hyperviscosity", 1)]  # fmt: skip


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


def test_costs_of_all_places_are_in_one_unit(small_map) -> None:
    points = {point.name: point for point in read_points(small_map / "out")}
    fast, slow = points["williamson5-speed20"], points["williamson5-speed5"]
    assert fast.froude == pytest.approx(4.0 * slow.froude, rel=0.05)
    assert fast.froude == pytest.approx(20.0 / 241.8, rel=0.02)
    assert points["williamson5-speed5-nudefault"].diffusive and not slow.diffusive
    a_step = [run.cost / run.steps for p in points.values() for run in p.by_stepper["rk4"]]
    assert min(a_step) > 3.999  # four right-hand sides of the quickest run of any place


def test_the_page_tells_the_numbers_of_the_map_and_nothing_is_run_again(small_map) -> None:
    page = (small_map / "out" / "README.md").read_text()
    runs = sorted((small_map / "out").glob("*/runs/*"))
    sweep(small_map)
    assert sorted((small_map / "out").glob("*/runs/*")) == runs
    assert page.startswith("# a small map\n")
    pictures = re.findall(r"!\[[^]]*\]\(([^)]*)\)", page)
    assert set(pictures) == {path.name for path in (small_map / "out").glob("*.svg")} != set()
    point = {p.name: p for p in read_points(small_map / "out")}["williamson5-speed20"]
    best = point.best("explicit", 3e-3)
    assert f"`{best.stepper}` {best.dt:.4g} s, {best.cost:.3g}"[:-1] in page


def test_a_map_needs_the_stepper_in_which_costs_are_told(small_map, tmp_path) -> None:
    folder = shutil.copytree(small_map / "out", tmp_path / "out")
    for file in folder.glob("*/runs/*.json"):
        if json.loads(file.read_text())["config"]["stepper"] == "rk4":
            file.unlink()
    with pytest.raises(ConfigError, match=r"no run of rk4 in float64 .* add rk4 to the steppers"):
        read_points(folder)


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
