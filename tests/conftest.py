"""Fixtures that several tests share."""

from __future__ import annotations

import gc
import os
import tempfile
from types import SimpleNamespace

import pytest
import warp as wp

from swe_sphere import compiling
from swe_sphere.cli.main import main
from swe_sphere.mesh import Mesh
from swe_sphere.pictures import plot
from swe_sphere.simulation.diagnostics import DIAGNOSTICS
from swe_sphere.solvers.preconditioners import PRECONDITIONERS
from swe_sphere.steppers import STEPPERS
from swe_sphere.studies.report import figures
from swe_sphere.studies.sweep import engine

wp.config.log_level = wp.LOG_WARNING
gc.set_threshold(20_000)  # as the command line does
compiling.PATIENCE = 1e6  # what a test finds on stderr must not depend on Warp's cache

if os.environ.pop("PYTHONDONTWRITEBYTECODE", ""):
    # or each of the many processes that tests start would compile all it imports: 0.3 to 1.4 s
    BYTE_CODE = tempfile.TemporaryDirectory(prefix="swe-sphere-byte-code.")
    os.environ["PYTHONPYCACHEPREFIX"] = BYTE_CODE.name


@pytest.fixture(scope="session", autouse=True)
def earlier_tests_stay_settled():
    """Each run of a sweep would look for garbage among all that earlier tests have left."""
    kept = SimpleNamespace(collect=gc.collect, freeze=gc.freeze, unfreeze=lambda: None)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(engine, "gc", kept)
        yield


@pytest.fixture(scope="session", autouse=True)
def coarse_pictures():
    """Half of the time of a picture is that of its dots, which no test needs."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plot, "ROWS", 61)
        patch.setattr(plot, "DOTS_PER_INCH", 60)
        yield


@pytest.fixture(autouse=True)
def own_classes_are_forgotten():
    """What one test registers must not be found by another on the same worker."""
    registries = STEPPERS, PRECONDITIONERS
    before, diagnostics = [dict(each.data) for each in registries], dict(DIAGNOSTICS)
    yield
    for registry, data in zip(registries, before, strict=True):
        registry.data = data
    DIAGNOSTICS.clear()
    DIAGNOSTICS.update(diagnostics)


@pytest.fixture
def blank_figures(monkeypatch):
    """Pages of sweeps have figures in which nothing is drawn: for tests of their words."""
    monkeypatch.setattr(figures, "svg_text", lambda *_: "<svg/>")


@pytest.fixture(scope="session")
def small_mesh() -> Mesh:
    """Stretched and turned, so that no symmetry hides a mistake: 24 elements of np 4."""
    return Mesh.build(2, 4, stretch=1.5, centre=(40.0, 23.0), spin=17.0)


@pytest.fixture
def swe(capfd, tmp_path, monkeypatch):
    """Return a function that runs the program in an empty folder: status, stdout, stderr."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments):
        with pytest.raises(SystemExit) as end:
            main([str(argument) for argument in arguments])
        out, err = capfd.readouterr()
        return end.value.code, out, err

    return call
