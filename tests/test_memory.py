"""What a run takes of memory, and the guard that tells it beforehand."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from swe_sphere.equations.model import Model
from swe_sphere.errors import ConfigError
from swe_sphere.simulation import build
from swe_sphere.simulation.build import MEMORY, check_memory, make_scene, needed_memory
from swe_sphere.simulation.config import make_config
from swe_sphere.solvers.gravity_waves import GravityWaves
from swe_sphere.solvers.preconditioners import PRECONDITIONERS
from swe_sphere.solvers.vector_space import VectorSpace
from swe_sphere.testcases import get_scene

MEASURE = """
import ctypes, gc, json, re, sys
from pathlib import Path
from swe_sphere.simulation.simulation import run_scene
from swe_sphere.simulation.config import make_config

def peak():
    return 1024.0 * float(re.search(r"VmHWM:\\s+(\\d+)", Path("/proc/self/status").read_text())[1])

given = json.loads(sys.argv[1])
run_scene(make_config(given | {"ne": 2}))
gc.collect()
try:
    ctypes.CDLL(None).malloc_trim(0)
    Path("/proc/self/clear_refs").write_text("5")  # resets the peak: proc(5), Linux 4.0
except (OSError, AttributeError):
    sys.exit(3)
before = peak()
run_scene(make_config(given))
print(peak() - before)
"""


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    ("stepper", "ne", "np_"),
    [("rk4", 30, 4), ("semi-implicit", 30, 4), ("tr-bdf2", 30, 4), ("rk4", 16, 8),
     ("semi-implicit", 16, 8), ("tr-bdf2", 16, 6)],
)  # fmt: skip
def test_estimate_is_what_a_run_takes(stepper: str, ne: int, np_: int) -> None:
    """A run takes at most the bytes an element node of docs/results/performance.md."""
    given = {"scene": "williamson5", "stepper": stepper, "ne": ne, "np": np_, "days": 0.01}
    command = [sys.executable, "-c", MEASURE, json.dumps(given)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode == 3:
        pytest.skip("this system does not tell the peak of a run")
    measured, config = float(done.stdout), make_config(given)
    estimate = needed_memory(config, make_scene(config), ne, np_) - MEMORY["program"]
    assert 0.9 * measured < estimate < 1.4 * measured
    assert measured < (900.0 if stepper == "rk4" else 2800.0) * 6 * (ne * np_) ** 2


LONG = """
import sys
from pathlib import Path
from swe_sphere import Simulation, every

resident, out = [], Path(sys.argv[2])
sim = Simulation("williamson5", ne=2, np=4, dt=20.0, stepper=sys.argv[1])


@every(steps=10_000)
def note(sim):
    resident.append(4096 * int(Path("/proc/self/statm").read_text().split()[1]))


ended = sim.run(days=1e5 * 20.0 / 86400.0, every=6.0, out=out, callbacks=[note], progress=False)
print(ended.status, sim.steps, *resident)
"""


@pytest.mark.exhaustive
@pytest.mark.parametrize("stepper", ["rk4", "leapfrog"])
def test_memory_does_not_grow_in_a_hundred_thousand_steps(stepper: str, tmp_path: Path) -> None:
    """Frames, samples, checkpoints and callbacks included."""
    command = [sys.executable, "-c", LONG, stepper, str(tmp_path / "run.nc")]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    status, steps, *resident = done.stdout.split()
    assert (status, steps, len(resident)) == ("completed", "100000", 10)
    assert int(resident[-1]) - int(resident[1]) < 2**20


def test_run_that_does_not_fit_is_refused_with_both_numbers(monkeypatch) -> None:
    monkeypatch.setattr(build, "available_memory", lambda: 2.0 * 2**30)
    config = make_config({"scene": "williamson5", "stepper": "fully-implicit"})
    scene = make_scene(config)
    check_memory(config, scene, 30, 4)
    with pytest.raises(ConfigError, match=r"about 2\.\d+ GiB of memory, and 2 GiB are free"):
        check_memory(config, scene, 120, 4)


@pytest.mark.parametrize("name", ["helmholtz-direct", "jacobian-direct"])
def test_factors_of_a_preconditioner_count(name: str, monkeypatch) -> None:
    given = {"scene": "williamson5", "stepper": "tr-bdf2"}
    plain, scene = make_config(given), get_scene("williamson5")
    for more in ({"preconditioner": name}, {"settings": [f"stepper.preconditioner={name}"]}):
        config = make_config(given | more)
        added = needed_memory(config, scene, 30, 4) - needed_memory(plain, scene, 30, 4)
        factors = PRECONDITIONERS[name].memory_of_factors(6 * 90**2 + 2, 4)
        assert added == pytest.approx(factors) and factors > 3e7
        monkeypatch.setattr(build, "available_memory", lambda: 2.0**20)
        with pytest.raises(ConfigError, match="take a smaller ne, or the preconditioner helmholtz"):
            check_memory(config, scene, 30, 4)


def test_the_table_goes_on_beyond_its_end() -> None:
    config, scene = make_config({"scene": "williamson5"}), get_scene("williamson5")
    node = {
        n: (needed_memory(config, scene, 8, n) - MEMORY["program"]) / n**2 for n in (8, 12, 14, 16)
    }
    assert node[16] - node[12] == pytest.approx(node[12] - node[8])
    assert node[14] - node[12] == pytest.approx(0.5 * (node[12] - node[8]))


def test_room_for_a_basis_takes_memory_only_row_by_row() -> None:
    space = VectorSpace(np.ones(1_000_000))
    before = resident()
    rows = space.empty_stack(50)
    assert resident() - before < 20e6
    rows[0].zero_()
    assert rows.shape == (50, space.n)


def resident() -> float:
    try:
        lines = Path("/proc/self/status").read_text().splitlines()
        return next(1024.0 * float(ln.split()[1]) for ln in lines if ln.startswith("VmRSS"))
    except OSError:
        pytest.skip("this system does not tell the memory in use")


def test_spectrum_keeps_no_vectors_alive(small_mesh) -> None:
    model = Model(small_mesh, get_scene("williamson5"))
    model.spectral_radii(model.initial_state())
    assert not model.launch._commands


def test_elimination_uses_the_arrays_of_the_model(small_mesh) -> None:
    model = Model(small_mesh, get_scene("williamson5"))
    assert GravityWaves(model).operator.mesh is model.device_mesh
