"""`swe-sphere sweep`: tables, mistakes, exit status, interruption."""

import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import xarray as xr

from swe_sphere.cli.main import main
from swe_sphere.compiling import COMPILING
from swe_sphere.studies.pages import MARK
from swe_sphere.studies.sweep.record import runs_of

PROGRAM = Path(sys.executable).parent / "swe-sphere"
TINY = ("--ne", 2, "--np", 4, "--days", 0.5, "--repeats", 1, "--out", "d")


@pytest.fixture
def swe(capfd, tmp_path, monkeypatch):
    """Runs the program in this process, in a folder of its own: status, stdout, stderr.

    Reports are tested elsewhere: here the page is empty.
    """
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("swe_sphere.studies.report.write_report", _empty_page)

    def call(*arguments):
        with pytest.raises(SystemExit) as end:
            main(["sweep", *map(str, arguments)])
        out, err = capfd.readouterr()
        return end.value.code, out, err

    return call


def _empty_page(datasets, folder, recipe):
    """Write pages of words alone."""
    page = Path(folder) / "index.html"
    page.write_text(MARK)
    if recipe is not None:
        text = f"{recipe.title}|{recipe.introduction}|{[*datasets]}|{recipe.notes}"
        (Path(folder) / "README.md").write_text(f"{MARK}{text}")
    return page


RECIPE = """title = "two flows"
introduction = "Both are exact."
steppers = ["rk4"]
dt = [3600]
ne = 2
np = 4
days = 0.5
repeats = 1
[[sweep]]
scene = "williamson2"
note = "steady"
[[sweep]]
scene = "lauter"
"""


def test_scenes_of_a_recipe_share_a_page_too(swe, tmp_path):
    Path("mine.toml").write_text(RECIPE)
    said = MARK + "two flows|Both are exact.|['williamson2', 'lauter']|{'williamson2': 'steady'}"
    for again in ((), ("--report-only",)):
        status, out, err = swe("--recipe", "mine.toml", "--out", "d", *again)
        assert (status, err) == (0, "")
        assert out.endswith("d/index.html\n")
        assert (tmp_path / "d" / "README.md").read_text() == said
        (tmp_path / "d" / "README.md").unlink()


def test_a_grid_ends_with_its_table_and_page(swe, tmp_path):
    status, out, err = swe("lauter", "--steppers", "rk4,bdf2", "--dt", "3600,1800", *TINY)
    assert (status, err) == (0, "")
    for name, dt in (("rk4", 3600), ("bdf2", 1800)):  # a step, a time and an error below each other
        assert len(re.findall(rf"^ {name} .* {dt} s.*\n .* s.*\n .* \d\.\de-\d", out, re.M)) == 1
    assert re.search(r" smallest *\n stepper +≤ .* error *\n", out)
    table = re.search(r"^ stepper +≤ .*?(?=^For each)", out, re.MULTILINE | re.DOTALL)[0]
    assert max(map(len, table.splitlines())) <= 80
    assert re.search(r"^Cheapest to l2\(h\) ≤ .* of CPU time", out, re.MULTILINE)
    assert out.endswith("d/index.html\n")
    assert {path.name for path in (tmp_path / "d").iterdir()} == {
        "converged", "index.html", "runs", "sweep.json", "sweep.nc"
    }  # fmt: skip


@pytest.mark.thorough
def test_meshes_and_solvers_are_told_apart(swe):
    options = ("--preconditioner", "none,helmholtz", "--precision", "float64,float32")
    status, out, _ = swe("lauter", "--steppers", "bdf2", "--dt", "7200", *TINY, *options)
    assert status == 0
    assert "on lauter, ne2 np4" in out
    for solver in ("no preconditioner", "helmholtz"):
        for precision in ("float64", "float32"):
            assert re.search(rf"\n bdf2 .*\n {solver} .*\n {precision} ", out), (solver, precision)


@pytest.mark.thorough
def test_a_search_prints_the_cheapest_of_each_stepper(swe):
    search = ("--target-error", 1e-3, "--target-field", "v", "--target-kind", "time")
    status, out, err = swe("lauter", "--steppers", "rk4,bdf2", *TINY, *search)
    assert (status, err) == (0, "")
    assert out.startswith("Cheapest to l2(v) ≤ 1e-3 (time error, day 0.5) on lauter, ne2 np4: ")
    assert all(len(re.findall(f"^ {name} ", out, re.MULTILINE)) == 1 for name in ("rk4", "bdf2"))
    status, out, err = swe("lauter", "--steppers", "rk4", *TINY, "--target-error", 1e-9)
    assert status == 0 and "No run on lauter, ne2 np4 reaches an error of 1e-9" in out
    assert err.startswith("rk4, ne2 np4 float64: the error stays at")


def test_limits_are_noted(swe):
    status, _, err = swe("lauter", "--steppers", "rk4", "--dt", 3600, *TINY, "--find-limit")
    assert status == 0
    assert re.fullmatch(
        r"rk4, ne2 np4 float64: longest stable step .* s, 2\.\d+ gravity limits"
        r" \(100 steps and 5 days at least; estimated stability limit .* s\)\n",
        err,
    )


def test_failed_runs_are_told_below_the_table(swe):
    unstable = ("--steppers", "rk4", "--dt", "21600", "--days", "10")
    status, out, err = swe("williamson2", *TINY, *unstable)
    assert (status, err) == (1, "")
    assert out.startswith("williamson2: no run has an error that could be compared\nrk4, unstable:")
    assert "is NaN in u, v, h at day" in out or "the depth is not positive" in out


def test_failed_runs_are_told_without_a_table_too(swe):
    unstable = ("--steppers", "rk4", "--dt", "21600", "--days", "10", "--quiet")
    status, out, err = swe("williamson2", *TINY, *unstable)
    assert (status, out) == (1, "")
    assert err == "swe-sphere: no run of the sweep was completed: see d/index.html\n"


def test_options_without_effect_are_refused(swe):
    for name, value in (("tolerance", "1e-3"), ("preconditioner", "helmholtz")):
        given = (f"--{name}", value, *TINY)
        status, _, err = swe("williamson2", "--steppers", "rk4", *given)
        assert status == 2 and f"{name}: none of the steppers has this option" in err
    status, _, err = swe("--report-only", "--days", 3, "--out", "d")
    assert status == 2 and "report-only: days has no effect" in err


def test_a_table_that_is_not_printed_is_not_explained(swe):
    status, out, err = swe("lake-at-rest", "--steppers", "rk4", "--dt", 3600, *TINY)
    assert (status, err) == (0, "")
    assert out == "All errors on lake-at-rest, ne2 np4 are zero.\nd/index.html\n"


def test_a_report_can_be_made_again(swe, tmp_path):
    grid = ("lauter", "--steppers", "rk4", "--dt", 3600, *TINY)
    _, first, _ = swe(*grid)
    (tmp_path / "d" / "sweep.nc").unlink()
    (tmp_path / "d" / "index.html").unlink()
    runs = {path: path.read_bytes() for path in (tmp_path / "d" / "runs").iterdir()}
    assert swe("--out", "d", "--report-only") == (0, first, "")
    assert swe("--out", ".", "--report-only", "--quiet") == (0, "", "")
    assert (tmp_path / "d" / "sweep.nc").exists() and (tmp_path / "d" / "index.html").exists()
    assert runs == {path: path.read_bytes() for path in (tmp_path / "d" / "runs").iterdir()}


@pytest.mark.parametrize("page", ["d/index.html", "d/README.md"])
def test_a_page_that_no_sweep_has_made_is_not_replaced(swe, tmp_path, page):
    """Wherever sweeps lie; README.md only a recipe would write."""
    (tmp_path / "one.toml").write_text('scene = "lauter"\nsteppers = "rk4"\ndt = 3600\n')
    assert swe("lauter", "--steppers", "rk4", "--dt", 3600, *TINY[:-1], "d/below")[0] == 0
    (tmp_path / page).write_text("mine")
    recipe = ("--recipe", "one.toml")
    status, _, err = swe(*recipe, *TINY)
    assert status == 2 and f"{page} is not of a sweep" in err
    assert (tmp_path / page).read_text() == "mine" and not (tmp_path / "d" / "runs").exists()
    if page == "d/README.md":
        assert swe("lauter", "--steppers", "rk4", "--dt", 3600, *TINY)[0] == 0
        assert swe("--report-only", *recipe, "--out", "d")[0] == 2
    assert swe("--report-only", "--out", "d")[0] == (0 if page == "d/README.md" else 2)
    assert (tmp_path / page).read_text() == "mine"


def test_a_recipe_of_one_sweep_keeps_its_title_and_note(swe, tmp_path):
    (tmp_path / "one.toml").write_text(RECIPE[: RECIPE.rindex("[[sweep]]")])
    for again in (("--out", "d"), ("--out", "d", "--report-only")):
        assert swe("--recipe", "one.toml", *again)[0] == 0
        page = (tmp_path / "d" / "README.md").read_text()
        assert page.endswith("two flows|Both are exact.|['williamson2']|{'williamson2': 'steady'}")
        (tmp_path / "d" / "README.md").unlink()


def test_a_recipe_of_several_scenes_has_a_folder_for_each(swe, tmp_path):
    (tmp_path / "two.toml").write_text(
        'steppers = ["rk4"]\ndays = 9\nrepeats = 1\ndt = [3600]\n'
        '[[sweep]]\nscene = "williamson2"\n[[sweep]]\nscene = "lauter"\n'
    )
    recipe = ("--recipe", "two.toml", "--ne", 2, "--np", 4, "--days", 0.5, "--out", "d")
    status, out, _ = swe(*recipe)
    assert (
        status == 0 and "on williamson2, ne2 np4: rk4" in out and "on lauter, ne2 np4: rk4" in out
    )
    for scene in ("williamson2", "lauter"):
        runs = runs_of(tmp_path / "d" / scene).records
        assert {run.numbers["days"] for run in runs} == {0.5}
    assert swe("lauter", *recipe, "--quiet")[0] == 0


@pytest.mark.thorough
def test_the_quick_recipe_runs_when_it_is_cut_short(swe):
    status, out, _ = swe("--recipe", "quick", "--ne", 2, "--np", 4, "--days", 0.25,
                         "--levels", 1, "--repeats", 1, "--out", "d")  # fmt: skip
    assert status == 0
    for name in ("leapfrog", "rk4", "semi-implicit", "bdf2", "tr-bdf2", "esdirk4"):
        assert re.search(f"^ {name} ", out, re.MULTILINE), name


MISTAKES = {
    "lauter --steppers rk4": "out: give the folder",
    "--steppers rk4 --out d": "scene: name one",
    "lauter --out d": "steppers: name one",
    "lauter --steppers rk5 --out d": "unknown stepper 'rk5'; did you mean 'rk4'",
    "lauer --steppers rk4 --out d": "unknown scene 'lauer'; did you mean 'lauter'",
    "lauter --steppers rk4 --dt soon --out d": "dt: must be positive numbers of seconds",
    "lauter --steppers rk4 --ne two --out d": "ne: must be a valid integer",
    "lauter --steppers rk4 --days 1 --report-days 2 --out d": "day 2 is after the end",
    "lauter --steppers bdf2 --preconditioner mg --out d": "unknown preconditioner 'mg'",
    "lauter --steppers rk4 --alpha nan --out d": "alpha: must be a finite number",
    "lauter --steppers rk4 --reference damaged.nc --out d": "cannot read damaged.nc",
    "lauter --steppers rk4 --device abacus --ne 2 --out d": "device 'abacus'",
    "--recipe quik --out d": "unknown recipe 'quik'; did you mean 'quick'",
    "--recipe none.toml --out d": "cannot read none.toml",
    "--report-only --out d": "there is no sweep in d",
    "lauter --steppers rk4 --out damaged.nc": "damaged.nc cannot be created",
    "lauter --steppers rk4 --target-error 0 --out d": "target-error: must be greater than 0",
}


@pytest.mark.parametrize("line", MISTAKES)
def test_a_mistake_gets_one_line_and_status_2(swe, tmp_path, line):
    (tmp_path / "damaged.nc").write_text("not netCDF at all")
    status, out, err = swe(*line.split())
    assert (status, out) == (2, "")
    assert err.startswith("swe-sphere: ") and err.count("\n") == 1
    assert MISTAKES[line] in err


@pytest.mark.thorough
@pytest.mark.parametrize(("sent", "name"), [(signal.SIGINT, "Ctrl-C"), (signal.SIGTERM, "SIGTERM")])
def test_a_stop_signal_keeps_the_runs_and_leaves_with_130(tmp_path, sent, name):
    command = (PROGRAM, "sweep", "lauter", "--steppers", "rk4", "--dt", "60,50,40",
               "--ne", "3", "--days", "1", "--out", tmp_path)  # fmt: skip
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    end = time.monotonic() + 300.0
    while time.monotonic() < end and not runs_of(tmp_path).records:
        time.sleep(0.01)
    process.send_signal(sent)
    err = process.communicate(timeout=300)[1].replace(f"swe-sphere: {COMPILING}\n", "")
    assert process.returncode == 130 and err.count("\n") == 1
    assert err.startswith(f"swe-sphere: interrupted by {name}") and "resumes the sweep" in err
    assert runs_of(tmp_path).records and (tmp_path / "sweep.nc").exists()


def test_a_flag_replaces_a_setting_of_a_recipe_and_keeps_the_others(swe, tmp_path):
    text = RECIPE.partition("[[sweep]]")[0] + "[[sweep]]\nscene = 'williamson2'\n"
    (tmp_path / "one.toml").write_text(text + "[sweep.set.drag]\nlinear = 1e-6\nquadratic = 1e-9\n")
    options = ("--recipe", "one.toml", "--out", "d", "--set", "drag.linear=2e-6")
    assert swe(*options, "--set", "viscosity.nu=1e5")[0] == 0
    (found,) = {*xr.open_dataset(tmp_path / "d" / "williamson2" / "sweep.nc").settings.values}
    assert found == "drag.quadratic=1e-09 drag.linear=2e-6 viscosity.nu=1e5"


def test_settings_of_a_sweep_are_added_to_those_of_all_sweeps(swe, tmp_path):
    head, _, _ = RECIPE.partition("[[sweep]]")
    text = f"{head}[set.drag]\nlinear = 1e-6\n[set.viscosity]\nnu = 1e5\n"
    text += "[[sweep]]\nscene = 'williamson2'\n[sweep.set.drag]\nquadratic = 1e-9\n"
    (tmp_path / "one.toml").write_text(text)
    assert swe("--recipe", "one.toml", "--out", "d")[0] == 0
    (found,) = {*xr.open_dataset(tmp_path / "d" / "williamson2" / "sweep.nc").settings.values}
    assert {*found.split()} == {
        "drag.linear=1e-06",
        "drag.quadratic=1e-09",
        "viscosity.nu=100000.0",
    }


def test_a_flag_for_what_a_recipe_varies_is_refused(swe, tmp_path):
    text = RECIPE.partition("[[sweep]]")[0] + "[[sweep]]\nscene = 'williamson2'\n"
    (tmp_path / "one.toml").write_text(text + "[sweep.each]\n'drag.linear' = ['1e-6', '1e-5']\n")
    status, *said = swe("--recipe", "one.toml", "--out", "d", "--set", "drag.linear=2e-6")
    assert status == 2 and "sets what [sweep.each] of the recipe varies" in said[1]


def test_a_sweep_of_a_recipe_has_its_folder_also_alone(swe, tmp_path):
    (tmp_path / "two.toml").write_text(RECIPE)
    assert swe("--recipe", "two.toml", "--out", "d")[0] == 0
    page = (tmp_path / "d" / "README.md").read_text()
    made = {path: path.stat().st_mtime_ns for path in (tmp_path / "d").rglob("runs/*")}
    assert swe("lauter", "--recipe", "two.toml", "--out", "d")[0] == 0
    assert made == {path: path.stat().st_mtime_ns for path in (tmp_path / "d").rglob("runs/*")}
    assert (tmp_path / "d" / "README.md").read_text() == page


def test_a_search_of_which_nothing_can_run_says_why(swe):
    asked = ("williamson1", "--steppers", "semi-implicit", "--target-error", 1e-3)
    status, out, err = swe(*asked, *TINY)
    assert status == 1 and "semi-implicit, ne2 np4 float64: scene williamson1 has no" in err
    assert "williamson1: no run has an error that could be compared" in out


def test_the_status_is_that_of_the_runs_of_the_request(swe):
    """Runs that an earlier request left in the folder do not count."""
    assert swe("lauter", "--steppers", "rk4", "--dt", 3600, *TINY)[0] == 0
    assert swe("lauter", "--steppers", "leapfrog", "--dt", 10800, *TINY)[0] == 1
    assert swe("lauter", "--steppers", "rk4", "--dt", 3600, *TINY)[0] == 0


def test_notes_are_those_of_the_sweeps_that_have_them(swe, tmp_path):
    """By the name of the sweep where it has one, and a scene may be a file."""
    (tmp_path / "flow.toml").write_text('base = "lauter"\nname = "flow"\n')
    recipe = RECIPE.replace('note = "steady"', 'note = "steady"\nname = "still"')
    (tmp_path / "two.toml").write_text(recipe.replace('"lauter"', '"flow.toml"\nnote = "mine"'))
    assert swe("--recipe", "two.toml", "--out", "d")[0] == 0
    page = (tmp_path / "d" / "README.md").read_text()
    assert page.endswith("|['still', 'flow']|{'still': 'steady', 'flow': 'mine'}")


def test_a_report_is_made_while_other_sweeps_have_yet_to_begin(swe, tmp_path):
    (tmp_path / "two.toml").write_text(RECIPE)
    assert swe("--recipe", "two.toml", "--out", "d")[0] == 0
    for path in (tmp_path / "d" / "lauter" / "runs").iterdir():
        path.unlink()
    (tmp_path / "d" / "index.html").unlink()
    assert swe("--out", "d", "--report-only")[0] == 0
    assert (tmp_path / "d" / "index.html").exists()
