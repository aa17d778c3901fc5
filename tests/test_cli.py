"""The command line: its contract, and one clear line for every mistake."""

import json
import os
import re
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import netCDF4
import numpy as np
import pytest

from swe_sphere.io.runfile import RunFile
from swe_sphere.logs import print_lines
from swe_sphere.settings.values import override
from swe_sphere.simulation.build import start_warp
from swe_sphere.simulation.observers import LogLines
from swe_sphere.simulation.planning import RunPlan
from swe_sphere.testcases import get_scene

PROGRAM = Path(sys.executable).parent / "swe-sphere"
KEYS = {
    "scene", "stepper", "ne", "np", "dt", "steps", "days", "wall_seconds", "compile_seconds",
    "rhs_evaluations", "newton_iterations", "krylov_iterations", "l1_h", "l2_h", "linf_h", "l2_v",
    "mass_drift", "energy_drift", "enstrophy_drift", "completed", "reason",
}  # fmt: skip
SMALL = ("--ne", "2", "--days", "0.5")


def process(*arguments, **options):
    """Starts the installed program."""
    return subprocess.Popen(
        [PROGRAM, *map(str, arguments)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **options,
    )  # fmt: skip


def output(folder, code):
    """What a Python program prints that is started in a folder without our source tree."""
    return subprocess.check_output([sys.executable, "-c", code], text=True, cwd=folder)


# --- what works


def test_list_has_a_line_for_each_scene_and_stepper(swe):
    status, out, err = swe("list")
    assert (status, err) == (0, "")
    for name in ("williamson2", "lake-at-rest", "leapfrog", "fully-implicit", "hyperviscosity"):
        assert re.search(rf"^  {name} +\S.*\w", out, re.MULTILINE), name
    for title in (
        "Scenes",
        "Steppers, explicit",
        "Steppers, imex",
        "Steppers, implicit",
        "Effects",
    ):
        assert f"{title}:\n" in out
    assert max(map(len, out.splitlines())) <= 80


def test_json_is_the_last_line_and_has_every_key(swe):
    status, out, err = swe("run", "williamson2", *SMALL, "--json")
    numbers = json.loads(out.splitlines()[-1])
    assert (status, err) == (0, "")
    assert numbers.keys() >= KEYS
    assert numbers["completed"] is True and numbers["newton_iterations"] == 0


def test_the_table_tells_step_limit_and_shortening(swe):
    status, out, err = swe("run", "williamson2", *SMALL, "--dt", "5000")
    assert (status, err) == (0, "")
    flat = " ".join(out.replace("│", " ").split())
    assert "4800 s (as given), shortened from 5000 s to fit the frames" in flat
    assert re.search(r"stability limit 86\d\d\.\d s", flat)
    assert "error of depth" in out and "completed at day 0.5" in flat


def test_the_table_tells_what_the_solver_cost(swe):
    status, out, err = swe("run", "williamson2", *SMALL, "--stepper", "fully-implicit")
    assert (status, err) == (0, "")
    flat = " ".join(out.replace("│", " ").split())
    assert "williamson2 with fully-implicit (tr-bdf2)" in flat
    assert "3600 s (advective Courant number 2, at most 3600 s)" in flat
    assert "stability limit none" in flat
    assert re.search(r"iterations \d+ Newton, \d+ Krylov", flat)
    assert re.search(r"preconditioner helmholtz: \d+ applications, set up .* in .* s", flat)


def test_quiet_prints_nothing(swe):
    assert swe("run", "williamson2", *SMALL, "--quiet") == (0, "", "")


def test_files_pictures_and_comparison(swe, tmp_path):
    assert swe("run", "williamson2", *SMALL, "--out", "a.nc", "--quiet")[0] == 0
    assert swe("run", "williamson2", "--ne", 3, "--days", 0.5, "--out", "b.nc", "--quiet")[0] == 0
    status, out, _ = swe("compare", "a.nc", "b.nc", "--json")
    assert status == 0 and 0.0 < json.loads(out)["l2"] < 1e-2
    status, out, _ = swe("compare", "a.nc", "a.nc", "--time", 0)
    assert status == 0 and out.startswith("h at day 0\n") and "0.000000e+00" in out
    assert swe("plot", "a.nc", "--field", "vorticity")[0] == 0
    assert (tmp_path / "a_vorticity.png").read_bytes().startswith(b"\x89PNG")


def test_a_picture_without_a_file(swe, tmp_path):
    assert swe("run", "williamson2", *SMALL, "--plot", "p.png", "--quiet") == (0, "", "")
    assert [path.name for path in tmp_path.iterdir()] == ["p.png"]


def test_flags_go_before_the_file(swe, tmp_path):
    (tmp_path / "run.toml").write_text('scene = "williamson2"\nne = 3\ndays = 0.25\njson = true\n')
    _, out, _ = swe("run", "--config", "run.toml", "--ne", 2)
    numbers = json.loads(out)
    assert (numbers["ne"], numbers["days"]) == (2, 0.25)


def test_a_flag_replaces_the_setting_of_the_file_that_it_sets_and_no_other(swe, tmp_path):
    (tmp_path / "run.toml").write_text(
        'scene = "williamson2"\nne = 2\nnp = 4\ndays = 0.1\njson = true\nalpha = 0.5\n'
        "[set.viscosity]\nnu = 1e5\n[set.drag]\nlinear = 1e-6\nquadratic = 1e-9\n"
    )
    flags = ("--set", "drag.linear=2e-6", "--set", "scene.alpha=0.2")
    numbers = json.loads(swe("run", "--config", "run.toml", *flags)[1])
    assert numbers["effects"]["viscosity"] == {"nu": 1e5}
    assert numbers["effects"]["drag"] == {"linear": 2e-6, "quadratic": 1e-9}
    merged = override({"alpha": 0.5, "ne": 2}, {"settings": "scene.alpha=0.2"})
    assert merged == {"ne": 2, "settings": (("scene", "alpha", "0.2"),)}


def test_a_scene_in_a_file_of_the_user(swe, tmp_path):
    (tmp_path / "own.py").write_text(
        "from dataclasses import replace\n"
        "from swe_sphere.testcases import get_scene\n"
        "def scene(days: float = 0.5):\n"
        "    return replace(get_scene('williamson2'), name='own', days=days, ne=2)\n"
    )
    _, out, _ = swe("run", "own.py", "--set", "scene.days=0.25", "--json")
    assert json.loads(out)["scene"] == "own" and json.loads(out)["days"] == 0.25


def test_errors_against_a_reference(swe, lat_lon_file):
    run = ("run", "williamson6", "--ne", 2, "--np", 6, "--json", "--reference", lat_lon_file)
    status, out, _ = swe(*run, "--days", 0.25)
    assert status == 0 and 0.0 < json.loads(out)["l2_h"] < 0.1
    status, _, err = swe(*run, "--days", 0.5)
    assert status == 2 and "is of day 0.25, the run ends at day 0.5" in err


@pytest.fixture
def lat_lon_file(tmp_path):
    """The initial state of williamson6 on a latitude-longitude grid, said to be of day 0.25."""
    lat, lon = np.linspace(-89.0, 89.0, 90), np.arange(0.0, 360.0, 2.0)
    grid = np.meshgrid(np.radians(lon), np.radians(lat))
    with netCDF4.Dataset(tmp_path / "reference.nc", "w") as file:
        file.title = "reference, day 0.25"
        for name, values in (("lat", lat), ("lon", lon)):
            file.createDimension(name, values.size)
            file.createVariable(name, "f8", (name,))[:] = values
        for name, values in zip("uvh", get_scene("williamson6").initial(*grid), strict=True):
            file.createVariable(name, "f8", ("lat", "lon"))[:] = values
    return tmp_path / "reference.nc"


# --- mistakes


MISTAKES = {
    "run wiliamson2": "unknown scene 'wiliamson2'; did you mean 'williamson2'",
    "regrid damaged.nc --grid a/b": "damaged.nc",
    "verify --quick --resume": "resume: name the page to resume with --out, or leave resume out",
    "stress --quick --resume": "resume: name the page to resume with --out, or leave resume out",
    "run williamson2 --stepper rk5": "unknown stepper 'rk5'; did you mean 'rk4'",
    "run williamson2 --stepper fuly-implicit": "did you mean 'fully-implicit'",
    "run williamson2 --tolerance 1e-4": "stepper rk4 has no option 'tolerance'",
    "run williamson2 --every 1e-9": "days or every of 3.6e-06 s is too short",
    "run williamson2 --preconditioner none": "stepper rk4 has no option 'preconditioner'",
    "run williamson2 --stepper bdf2 --tolerance -1": "tolerance: must be greater than or equal to",
    "run williamson2 --stepper bdf2 --tolerance nan": "tolerance: must be a finite number",
    "run williamson2 --ne 2 --stepper bdf2 --preconditioner helmhotz": "mean 'helmholtz'",
    "run williamson2 --stepper bdf2 --set stepper.order=5": "it has tolerance, preconditioner",
    "run williamson2 --stepper bdf2 --set stepper.tolerance=x": "tolerance must be a number",
    "run williamson2 --stepper bdf2 --set stepper.=1": "stepper.parameter=value, got 'stepper.=1'",
    "run williamson2 --stepper bdf2 --tolerance 0.1 --set stepper.tolerance=0.1": "given twice",
    "run": "scene: name one",
    "run own.py": "there is no scene file own.py",
    "run williamson2 --dt -1": "dt: must be a positive number",
    "run williamson2 --dt 0": "dt: must be a positive number",
    "run williamson2 --dt nan": "dt: must be a positive number",
    "run williamson2 --dt soon": "dt: must be a positive number of seconds or 'auto', got 'soon'",
    "run williamson2 --ne 2 --dt 1e-99": "dt=1e-99 s means more than",
    "run williamson2 --ne 0": "ne=0: a cube edge must have at least one element",
    "run williamson2 --ne -1": "ne=-1: a cube edge must have at least one element",
    "run williamson2 --ne x": "--ne",
    "run williamson2 --ne 9999": "of memory",
    "run williamson2 --np 2": "np=2",
    "run williamson2 --np 17": "np=17",
    "run williamson2 --stretch 0.5": "stretch=0.5",
    "run williamson2 --alpha nan": "alpha: must be a finite number",
    "run williamson2 --alpha 45": "alpha=45: the angle is in radians",
    "run williamson2 --set scene.alpha=1e300": "alpha=1e+300: the angle is in radians",
    "run galewsky --alpha 0.1": "has no parameter 'alpha'; it has perturbed",
    "run williamson2 --days -1": "days: must be greater than or equal to 0",
    "sweep williamson2 --steppers rk4 --days 0 --out d": "days: must be greater than 0",
    "run williamson2 --every 0": "every: must be greater than 0",
    "run williamson2 --every 1e308": "every: must be less than or equal to",
    "run williamson2 --ne 2 --set viscosity.nu=1e308": "equations overflow in the initial state",
    "run williamson2 --ne 2 --set relaxation.time=1e-320": "of relaxation: rate must be finite",
    "run williamson2 --ne 2 --device cuda:0": "device 'cuda:0'",
    "run williamson2 --ne 2 --device abacus": "device 'abacus'",
    "run williamson2 --precision float16": "precision: must be 'float64' or 'float32'",
    "run williamson2 --time-limit 0": "time-limit: must be greater than 0",
    "run williamson2 --launch tile": "launch: must be 'element' or 'node'",
    "run williamson2 --set orography.height=1": "has no effect 'orography'; it has",
    "run williamson2 --set viscosity.mu=1": "has no parameter 'mu'; it has nu",
    "run williamson2 --set viscosity.nu": "effect.parameter=value, got 'viscosity.nu'",
    "run williamson2 --set viscosity.nu=-1": "viscosity.nu must be finite and not negative",
    "run williamson2 --set scene.alpha": "scene.parameter=value, got 'scene.alpha'",
    "run williamson2 --set scene.beta=1": "has no parameter 'beta'; it has alpha",
    "run williamson2 --alpha 0 --set scene.alpha=1": "alpha is given twice",
    "run williamson2 --out nowhere/a.nc": "out: there is no folder nowhere",
    "run williamson2 --out .": "out: . is a folder",
    "run williamson2 --out /": "out: / is a folder",
    "run williamson2 --plot p.txt": "plot: p.txt must end in .png",
    "run williamson2 --restart none.nc": "there is no file none.nc",
    "run williamson2 --trust none.py": "there is no file none.py",
    "run williamson2 --fields h": "fields: the run writes no file: give out, the name of one",
    "run williamson2 --restart damaged.nc": "cannot read damaged.nc",
    "run williamson2 --reference damaged.nc": "cannot read damaged.nc",
    "run --config none.toml": "cannot read none.toml",
    "run --config damaged.nc": "damaged.nc is not valid TOML",
    "plot none.nc": "there is no file none.nc",
    "plot damaged.nc": "cannot read damaged.nc",
    "regrid .": ". is a folder: give the name of a file in it",
    "compare damaged.nc damaged.nc": "cannot read damaged.nc",
    "compare damaged.nc": "Missing argument",
    "run williamson2 --alfa 1": "No such option: --alfa",
    "fly": "No such command 'fly'",
}


@pytest.mark.parametrize("line", MISTAKES)
def test_a_mistake_gets_one_line_and_status_2(swe, tmp_path, line):
    if "cuda" in line and _has_gpu():
        pytest.skip("there is such a device here")
    (tmp_path / "damaged.nc").write_text("not = netCDF = at all")
    status, out, err = swe(*line.split())
    assert (status, out) == (2, "")
    assert err.startswith("swe-sphere: ") and err.count("\n") == 1
    assert MISTAKES[line] in err
    assert [path.name for path in tmp_path.iterdir()] == ["damaged.nc"]


@pytest.mark.parametrize(
    ("command", "page"), [("verify --quick", "verification"), ("stress --quick", "stability")]
)
def test_a_page_of_somebody_else_is_not_replaced(swe, tmp_path, command, page):
    (tmp_path / "page.md").write_text("# Mine\n")
    status, out, err = swe(*command.split(), "--out", "page.md")
    assert (status, out) == (2, "") and f"page.md is no {page} page" in err
    assert (tmp_path / "page.md").read_text() == "# Mine\n"


def _has_gpu():
    import warp as wp

    start_warp()
    return wp.is_cuda_available()


@pytest.mark.parametrize("line", ["wiliamson2 --ne 4 --json", "--ne 4 --config run.toml"])
def test_a_mistake_with_json_gets_a_json_line_too(swe, tmp_path, line):
    (tmp_path / "run.toml").write_text('scene = "wiliamson2"\njson = true\n')
    status, out, err = swe("run", *line.split())
    numbers = json.loads(out)
    assert status == 2 and numbers.keys() >= KEYS
    assert (numbers["completed"], numbers["scene"], numbers["ne"]) == (False, "wiliamson2", 4)
    assert err == f"swe-sphere: {numbers['reason']}\n"


def test_a_failed_run_says_why_and_leaves_with_1(swe):
    unstable = ("--ne", 2, "--days", 20, "--dt", 28800, "--out", "a.nc")
    status, out, err = swe("run", "williamson2", *unstable, "--json")
    numbers = json.loads(out)
    assert (status, numbers["completed"], numbers["l2_h"]) == (1, False, None)
    *warnings, reason = err.splitlines()
    assert sum("times the stability limit" in warning for warning in warnings) == 1
    assert reason == f"swe-sphere: {numbers['reason']}; a.nc keeps all that was written"


def test_an_old_file_survives_a_mistake(swe, tmp_path):
    (tmp_path / "a.nc").write_text("precious")
    swe("run", "williamson2", "--ne", 2, "--out", "a.nc", "--dt", "1e9")
    assert (tmp_path / "a.nc").read_text() == "precious"


@pytest.mark.skipif(os.geteuid() == 0, reason="everything is writable for root")
def test_a_folder_that_cannot_be_written_to(swe, tmp_path):
    (tmp_path / "locked").mkdir(mode=0o500)
    status, _, err = swe("run", "williamson2", *SMALL, "--out", "locked/a.nc")
    assert status == 2 and "locked cannot be written to" in err


def test_an_error_of_ours_is_one_line_too(swe, monkeypatch):
    def broken(*_):
        raise ZeroDivisionError("our\nfault")

    monkeypatch.setattr("swe_sphere.cli.run.run_scene", broken)
    status, out, err = swe("run", "williamson2", "--json")
    line = "unexpected ZeroDivisionError: our fault (SWE_SPHERE_DEBUG=1 shows where)"
    assert (status, err) == (1, f"swe-sphere: {line}\n")
    assert json.loads(out)["reason"] == line
    monkeypatch.setenv("SWE_SPHERE_DEBUG", "1")
    assert "Traceback" in swe("run", "williamson2")[2]


def test_no_days_write_the_start(swe):
    status, out, _ = swe("run", "williamson5", *SMALL, "--days", 0, "--out", "start.nc", "--json")
    numbers = json.loads(out)
    assert (status, numbers["steps"], numbers["days"], numbers["rhs_evaluations"]) == (0, 0, 0, 0)
    assert RunFile("start.nc").times.tolist() == [0.0]


def test_a_run_out_of_time_says_how_it_goes_on(swe):
    Path("my flow.toml").write_text('base = "williamson2"\n')
    options = ("--ne", 3, "--dt", 600, "--days", 20, "--every", 240, "--out", "a b.nc")
    status, _, err = swe("run", "my flow.toml", *options, "--time-limit", 0.002)
    line = err.splitlines()[-1]
    assert (status, line.partition(": resume with: ")[0]) == (1, "swe-sphere")
    steps = json.loads(RunFile("a b.nc").attributes["summary"])["steps"]
    command = shlex.split(line.partition("swe-sphere run ")[2])
    status, out, _ = swe("run", *command, "--json")
    assert (status, json.loads(out)["steps"]) == (0, 2880) and 0 < steps < 2880


def test_a_log_has_a_line_now_and_then(monkeypatch, capsys):
    """The first after a while only, so that short runs tell nothing."""
    now = iter([0.0, 1.0, 31.0, 32.0, 400.0])
    monkeypatch.setattr("swe_sphere.simulation.observers.time.perf_counter", lambda: next(now))
    lines = LogLines()
    lines.begin(RunPlan(864.0, 100, 100, 864.0), SimpleNamespace(time=0.0))
    with print_lines():
        for step in (10, 25, 30, 80):
            lines.tick(step)
    told = capsys.readouterr().err.splitlines()
    assert told == [
        "swe-sphere: day 0.25 of 1 after 31 s, 0.484 days a minute, 93 s to go",
        "swe-sphere: day 0.80 of 1 after 400 s, 0.12 days a minute, 100 s to go",
    ]


def test_the_log_of_a_resumed_run_counts_its_own_days_alone(monkeypatch, capsys):
    now = iter([0.0, 60.0])
    monkeypatch.setattr("swe_sphere.simulation.observers.time.perf_counter", lambda: next(now))
    lines = LogLines()
    lines.begin(RunPlan(864.0, 100, 100, 864.0), SimpleNamespace(time=43200.0))
    with print_lines():
        lines.tick(75)
    told = capsys.readouterr().err
    assert told == "swe-sphere: day 0.75 of 1 after 60 s, 0.25 days a minute, 60 s to go\n"


# --- the program as a process


def test_ctrl_c_keeps_the_file_and_leaves_with_130(tmp_path):
    file = tmp_path / "a.nc"
    # dissipation keeps it from blowing up on its own, however fast the machine is
    long = ("--ne", 4, "--days", 20000, "--set", "hyperviscosity.nu=default")
    run = process("run", "williamson5", *long, "--out", file, "--json")
    _wait_for_frames(file)
    run.send_signal(signal.SIGINT)
    out, err = run.communicate(timeout=300)
    numbers = json.loads(out)
    assert run.returncode == 130 and numbers["completed"] is False
    assert err.endswith(f"swe-sphere: {numbers['reason']}; {file} keeps all that was written\n")
    assert RunFile(file).times[-1] == pytest.approx(numbers["days"] * 86400.0)


@pytest.mark.thorough
def test_a_first_run_says_that_it_compiles(tmp_path):
    """In one line, also beside JSON; later runs, and those asked to be quiet, do not."""
    cache = {**os.environ, "WARP_CACHE_PATH": str(tmp_path / "cache")}
    options = ("run", "williamson2", "--ne", 2, "--np", 4, "--days", 0.01)
    line = "swe-sphere: compiling kernels, the first time only ...\n"
    for flags, said in (("--json", line), ("--json", "")):
        run = process(*options, flags, env=cache)
        out, err = run.communicate(timeout=300)
        assert (run.returncode, err) == (0, said)
        assert json.loads(out)["completed"] is True
    (headers,) = tmp_path.glob("cache/*/headers_*/*.pch")
    made = headers.stat().st_mtime_ns
    run = process(*options, "--np", 5, "--quiet", env=cache)
    assert run.communicate(timeout=300) == ("", "")
    assert headers.stat().st_mtime_ns == made  # other kernels, the same headers


def _wait_for_frames(file):
    """Until the file has grown beyond its first frame."""
    end = time.monotonic() + 300.0
    sizes = set()
    while len(sizes) < 3 and time.monotonic() < end:
        if file.exists():
            sizes.add(file.stat().st_size)
        time.sleep(0.1)


def test_a_disk_that_fills_up_ends_the_run_and_keeps_the_frames(tmp_path):
    import resource

    def small_disk():
        resource.setrlimit(resource.RLIMIT_FSIZE, (3_000_000, 3_000_000))

    file = tmp_path / "a.nc"
    options = ("--ne", 8, "--days", 40, "--dt", 1200, "--out", file)
    run = process("run", "williamson2", *options, "--json", preexec_fn=small_disk)
    out, err = run.communicate(timeout=300)
    assert run.returncode == 1 and f"cannot write {file}" in err.splitlines()[-1]
    assert json.loads(out)["completed"] is False
    assert 1 < RunFile(file).times.size < 40


def test_importing_the_package_loads_next_to_nothing(tmp_path):
    code = (
        "import sys, swe_sphere\n"
        "print({'numpy', 'warp', 'netCDF4', 'matplotlib', 'cartopy'} & sys.modules.keys())"
    )
    assert output(tmp_path, code) == "set()\n"


def test_help_does_not_load_warp(tmp_path):
    code = (
        "import sys; from swe_sphere.cli.main import main\n"
        "try: main(['run', '--help'])\n"
        "except SystemExit as end: assert end.code == 0\n"
        "print('warp' in sys.modules)"
    )
    assert output(tmp_path, code).splitlines()[-1] == "False"


def test_a_plain_run_loads_neither_plots_nor_files(tmp_path):
    code = (
        "import sys; from swe_sphere.cli.main import main\n"
        "try: main(['run', 'williamson2', '--ne', '2', '--days', '0.1', '--quiet'])\n"
        "except SystemExit as end: assert end.code == 0\n"
        "print(sorted({'matplotlib', 'xarray', 'netCDF4', 'pandas', 'cartopy', 'scipy.sparse',"
        " 'numpy.ma', 'swe_sphere.studies', 'rich.progress'} & sys.modules.keys()))"
    )
    assert output(tmp_path, code) == "[]\n"


def test_a_run_whose_scene_has_references_does_not_load_xarray(tmp_path):
    code = (
        "import sys; from swe_sphere.cli.main import main\n"
        "try: main(['run', 'williamson5', '--ne', '2', '--days', '0.1', '--quiet'])\n"
        "except SystemExit as end: assert end.code == 0\n"
        "print(sorted({'matplotlib', 'xarray', 'netCDF4', 'pandas'} & sys.modules.keys()))"
    )
    assert output(tmp_path, code) == "[]\n"


@pytest.mark.parametrize(
    "arguments",
    [("run", "williamson2", "--ne", "two"), ("run", "williamson2", "--nonsense", 3),
     ("run", "--days"), ("run", "williamson2", "--days", "nan"), ("run", "nowhere"),
     ("compare", "a.nc", "b.nc"), ("compare", "a.nc"), ("verify", "--cases", "none"),
     ("stress", "--jobs", "many"), ("stress", "--groups", "none")],
)  # fmt: skip
def test_json_is_printed_for_every_mistake(swe, arguments):
    status, out, err = swe(*arguments, "--json")
    (line,) = out.splitlines()
    told = json.loads(line, parse_constant=lambda name: pytest.fail(name))
    assert status == 2 and told["status"] == "refused" and not told["completed"]
    assert err == f"swe-sphere: {told['reason']}\n" and {*told} >= KEYS


def test_json_has_no_bare_nan(swe, monkeypatch):
    found = {"field": "h", "time": None, "l1": float("nan"), "l2": np.inf, "linf": 1.0}
    monkeypatch.setattr("swe_sphere.io.reference_solution.compare", lambda *_: found)
    status, out, _ = swe("compare", "a.nc", "b.nc", "--json")
    told = json.loads(out, parse_constant=lambda name: pytest.fail(name))
    assert (status, told["l1"], told["l2"], told["linf"]) == (0, None, None, 1.0)


def test_a_run_that_fails_before_its_first_frame_claims_to_keep_nothing(swe):
    """The first sample precedes the first frame."""
    code = "@diagnostic(units='m')\ndef bad(sim):\n    return 1 / 0\n"
    Path("bad.py").write_text(f"from swe_sphere import diagnostic\n\n\n{code}")
    words = "run williamson2 --ne=2 --np=4 --days=0.25 --quiet --diagnostics=bad.py --out=a.nc"
    status, _, err = swe(*words.split())
    assert status == 1 and "the diagnostic bad fails: ZeroDivisionError" in err
    assert "keeps" not in err and not Path("a.nc").exists()


def test_ctrl_c_ends_each_command_with_a_line(swe, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("swe_sphere.steppers.list_steppers", interrupted)
    assert swe("list") == (130, "", "swe-sphere: interrupted by Ctrl-C\n")
