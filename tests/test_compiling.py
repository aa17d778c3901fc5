"""Who is told of compiling, and when."""

import mmap
import os
import pty
import subprocess
import sys
import time
import weakref
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
import warp as wp

from swe_sphere import compiling
from swe_sphere.cli.main import main
from swe_sphere.compiling import COMPILING
from swe_sphere.equations.model import Model
from swe_sphere.kernels import specialise
from swe_sphere.kernels.vectors import ADDERS
from swe_sphere.mesh import Mesh
from swe_sphere.operators.huge_pages import CHUNK, PAGE, ChunkAllocator, new_memory
from swe_sphere.operators.launch import TEMPLATES, Launcher, keep_headers, warp_internals
from swe_sphere.steppers import STEPPERS
from swe_sphere.testcases import get_scene


@pytest.fixture
def told(monkeypatch):
    """The calls made, where one is patient for a twentieth of a second."""
    monkeypatch.setattr(compiling, "PATIENCE", 0.05)
    return []


@pytest.mark.parametrize("name", ["tr-bdf2", "semi-implicit", "epi3", "rk4"])
def test_all_compiling_of_a_stepper_is_counted_by_its_model(monkeypatch, name):
    """Times of runs exclude it, and so must not contain any of it."""
    model = Model(Mesh.build(2, 4), get_scene("williamson5"))
    by, load = [], Launcher.load
    monkeypatch.setattr(Launcher, "load", lambda self, *of: (by.append(self), load(self, *of)))
    stepper = STEPPERS[name](model, 300.0)
    stepper.start(model.initial_state())
    stepper.step()
    assert by and {*by} == {model.launch}


def wait(seconds):
    with compiling.mark_compiling():
        time.sleep(seconds)


def test_long_compilations_are_told_of_once(told):
    with compiling.on_compile(lambda: told.append("once")):
        wait(0.5)
        wait(0.5)
    assert told == ["once"]
    wait(0.5)  # nobody listens any more
    assert told == ["once"]


def test_many_short_ones_count_together(told):
    with compiling.on_compile(lambda: told.append("once")):
        for _ in range(20):
            wait(0.01)
    assert told == ["once"]


def test_nothing_is_said_without_compiling(told):
    with compiling.on_compile(lambda: told.append("once")):
        time.sleep(0.2)
    assert told == []


def test_every_command_tells_of_it(told, monkeypatch, capsys):
    """In one line on stderr."""
    monkeypatch.setattr("swe_sphere.cli.main.program", lambda _: lambda *_, **__: wait(0.2))
    with pytest.raises(SystemExit):
        main(["verify"])
    assert capsys.readouterr().err == f"swe-sphere: {COMPILING}\n"


LONG = """
import time
from swe_sphere import compiling
compiling.PATIENCE = 0.05
for _ in range(2):
    with compiling.mark_compiling():
        time.sleep(0.5)
"""


def test_a_python_program_in_a_terminal_tells_of_it_once():
    """And one whose stderr goes elsewhere says nothing."""
    master, terminal = pty.openpty()
    subprocess.run([sys.executable, "-c", LONG], stderr=terminal, check=True)
    os.close(terminal)
    assert os.read(master, 1000).decode() == f"swe-sphere: {COMPILING}\r\n"
    os.close(master)
    made = subprocess.run([sys.executable, "-c", LONG], capture_output=True, check=True)
    assert made.stderr == b""


def test_the_installed_warp_has_the_private_methods_that_are_used():
    """If this fails, adapt `warp_internals` and its callers to the new Warp."""
    assert warp_internals() is not None


def other_headers(self, thread):
    return None


def other_name(self, device):
    return "object"


@pytest.mark.parametrize(
    ("owner", "name", "method"),
    [
        ("Runtime", "get_clang_pch_dir", None),
        ("Runtime", "get_clang_pch_dir", other_headers),
        ("Module", "_get_compile_output_name", None),
        ("llvm", "wp_get_host_cpu_features", None),
        ("Module", "_get_compile_output_name", other_name),
    ],
)
def test_another_warp_is_left_as_it_is(monkeypatch, tmp_path, owner, name, method):
    """Kernels are loaded and launched all the same."""
    from warp._src import context

    wp.init()
    with monkeypatch.context() as patched:
        kept = context.runtime.__dict__.get("get_clang_pch_dir")
        if owner == "llvm":
            patched.setattr(context.runtime, owner, SimpleNamespace())
        elif method is None:
            patched.delattr(getattr(context, owner), name)
        else:
            patched.setattr(getattr(context, owner), name, method)
        assert warp_internals() is None
        patched.setattr(wp.config, "kernel_cache_dir", str(tmp_path))
        keep_headers()
        assert not [*tmp_path.iterdir()]
        assert context.runtime.__dict__.get("get_clang_pch_dir") is kept
        kernel = specialise(ADDERS[1], wp.float64)
        assert not Launcher("cpu")._cached(kernel.module).exists()
        (tmp_path / kernel.module.get_module_identifier(1)).mkdir()
        assert Launcher("cpu")._cached(kernel.module).exists()


def test_each_installation_has_its_own_compiled_headers(tmp_path, monkeypatch):
    """Those of another one, of the same version, would be found by their paths and do not fit."""
    from warp._src import context

    wp.init()
    monkeypatch.setattr(context.runtime, "get_clang_pch_dir", None, raising=False)
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path))
    for place in ("one", "one", "other"):
        monkeypatch.setattr(wp, "__file__", f"/{place}/warp/__init__.py")
        keep_headers()
    assert len([*tmp_path.glob("headers_*")]) == 2


@pytest.mark.parametrize("flags", ["-march=native -fno-vectorize", None])
def test_templates_of_headers_are_instantiated_once(monkeypatch, flags):
    """Asked for once, beside the flags that somebody has set, and never in the place of Warp's."""
    monkeypatch.setattr(wp.config, "cpu_compiler_flags", flags)
    for _ in range(2):
        keep_headers()
    assert wp.config.cpu_compiler_flags == (flags and f"{flags} {TEMPLATES}")


@pytest.mark.thorough
def test_what_was_compiled_for_another_processor_is_compiled_anew_and_told_of(tmp_path):
    """Warp keeps the objects of all processors in one folder."""
    script = (
        "import sys, warp as wp; from pathlib import Path; from swe_sphere import Simulation;"
        "from swe_sphere.operators import launch; blocks, real = [], launch.mark_compiling;"
        "launch.mark_compiling = lambda: blocks.append(1) or real();"
        "Simulation('williamson2', ne=1, np=3, dt=600).step(); print(len(blocks))"
    )
    environment = os.environ | {"WARP_CACHE_PATH": str(tmp_path)}

    def told():
        command = [sys.executable, "-c", script]
        return int(subprocess.check_output(command, text=True, env=environment).splitlines()[-1])

    first = told()
    assert first > 0 and told() == 0
    assert [*tmp_path.rglob("headers_*/*.pch")]  # Warp has taken the folder
    for made in tmp_path.rglob("*.o"):
        made.rename(made.with_name(f"other_{made.name}"))
    assert told() == first


def test_arrays_of_the_cpu_lie_in_huge_pages() -> None:
    """If this fails, adapt `use_huge_pages` to Warp: its arrays lie in small pages again."""
    Launcher("cpu")
    allocator = wp.get_device("cpu").default_allocator
    assert isinstance(allocator, ChunkAllocator)
    arrays = [wp.zeros(n, dtype=wp.uint8, device="cpu") for n in (1, 100, 5 << 20, 40 << 20)]
    addresses = [each.ptr for each in arrays]
    assert all(address % 64 == 0 and address in allocator._chunks for address in addresses)
    assert addresses[1] == addresses[0] + 64 and addresses[3] % PAGE == 0
    for each in arrays:
        each.fill_(7)
    assert all((each.numpy() == 7).all() for each in arrays)
    chunk = weakref.ref(allocator._chunks[addresses[3]])
    del each, arrays
    assert not allocator._chunks.keys() & set(addresses) and chunk() is None


@pytest.mark.skipif(not hasattr(mmap, "MADV_HUGEPAGE"), reason="on Linux alone")
def test_chunks_are_memory_that_was_not_used_before() -> None:
    """Used memory may be that of small pages, which stay small."""
    for _ in range(3):
        used = np.full(CHUNK + PAGE, 7, np.uint8)
        del used
        memory = new_memory(CHUNK + PAGE)
        assert memory.ctypes.data % mmap.PAGESIZE == 0 and not memory.any()
    with pytest.raises(MemoryError):
        new_memory(1 << 60)


def test_many_threads_get_memory_of_their_own() -> None:
    """Arrays that several threads allocate at the same time do not overlap."""
    allocator = ChunkAllocator()
    sizes = np.random.default_rng(1).integers(1, 300_000, 4000).tolist()
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    with ThreadPoolExecutor(8) as pool:
        begins = list(pool.map(allocator.allocate, sizes))
    sys.setswitchinterval(interval)
    ordered = sorted(zip(begins, sizes, strict=True))
    assert all(a + n <= b for (a, n), (b, _) in pairwise(ordered))
    assert len(set(begins)) == len(sizes)
