"""Standard streams that are closed or full, and names of files that few expect."""

import io
import os
import subprocess
import sys
from pathlib import Path

import pytest

from swe_sphere.cli.show import Results
from swe_sphere.io.runfile import RunFile

from .support import thorough

PROGRAM = Path(sys.executable).with_name("swe-sphere")
SMALL = "williamson2 --ne=2 --np=4 --dt=1800 --days=0.0625"


def shell(command):
    """Runs a command in a shell: status, stdout, stderr."""
    done = subprocess.run(
        ["sh", "-c", f"{PROGRAM} {command}"], capture_output=True, text=True, timeout=300,
        check=False,
    )  # fmt: skip
    return done.returncode, done.stdout, done.stderr


@pytest.mark.parametrize(
    ("command", "why"),
    [
        thorough("list > /dev/full", "No space left on device"),
        ("list >&-", "Bad file descriptor"),
        thorough("--version > /dev/full", "No space left on device"),
    ],
)
def test_a_result_that_is_lost_is_an_error(command, why):
    told = f"swe-sphere: cannot write to standard output: {why}\n"
    assert shell(command) == (1, "", told)


@pytest.mark.thorough
def test_a_failure_whose_json_is_lost_is_one_line():
    status, _, said = shell("compare none.nc none.nc --json > /dev/full")
    assert (status, said) == (2, "swe-sphere: there is no file none.nc\n")


def test_results_are_written_at_once(tmp_path):
    place = tmp_path / "out"
    results = Results(io.BufferedWriter(io.FileIO(place, "w")), "utf-8")
    print("found", file=results, end="")
    assert place.read_text() == "found"


@pytest.mark.parametrize("closed", ["2>&-", thorough("2>/dev/full"), thorough("<&- 2>&-")])
def test_errors_that_nobody_reads_show_in_the_status(closed):
    assert shell(f"nonsense {closed}") == (2, "", "")


@pytest.mark.thorough
@pytest.mark.parametrize("closed", ["2>&-", "2>/dev/full", "<&- 2>&-"])
def test_a_run_whose_notes_nobody_reads_goes_to_its_end(closed, tmp_path):
    status, told, _ = shell(f"run {SMALL} --out {tmp_path}/a.nc --json {closed}")
    assert status == 0 and '"completed": true' in told
    assert RunFile(tmp_path / "a.nc").times.size == 2


# --- names of files, and folders of the system


@pytest.fixture
def swe(swe):
    """Return a function that runs the program and returns its status and stderr."""
    return lambda *arguments: swe(*arguments)[::2]


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("loop.nc", "out: must be the name of a file (Too many levels of symbolic links)"),
        (os.fsdecode(b"a\xff.nc"), "out: must be the name of a file (it is not in UTF-8)"),
        (245 * "x" + ".nc", "is too long: take at most 247 bytes"),
        (82 * "\u20ac" + ".nc", "is too long: take at most 247 bytes"),
        ("loop.nc/a.nc", "out: must be the name of a file (Too many levels of symbolic links)"),
    ],
)
def test_a_name_that_no_file_can_have_is_refused_before_the_run(swe, name, told):
    Path("loop.nc").symlink_to("loop.nc")
    status, said = swe("run", *SMALL.split(), "--out", name)
    assert status == 2 and said.count("\n") == 1 and told in said
    assert os.listdir() == ["loop.nc"]  # noqa: PTH208


@pytest.mark.parametrize("name", [" x.nc", "x.nc ", "a#b.nc", "c:x.nc", "a\nb.nc", " y.zarr"])
def test_awkward_names_are_those_of_the_files(swe, name):
    assert swe("run", *SMALL.split(), "--quiet", "--out", name) == (0, "")
    assert {path.name for path in Path().iterdir()} == {name, f"{name}.restart"}
    assert swe("run", *SMALL.split(), "--days=0.125", "--quiet", f"--restart={name}") == (0, "")
    assert RunFile(name).times.size == 2


@pytest.mark.thorough
def test_a_home_that_is_no_folder_is_told_in_one_line():
    others = {n: x for n, x in os.environ.items() if n not in ("WARP_CACHE_PATH", "XDG_CACHE_HOME")}
    done = subprocess.run(
        [PROGRAM, "run", *SMALL.split(), "--quiet"], env=others | {"HOME": "/dev/null"},
        capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip
    assert done.returncode == 2 and done.stderr.count("\n") == 1
    assert "swe-sphere: compiled kernels cannot be kept: Not a directory" in done.stderr
    assert "WARP_CACHE_PATH" in done.stderr


@pytest.mark.thorough
@pytest.mark.parametrize("ending", ["*.o", "*.meta"])
def test_a_damaged_kernel_is_named(tmp_path, ending):
    environment = os.environ | {"WARP_CACHE_PATH": str(tmp_path)}
    command = [PROGRAM, "run", *SMALL.split(), "--quiet"]
    subprocess.run(command, env=environment, check=True, timeout=600)
    for path in tmp_path.rglob(ending):
        os.truncate(path, 5)
    done = subprocess.run(
        command, env=environment, capture_output=True, text=True, timeout=600, check=False
    )
    line = done.stderr.splitlines()[-1]
    assert done.returncode == 2 and "Traceback" not in done.stderr
    assert line.startswith("swe-sphere: a compiled kernel is damaged")
    assert f"remove {tmp_path}" in line and "unexpected" not in line
