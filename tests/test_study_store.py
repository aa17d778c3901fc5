"""Records of studies: whole files, read as they were written, and one writer at a time."""

import errno
import math
import os
import subprocess
import sys
from pathlib import Path

import pytest

from swe_sphere.errors import ConfigError, RunFailed
from swe_sphere.studies.record_store import Record, Store, locked, read_record


class Number(Record):
    seconds: float | None
    of: dict[str, int] | None = None


def seconds(folder):
    return [record.seconds for record in Store(folder, Number).records]


def test_records_come_back_in_their_order_and_as_they_were(tmp_path):
    store = Store(tmp_path / "runs", Number)
    for n in range(12):
        store.add(Number(seconds=0.1 * n, of={"k": n}))
    assert Store(tmp_path / "runs", Number).records == store.records
    assert [record.of["k"] for record in store.records] == [*range(12)]


def test_what_json_lacks_is_none_at_once_and_later(tmp_path):
    assert Store(tmp_path, Number).add(Number(seconds=math.nan)).seconds is None
    assert Store(tmp_path, Number).add(Number(seconds=math.inf)).seconds is None
    assert seconds(tmp_path) == [None, None]


def test_numbers_go_on_after_records_that_were_deleted(tmp_path):
    store = Store(tmp_path, Number)
    for n in range(3):
        store.add(Number(seconds=n))
    sorted(tmp_path.iterdir())[1].unlink()
    Store(tmp_path, Number).add(Number(seconds=3))
    assert seconds(tmp_path) == [0, 2, 3]


def test_a_piece_that_a_kill_left_behind_is_no_record(tmp_path):
    Store(tmp_path, Number).add(Number(seconds=1))
    (tmp_path / ".000002.json.17.part").write_text('{"seco')
    assert seconds(tmp_path) == [1]


@pytest.mark.parametrize("name", ["000001 copy.json", "000001-a.json", "1.old.json", "notes.json"])
def test_a_file_of_another_name_is_no_record_and_stays(tmp_path, name):
    store = Store(tmp_path, Number)
    store.add(Number(seconds=1))
    Store(tmp_path, Number, "-17").add(Number(seconds=2))
    (tmp_path / name).write_text('{"seconds": 3}')
    assert seconds(tmp_path) == [1, 2]
    with store.unfinished():
        pass
    assert [path.name for path in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("3", "must be an object"),
        ("{oops", "Invalid JSON"),
        ("", "Invalid JSON"),
        ("{}", "seconds: Field required"),
        ('{"seconds": "1"}', "seconds: must be a valid number"),
        ('{"seconds": 1, "of": {"k": 1.5}}', "of.k: must be a valid integer"),
    ],
)
def test_what_is_no_record_is_named_in_one_line(tmp_path, text, complaint):
    path = tmp_path / "000001.json"
    path.write_text(text)
    for read in (lambda: Store(tmp_path, Number), lambda: read_record(path, Number)):
        with pytest.raises(ConfigError, match=r"000001\.json is not a record") as error:
            read()
        assert complaint in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize(("owner", "call"), [(Path, "write_bytes"), (os, "fsync"), (os, "replace")])
def test_a_record_that_the_disk_refuses_leaves_nothing(tmp_path, monkeypatch, owner, call):
    store = Store(tmp_path, Number)
    store.add(Number(seconds=1))

    def refuse(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as full:
        full.setattr(owner, call, refuse)
        with pytest.raises(
            RunFailed, match=r"cannot write .*No space left on device; correct this"
        ):
            store.add(Number(seconds=2))
    assert len(store.records) == 1 and len([*tmp_path.iterdir()]) == 1
    store.add(Number(seconds=3))
    assert seconds(tmp_path) == [1, 3]


HOLD = """
import sys, time
from pathlib import Path
from swe_sphere.studies.record_store import locked
with locked(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(60)
"""


def test_a_folder_is_held_until_its_process_dies(tmp_path):
    command = (sys.executable, "-c", HOLD, tmp_path / "d")
    with subprocess.Popen(command, stdout=subprocess.PIPE) as first:
        assert first.stdout.readline() == b"held\n"
        with pytest.raises(ConfigError, match="another process is using"), locked(tmp_path / "d"):
            pass
        first.kill()
    with locked(tmp_path / "d"):
        pass
    assert [*(tmp_path / "d").iterdir()] == []


def test_a_folder_that_cannot_be_made_is_told(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match=r"out: .*file cannot be created"):
        locked(tmp_path / "file").__enter__()
