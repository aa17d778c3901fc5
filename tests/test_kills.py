"""A process killed at any moment leaves whole files: every frame that was finished can be read."""

import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

HERE = Path(__file__).parent


@pytest.fixture(scope="module")
def shim(tmp_path_factory):
    """The library that kills a process at a call of our choice."""
    compiler = shutil.which("cc")
    if compiler is None or not sys.platform.startswith("linux"):
        pytest.skip("there is no C compiler, or it is not that of Linux")
    library = tmp_path_factory.mktemp("shim") / "kills.so"
    command = [compiler, "-shared", "-fPIC", "-O1", "-o", library, HERE / "kills.c", "-ldl"]
    subprocess.run(command, check=True)
    return library


@pytest.fixture
def quick_folder(tmp_path):
    """In memory where there is such a place: what is tested has nothing to do with disks."""
    memory = Path("/dev/shm")
    if not os.access(memory, os.W_OK):
        yield tmp_path
        return
    with tempfile.TemporaryDirectory(dir=memory) as folder:
        yield Path(folder)


def test_a_kill_at_any_call_leaves_whole_files(shim, quick_folder):
    """Before each write, truncation, sync, rename and removal in turn, and amid each write."""
    found = json.loads(
        subprocess.check_output(
            [sys.executable, HERE / "kills.py", quick_folder],
            text=True, env=os.environ | {"LD_PRELOAD": str(shim)}, timeout=300,
        )
    )  # fmt: skip
    assert found["positions"] > 400
    assert found["runs_to_the_end"] == 2
    assert 0 < found["no_file_yet"] < found["positions"]
    assert found["unreadable"] == found["frames_lost"] == found["checkpoints_lost"] == 0
