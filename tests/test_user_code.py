"""No failure of user-defined code decides the exit status or ends a run without a line."""

from __future__ import annotations

import threading

import pytest

from swe_sphere import Simulation
from swe_sphere.cli.main import main
from swe_sphere.errors import ConfigError
from swe_sphere.io.runfile import RunFile

HEAD = """import sys
from swe_sphere import Stepper


class Custom(Stepper):
    name = "custom-{name}"
    order = 1

    def advance(self):
        pass

    @classmethod
    def amplification(cls, z_wave, z_dissipation):
        return abs(z_wave) * 0.0 + 1.0

"""
METHODS = {
    "init": "    def __init__(self, *arguments):\n        {fault}\n",
    "start": "    def start(self, state, t=0.0):\n        {fault}\n",
    "advance": "    def advance(self):\n        {fault}\n",
    "swap": "    def swap(self):\n        {fault}\n",
    "state_dict": "    def state_dict(self):\n        {fault}\n",
    "amplification": "    @classmethod\n    def amplification(cls, *z):\n        {fault}\n",
    "stable_dt": "    @classmethod\n    def stable_dt(cls, radii):\n        {fault}\n",
    "spectral_radii": (
        "    @classmethod\n    def spectral_radii(cls, model, state, t=0.0):\n        {fault}\n"
    ),
    "complete": "    @classmethod\n    def complete(cls):\n        {fault}\n",
}
FAULTS = ["sys.exit(0)", "raise GeneratorExit", "raise SystemExit", "raise LookupError('lost')"]


def run(arguments, capfd):
    with pytest.raises(SystemExit) as end:
        main([*map(str, arguments)])
    out, err = capfd.readouterr()
    return end.value.code, out, err


def test_a_single_step_that_fails_names_the_line(tmp_path):
    file = tmp_path / "custom.py"
    body = METHODS["advance"].format(fault="raise LookupError('lost')")
    file.write_text(HEAD.format(name="single") + body)
    sim = Simulation("williamson2", ne=2, np=4, dt=864.0, stepper=file)
    with pytest.raises(ConfigError, match=r"custom.py fails: LookupError: lost \(custom.py, line"):
        sim.step()


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("method", METHODS)
def test_no_method_of_a_stepper_ends_the_program(method, fault, tmp_path, capfd):
    name = f"{method}-{FAULTS.index(fault)}".replace("_", "-")
    file, out = tmp_path / "custom.py", tmp_path / "run.nc"
    file.write_text(HEAD.format(name=name) + METHODS[method].format(fault=fault))
    asked = ("run", "williamson2", "--ne", 2, "--days", 0.05, "--stepper", file, "--out", out)
    status, _, err = run((*asked, "--dt", 864, "--quiet"), capfd)
    assert status in (1, 2)
    (line,) = err.splitlines()
    assert line.startswith("swe-sphere: ") and "(custom.py, line " in line
    if out.exists():
        assert RunFile(out).attributes["completed"] is False


@pytest.mark.parametrize("value", ["0", "-5.0", "float('nan')", "None", "'long'", "[1.0]"])
def test_a_stability_limit_that_is_none_is_one_line(value, tmp_path, capfd):
    file = tmp_path / "custom.py"
    limit = METHODS["stable_dt"].format(fault=f"return {value}")
    file.write_text(HEAD.format(name=f"limit-{abs(hash(value))}") + limit)
    asked = ("run", "williamson2", "--ne", 2, "--days", 0.05, "--stepper", file, "--quiet")
    status, _, err = run(asked, capfd)
    (line,) = err.splitlines()
    assert status == 2 and ("stability limit of custom" in line or "must be a number" in line)


def test_simulations_in_threads_work_one_after_the_other():
    """Threads obtain the results of single runs, whatever they record."""
    kinds = ("rk4", "tr-bdf2", "rk4", "semi-implicit")
    found: dict[int, object] = {}

    def simulate(number):
        sim = Simulation("williamson5", ne=2, np=4, stepper=kinds[number], dt=1800.0)
        summary = sim.run(days=0.1)
        found[number] = summary.status, summary["energy"], float(sim.state.h.sum())

    threads = [threading.Thread(target=simulate, args=(i,)) for i in range(len(kinds))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    together = dict(found)
    for number in range(len(kinds)):
        simulate(number)
    assert together == found and all(status == "completed" for status, *_ in found.values())
