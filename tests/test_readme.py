"""Commands and scripts of the README and of the documentation work."""

import inspect
import re
import runpy
import shutil
import textwrap
import tomllib
from pathlib import Path

import matplotlib as mpl
import pytest
import typer
import xarray as xr

from swe_sphere.cli.main import main
from swe_sphere.mesh.partition import check_ranks
from swe_sphere.settings.values import by_field, read_toml
from swe_sphere.simulation.config import make_config
from swe_sphere.simulation.simulation import run_scene

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()
EXAMPLES = re.findall(
    r"```python\n# (\w+\.py)\n(.*?)```", (ROOT / "docs/howto/extending.md").read_text(), re.DOTALL
)
COMMAND_PAGE = (ROOT / "docs/reference/commands.md").read_text()
(SCRIPT,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
FIRST_LINES, SCENE = re.findall(
    r"```python\n(.*?)```", (ROOT / "docs/tutorials/start.md").read_text(), re.DOTALL
)


def test_the_scene_runs_and_stays_in_balance(tmp_path):
    (tmp_path / "my_flow.py").write_text(SCENE)
    config = make_config({"scene": str(tmp_path / "my_flow.py"), "days": 0.5, "ne": 4})
    assert run_scene(config)["l2_h"] < 1e-3


def test_the_script_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    mpl.use("Agg")
    found: dict = {}
    exec(SCRIPT.replace("ne=8", "ne=4"), found)
    drift, vorticity = (float(word) for word in capsys.readouterr().out.split())
    assert abs(drift) < 1e-3 and 5e-5 < vorticity < 3e-4
    assert found["frames"].h.sizes["time"] == 3


def test_the_first_lines_of_python_run(capsys):
    exec(FIRST_LINES, {})
    assert 0.0 < float(capsys.readouterr().out) < 1e-3


def test_the_configuration_file_is_valid(tmp_path):
    block = COMMAND_PAGE.split("for `--config run.toml`:\n")[1].split("## Mesh")[0]
    (tmp_path / "run.toml").write_text(textwrap.dedent(block))
    config = make_config(by_field(read_toml(tmp_path / "run.toml")))
    assert (config.ne, config.settings) == (16, (("hyperviscosity", "nu", "default"),))
    assert [(one.path.name, one.every, one.grid) for one in config.outputs] == [
        ("wind.nc", 3.0, "latlon:91x180")
    ]


@pytest.mark.parametrize("page", ["README.md", "CONTRIBUTING.md"])
def test_links_lead_somewhere(page):
    """Those of the pages in docs are checked where the site is built."""
    for link in re.findall(r"\]\((?!http)([^)#]+)", (ROOT / page).read_text()):
        assert (ROOT / link).exists(), f"{page}: {link}"


APART = re.compile(r"^(?: {4}(?:.*/)?)?swe-sphere ([a-z].*?)(?: {2,}.*)?$", re.MULTILINE)
"""A command on a line of its own, indented or in a block."""
INLINE = re.compile(
    r"`swe-sphere ((?:run|plot|sweep|verify|stress)(?! NAME| --help| --fields| --out)"
    r"(?:| [^`]*)(?<!--live vorticity))`"
)
"""A whole one in the text, but for that which needs a terminal."""
GENERATED = ("reference/generated/*",)
"""Pages in docs that are written when the site is built."""
PAGES = [
    ROOT / "README.md",
    *(
        page
        for page in sorted((ROOT / "docs").rglob("*.md"))
        if not any(page.match(pattern) for pattern in GENERATED)
    ),
]
PICTURES = [
    [f"run {name} {each['run']} --out {name}.nc", f"plot {name}.nc {each.get('plot', '')}".strip()]
    for name, each in tomllib.loads(
        (ROOT / "docs/reference/gallery/commands.toml").read_text()
    ).items()
]
"""Commands of the catalogue of scenes."""
COMMANDS = [
    pytest.param(found, id=f"{page.stem}-{kind}")
    for kind, form in (("apart", APART), ("inline", INLINE))
    for page in PAGES
    if (found := form.findall(page.read_text()))
] + [pytest.param(lines, id=f"picture-{lines[0].split()[1]}") for lines in PICTURES]
INSTEAD = {"--out jet.nc --days 8": "--out jet.nc --days 0.1", "--time 4": "--time 0"}
"""Times that are in the files of shortened runs."""
SHORTER = {
    "run": "--days 0.05",
    "ensemble": "--days 0.05 --seeds 1,2",
    "advise": "--budget 2 --days 0.25 --steppers rk4",
    "verify": "--quick --scenes lake-at-rest",
    "stress": "--quick --groups guards --steppers rk4",
}
"""Added to commands."""
NE = 4
"""At the most, in runs whose step is left open, as it follows from the mesh.

Where a step is given, the mesh decides whether it is stable.
"""
READ_BY_NONE = ("list", "sweep", "advise", "verify", "stress")
"""Commands that leave nothing for the next ones of their page."""


def _shortened(line):
    for long, short in INSTEAD.items():
        line = line.replace(long, short)
    name = line.split()[0]
    if "--restart" in line:
        return line
    if name in ("run", "ensemble") and "--dt" not in line and "--ranks" not in line:
        line = _coarsened(line)
    added = SHORTER.get(name, "")
    return f"{line} {added.removeprefix('--quick ') if '--quick' in line else added}"


def _coarsened(line):
    """A number is replaced where it stands: one that makes no sense must not be hidden."""
    if "--ne" not in line:
        return f"{line} --ne {NE}"
    return re.sub(r"(?<=--ne )\d+", lambda ne: str(min(int(ne[0]), NE)), line)


@pytest.fixture(scope="module")
def files_of_the_reader(tmp_path_factory):
    """What the pages say that one has: steppers, a recipe, an analysis, and two runs to compare."""
    folder = tmp_path_factory.mktemp("reader")
    (folder / "docs").mkdir()
    for name, text in EXAMPLES:
        (folder / name).write_text(text)
    (slow,) = re.findall(
        r"```toml\n(.*?)```", (ROOT / "docs/reference/scenes.md").read_text(), re.DOTALL
    )
    (folder / "slow.toml").write_text(slow)
    (folder / "mine.toml").write_text('scene = "lauter"\nsteppers = ["rk4"]\n')
    shutil.copy(ROOT / "tests" / "data" / "analysis.nc", folder)
    for name, days in (("a.nc", 0.01), ("b.nc", 0.01), ("earlier.nc", 0.25)):
        short = {"scene": "williamson2", "ne": 2, "np": 4, "days": days, "every": 6.0}
        run_scene(make_config(short | {"out": str(folder / name)}))
    return folder


@pytest.fixture(scope="module")
def done():
    """Commands of `READ_BY_NONE` that have worked already: several pages have the same."""
    return set()


@pytest.fixture
def ranks(monkeypatch):
    """How many processes were asked for; one does their work, as `test_ranks.py` starts several."""
    asked = []

    def start_ranks(ranks, ne, arguments):
        asked.append(ranks)
        check_ranks(ne, ranks)
        alone = re.sub(r" --ranks \d+", "", " ".join(arguments))
        with pytest.raises(SystemExit) as end:
            main(f"{alone} --ne {NE}".split())
        return end.value.code

    monkeypatch.setattr("swe_sphere.cli.run.start_ranks", start_ranks)
    return asked


BENCHMARKS = ROOT / "benchmarks"
SCRIPTS = re.compile(r"python benchmarks/(\w+\.py)((?: [\w.,/=-]+)*)")
SCRIPT_LINES = {
    found
    for page in (*PAGES, ROOT / "CONTRIBUTING.md", *BENCHMARKS.glob("*.py"))
    for found in SCRIPTS.findall(page.read_text())
}


@pytest.mark.parametrize(("script", "arguments"), sorted(SCRIPT_LINES))
def test_the_benchmarks_take_these_arguments(script, arguments, monkeypatch):
    """They take long: the scripts are loaded, and what they are given is read."""
    monkeypatch.syspath_prepend(BENCHMARKS)
    main = runpy.run_path(str(BENCHMARKS / script), run_name="loaded")["main"]
    if "typer.run(main)" in (BENCHMARKS / script).read_text():
        app = typer.Typer()
        app.command()(main)
        typer.main.get_command(app).make_context(script, arguments.split())
    else:
        inspect.signature(main).bind(*arguments.split())


def test_arguments_that_a_benchmark_does_not_take_are_found(monkeypatch):
    for script, arguments in (("versions.py", " --nonsense 3"), ("transport.py", " --ne 3")):
        with pytest.raises((typer.TyperException, TypeError)):
            test_the_benchmarks_take_these_arguments(script, arguments, monkeypatch)


@pytest.mark.parametrize("lines", COMMANDS)
@pytest.mark.thorough
def test_the_commands_work(lines, files_of_the_reader, done, ranks, tmp_path, monkeypatch, capsys):
    """Each command of a page in turn, in one folder: shortened, and of sweeps the plan alone.

    A warning is a failure: it says that the whole run would blow up.
    """
    shutil.copytree(files_of_the_reader, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)

    def run_sweep(plan, folder, watcher):
        watcher.completed = True
        return xr.Dataset()

    monkeypatch.setattr("swe_sphere.cli.sweep.run_sweep", run_sweep)
    sweeps = ("cli.sweep._show_sweep", "cli.sweep._begun", "cli.sweep._by_name")
    for name in (*sweeps, "studies.report.write_report"):
        monkeypatch.setattr(f"swe_sphere.{name}", lambda *_, **__: ())
    monkeypatch.setattr("swe_sphere.pictures.plot.DOTS_PER_INCH", 36)
    for line in lines:
        short = _shortened(line)
        if short in done:
            continue
        with pytest.raises(SystemExit) as end:
            main(short.split())
        said = capsys.readouterr().err
        assert end.value.code == 0 and "warning" not in said, f"{line}: {said}"
        if line.startswith(READ_BY_NONE):
            done.add(short)
    assert ranks == [int(number) for number in re.findall(r"--ranks (\d+)", "\n".join(lines))]
