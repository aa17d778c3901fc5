"""Temporary files: nobody can predict their names, and only those of this program are removed."""

import json
import os
import secrets
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Barrier

import numpy as np
import pytest
import xarray as xr

from swe_sphere.cli.main import main
from swe_sphere.errors import ConfigError, RunFailed
from swe_sphere.files import durable
from swe_sphere.files.durable import building, claim, take_place, write_whole
from swe_sphere.pictures.plot import animate_file, plot_file
from swe_sphere.simulation.simulation import Simulation
from swe_sphere.studies import record_store

from .support import thorough


def small():
    return Simulation("williamson2", ne=2, np=4, dt=1800.0)


@pytest.mark.parametrize("name", ["run.nc", thorough("run.zarr")])
def test_what_a_user_has_called_like_a_temporary_file_is_left_alone(tmp_path, name):
    pytest.importorskip("zarr")
    theirs = tmp_path / "theirs"
    theirs.write_text("mine")
    for ending in (".part", ".restart.part", ".old.part"):
        (tmp_path / f"{name}{ending}").symlink_to(theirs)
    folder = tmp_path / f"{name}.old"
    folder.mkdir()
    (folder / "chapter").write_text("one")
    for _ in range(2):
        small().run(days=0.25, out=tmp_path / name, overwrite=True)
    assert theirs.read_text() == "mine" and (folder / "chapter").read_text() == "one"
    assert len([*tmp_path.iterdir()]) == 7


@pytest.mark.parametrize("folder", [False, True])
def test_a_temporary_name_is_another_one_each_time_and_is_locked(tmp_path, folder):
    path, names = tmp_path / "run.nc", set()
    for _ in range(5):
        file, part = claim(path, folder)
        assert part.parent == tmp_path and part.is_dir() == folder
        with pytest.raises(ConfigError, match="another program writes it"):
            claim(path, folder)
        names.add(part.name)
        durable.release(file)
    assert len(names) == 5
    assert [each.name for each in tmp_path.iterdir()] == [part.name]  # those before were left


@pytest.mark.parametrize("amid", ["before", "after", "renamed"])
@pytest.mark.parametrize("folder", [False, True])
def test_of_two_programs_that_claim_a_file_at_once_one_gets_it(tmp_path, monkeypatch, folder, amid):
    path, create, held = tmp_path / "run.nc", durable._create, []

    def created(path, folder):
        monkeypatch.setattr(durable, "_create", create)
        if amid == "after":
            held.append(create(path, folder))
            with pytest.raises(ConfigError, match="another program writes it"):
                claim(path, folder)
            return held[0]
        held.append(claim(path, folder))
        if amid == "renamed":
            take_place(held[0][1], path)
        return create(path, folder)

    monkeypatch.setattr(durable, "_create", created)
    if amid == "after":
        assert claim(path, folder) == held[0]
    else:
        with pytest.raises(ConfigError, match="another program writes it"):
            claim(path, folder)
    assert len([*tmp_path.iterdir()]) == 1


def test_of_many_that_claim_a_file_at_once_one_gets_it(tmp_path):
    """Locks belong to open files, so that threads are as good as processes."""
    start = Barrier(8)

    def claimed(path):
        start.wait()
        try:
            return claim(path)
        except ConfigError as error:
            assert "another program writes it" in str(error)

    with ThreadPoolExecutor(8) as threads:
        for attempt in range(10):
            path = tmp_path / f"{attempt}.nc"
            (held,) = filter(None, threads.map(claimed, [path] * 8))
            assert [*tmp_path.glob(f".{attempt}*")] == [held[1]]
            durable.release(held[0])


@pytest.mark.parametrize("planted", ["file", "link", "dangling", "folder"])
def test_a_temporary_file_is_created_exclusively(tmp_path, monkeypatch, planted):
    path, theirs = tmp_path / "run.nc", tmp_path / "theirs"
    theirs.write_text("mine")
    monkeypatch.setattr(secrets, "token_hex", lambda _: "01234567")
    place = durable._new_name(path)
    if planted == "file":
        place.write_text("mine")
    elif planted == "folder":
        place.mkdir()
    else:
        place.symlink_to(theirs if planted == "link" else tmp_path / "nowhere")
    if planted in ("link", "dangling"):
        with pytest.raises(OSError):
            claim(path)
    monkeypatch.setattr(durable, "_remove_unfinished", lambda path: None)  # planted after that
    with pytest.raises(RunFailed, match="cannot write"):
        write_whole(path, "ours")
    assert theirs.read_text() == "mine" and not (tmp_path / "nowhere").exists()
    assert not path.exists() and (place.is_symlink() or place.exists())


def test_only_what_has_the_mark_of_the_program_is_removed(tmp_path):
    path = tmp_path / "run.nc"
    durable.release(claim(path)[0])
    (ours,) = tmp_path.iterdir()
    like = [
        ours.with_name(".run.nc.0123456789abcdef.part.nc"), ours.with_name("run.nc.part"),
        ours.with_name(ours.name.replace("run", "sun")), ours.with_name(".run.nc.part.nc"),
    ]  # fmt: skip
    for each in like:
        each.write_text("mine")
    write_whole(path, "first")
    assert not ours.exists() and path.read_text() == "first"
    durable.release(claim(path)[0])
    (ours,) = {*tmp_path.iterdir()} - {path, *like}
    file, part = claim(path)
    take_place(part, path)
    durable.release(file)
    assert not ours.exists() and all(each.read_text() == "mine" for each in like)


def test_what_is_built_takes_its_place_at_the_end_or_not_at_all(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("before")
    with pytest.raises(ZeroDivisionError), building(path) as part:
        part.write_text("half")
        raise ZeroDivisionError
    assert path.read_text() == "before" and [*tmp_path.iterdir()] == [path]
    with building(path) as part:
        part.write_text("whole")
    assert path.read_text() == "whole" and [*tmp_path.iterdir()] == [path]


def test_a_file_that_a_killed_program_left_is_removed_and_one_in_use_is_not(tmp_path):
    path = tmp_path / "page.html"
    code = (
        "import os; from pathlib import Path; from swe_sphere.files import durable\n"
        "durable.take_place = lambda part, path: os.kill(os.getpid(), 9)\n"
        f"durable.write_whole(Path({str(path)!r}), 'half')"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == -9
    assert len([*tmp_path.iterdir()]) == 1
    file, part = claim(tmp_path / "other.html")
    used = part.rename(part.with_name(durable._new_name(path).name))
    write_whole(path, "whole")
    assert {*tmp_path.iterdir()} == {path, used} and path.read_text() == "whole"
    durable.release(file)  # another thread may be starting a process, which inherits open files
    write_whole(path, "again")
    assert [*tmp_path.iterdir()] == [path]


def test_programs_that_write_a_file_at_the_same_time_do_not_fail(tmp_path):
    path = tmp_path / "page.html"
    code = (
        "from pathlib import Path; from swe_sphere.files.durable import write_whole\n"
        f"for n in range(400): write_whole(Path({str(path)!r}), f'{{n:03}}')"
    )
    writers = [subprocess.Popen([sys.executable, "-c", code]) for _ in range(4)]
    assert [writer.wait() for writer in writers] == [0] * 4
    assert path.read_text() == "399" and [*tmp_path.iterdir()] == [path]


@pytest.mark.parametrize("used", range(3))
def test_a_file_in_use_does_not_keep_others_from_being_removed(tmp_path, used):
    path = tmp_path / "page.html"
    made = [durable._create(path)[0] for _ in range(3)]
    kept = durable._marked(path)[used]  # in the order in which they are looked at
    for file in made:
        if not os.path.samestat(os.fstat(file), kept.stat()):
            durable.release(file)
    with pytest.raises(ConfigError, match="another program writes it"):
        durable._remove_unfinished(path)
    assert durable._marked(path) == [kept]


@pytest.mark.parametrize("writer", ["text", "run", "sweep"])
def test_a_lock_ends_with_its_file_although_a_forked_process_has_it_open(tmp_path, writer):
    path = tmp_path / "run.nc"
    wait, go_on = os.pipe()
    code = f"import os; os.read({wait}, 1)"
    if writer == "sweep":
        path.mkdir()
        with record_store.locked(path):
            numbers = [int(each.name) for each in Path("/proc/self/fd").iterdir()]
            (file,) = [number for number in numbers if _leads_to(number, path)]
            other = subprocess.Popen([sys.executable, "-c", code], pass_fds=[file, wait])
        with record_store.locked(path):
            pass
    else:
        file, part = claim(path)
        other = subprocess.Popen([sys.executable, "-c", code], pass_fds=[file, wait])
        if writer == "run":
            take_place(part, path)
        durable.release(file)
        durable.release(claim(path)[0])
        assert not part.exists()
    os.write(go_on, b"x")
    assert other.wait() == 0


def _leads_to(number, path):
    try:
        return os.path.samestat(os.fstat(number), path.stat())
    except OSError:
        return False


@pytest.mark.parametrize("kind", ["file", "replaced", "folder"])
def test_of_two_programs_that_build_a_file_one_is_refused(tmp_path, kind):
    """Also where a library locks the file or replaces the folder that it builds."""
    path = tmp_path / "grid.nc"
    with building(path) as part:
        part.mkdir() if kind == "folder" else part.write_text("whole")
        if kind == "replaced":
            part.unlink()
            part.write_text("whole")
        for _ in range(2):
            with pytest.raises(ConfigError, match="another program writes it"), building(path):
                pass
            with pytest.raises(ConfigError, match="another program writes it"):
                claim(path)
    assert [*tmp_path.iterdir()] == [path] and path.is_dir() == (kind == "folder")


def test_a_store_whose_replacement_was_killed_is_found_where_it_is(tmp_path, monkeypatch):
    """The new one is in the folder in which it was built."""
    path = tmp_path / "grid.zarr"
    path.mkdir()
    monkeypatch.setattr(durable, "release", os.close)
    monkeypatch.setattr(durable, "remove", lambda _: None)
    with pytest.raises(PermissionError), building(path) as part:
        part.mkdir()
        monkeypatch.setattr(type(part), "replace", _refuse_second(type(part).replace))
    (old,) = durable._marked(path, durable.OLD)
    with pytest.raises(ConfigError, match="was being replaced") as refused:
        durable.check_moved(path)
    assert f"rename {part} (the new one) or {old} to {path}" in str(refused.value)


def _refuse_second(replace):
    """Path.replace, which fails where the new folder would take its place."""

    def refusing(self, target):
        if durable.OLD not in str(target):
            raise PermissionError(13, "Permission denied")
        return replace(self, target)

    return refusing


def test_no_file_takes_the_place_of_a_folder(tmp_path):
    path = tmp_path / "a.json"
    path.mkdir()
    (path / "chapter").write_text("one")
    with pytest.raises(RunFailed, match="cannot write"):
        write_whole(path, "ours")
    with pytest.raises(OSError), building(path) as part:
        part.write_text("ours")
    assert (path / "chapter").read_text() == "one" and [*tmp_path.iterdir()] == [path]


def test_names_as_long_as_the_system_allows_are_written(tmp_path):
    path = tmp_path / ("x" * 244 + ".nc")  # eight more for the checkpoint
    small().run(days=0.25, out=path)
    assert len([*tmp_path.iterdir()]) == 2


# --- pictures and films


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    path = tmp_path_factory.mktemp("made") / "run.nc"
    small().run(days=0.25, every=3.0, out=path)
    return path


@pytest.mark.thorough
def test_a_picture_replaces_no_file_unless_it_is_told_to(made, tmp_path, capsys):
    place, film = tmp_path / "a.png", tmp_path / "a.gif"
    for each in (place, film):
        each.write_text("mine")
    with pytest.raises(ConfigError, match=r"a\.png exists: choose another name, or replace it"):
        plot_file(made, "h", out=place)
    with pytest.raises(ConfigError, match=r"a\.gif exists: choose another name, or replace it"):
        animate_file(made, "h", film)
    for command, out in (("plot", place), ("animate", film)):
        words = [command, str(made), "--field", "h", "--out", str(out)]
        with pytest.raises(SystemExit) as end:
            main(words)
        assert end.value.code == 2
        assert place.read_text() == film.read_text() == "mine"
        with pytest.raises(SystemExit) as end:
            main([*words, "--overwrite"])
        assert end.value.code == 0
        place.write_text("mine")
    assert film.read_bytes().startswith(b"GIF")
    assert capsys.readouterr().err.count("exists: choose another name") == 2


@pytest.mark.thorough
def test_the_picture_of_a_run_is_refused_before_the_run(tmp_path, capsys):
    place, out = tmp_path / "a.png", tmp_path / "run.nc"
    place.write_text("mine")
    words = ["run", "williamson2", "--ne=2", "--days=0.25", f"--plot={place}", f"--out={out}"]
    with pytest.raises(SystemExit) as end:
        main(words)
    assert end.value.code == 2 and not out.exists()
    assert "exists: choose another name, or replace it with --overwrite" in capsys.readouterr().err
    with pytest.raises(SystemExit) as end:
        main([*words, "--overwrite", "--quiet"])
    assert end.value.code == 0 and place.read_bytes().startswith(b"\x89PNG")


@pytest.mark.thorough
def test_an_unfinished_picture_leaves_the_one_before(made, tmp_path, monkeypatch):
    from matplotlib.figure import Figure

    place = tmp_path / "a.png"
    plot_file(made, "h", out=place)
    before = place.read_bytes()

    def fails(figure, file, **_):
        file.write_bytes(np.arange(100, dtype=np.uint8).tobytes())
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Figure, "savefig", fails)
    with pytest.raises(RunFailed, match="No space left"):
        plot_file(made, "h", out=place, overwrite=True)
    assert place.read_bytes() == before and [*tmp_path.iterdir()] == [place]


@pytest.mark.parametrize(
    "words",
    [
        "plot @", "plot run.nc --compare=@", "plot run.nc --out=@.png", "animate @",
        "animate run.nc --out=@.gif", "compare @ run.nc", "compare run.nc @",
        "regrid @ --grid=latlon:7x12", "regrid run.nc --grid=latlon:7x12 --out=@.nc",
        "run williamson2 --restart=@", "run williamson2 --ne=2 --days=0 --out=@.nc",
    ],
)  # fmt: skip
@pytest.mark.parametrize("name", ["a" * 300, thorough("loop"), thorough("run.nc/a")])
def test_names_that_the_system_refuses_end_in_one_line(words, name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for ending in ("", ".png", ".gif", ".nc"):
        (tmp_path / f"loop{ending}").symlink_to(f"loop{ending}")
    small().run(days=0.0625, out="run.nc", progress=False)
    with pytest.raises(SystemExit) as end:
        main(words.replace("@", name).split())
    told = capsys.readouterr().err.splitlines()
    assert end.value.code in (1, 2) and "unexpected" not in told[-1]
    assert [line.startswith("swe-sphere: ") for line in told] == [True]


def test_names_that_the_system_refuses_are_clear_errors_in_python():
    name = "a" * 300
    with pytest.raises(ConfigError, match="File name too long"):
        Simulation.from_checkpoint(name)
    with pytest.raises(RunFailed, match="File name too long"):
        small().checkpoint(name)


TINY = ("--ne=2", "--np=4", "--quiet")


@pytest.mark.parametrize(
    "command",
    [
        ("run", "williamson2", *TINY, "--days=2", "--every=1", "--out=one.nc"),
        ("run", "williamson2", *TINY, "--days=2", "--every=1", "--out=one.zarr"),
        ("sweep", "lauter", *TINY, "--days=0.25", "--steppers=rk4", "--dt=3600", "--out=one"),
    ],
)
@pytest.mark.thorough
def test_of_two_programs_at_one_place_one_is_refused_or_comes_later(tmp_path, command):
    programs = [
        subprocess.Popen(
            [sys.executable, "-m", "swe_sphere", *command], cwd=tmp_path, text=True,
            stderr=subprocess.PIPE,
        )
        for _ in range(2)
    ]  # fmt: skip
    ends = sorted((program.communicate(timeout=600)[1], program.returncode) for program in programs)
    assert ends[0] == ("", 0)
    assert ends[1] == ("", 0) or (ends[1][1] == 2 and ends[1][0].count("\n") == 1)
    if command[0] == "run":
        with xr.open_dataset(tmp_path / command[-1].removeprefix("--out=")) as found:
            assert found.sizes["time"] == 49 and np.isfinite(found["h"]).all()
            assert json.loads(found.attrs["summary"])["completed"]
    else:
        assert (xr.load_dataset(tmp_path / "one" / "sweep.nc")["status"] == "completed").all()
    assert not [*tmp_path.rglob("*.part*")]


@pytest.mark.parametrize(
    "words",
    [
        "run williamson2 --ne=2 --diagnostics=p.py", "run williamson2 --ne=2 --stepper=p.py",
        "run williamson2 --ne=2 --stepper=tr-bdf2 --preconditioner=p.py", "run p.py",
        "run p.toml", "run williamson2 --config=p.toml", "sweep --recipe=p.toml --out=s",
        "sweep p.toml --steppers=rk4 --dt=900 --out=s", "plot p.nc",
        "regrid p.nc --grid=latlon:7x12", "run williamson2 --restart=p.nc",
        "run williamson2 --ne=2 --initial=p.nc", "run williamson2 --ne=2 --out=p.nc --overwrite",
    ],
)  # fmt: skip
def test_pipes_in_the_place_of_files_do_not_block(words, tmp_path, swe, request):
    """A pipe that nobody writes to blocks a program that opens it."""
    for ending in ("py", "toml", "nc"):
        os.mkfifo(tmp_path / f"p.{ending}")

    def blocked(*_):
        raise AssertionError("the program is blocked")

    before = signal.signal(signal.SIGALRM, blocked)
    request.addfinalizer(lambda: signal.signal(signal.SIGALRM, before))
    signal.alarm(300)
    request.addfinalizer(lambda: signal.alarm(0))
    status, _, told = swe(*words.split())
    assert status == 2 and told.count("\n") == 1 and "p." in told


@pytest.mark.parametrize(
    "words", ["plot run.nc --overwrite --out", "run w.toml --days=0.1 --ne=2 --overwrite --plot"]
)
def test_a_pipe_is_not_replaced(tmp_path, monkeypatch, capsys, words):
    monkeypatch.chdir(tmp_path)
    Path("w.toml").write_text('base = "williamson2"\nname = "w"\n')
    Simulation("williamson2", ne=2, np=4, dt=1800.0).run(days=0.1, out="run.nc")
    os.mkfifo("pipe.png")
    with pytest.raises(SystemExit) as end:
        main([*words.split(), "pipe.png"])
    assert end.value.code in (1, 2) and Path("pipe.png").is_fifo()
    assert "cannot write pipe.png: it is not a file" in capsys.readouterr().err
