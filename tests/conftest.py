"""Fixtures that several tests share."""

from __future__ import annotations

import os
import tempfile

import pytest
import warp as wp

from swe_sphere import compiling
from swe_sphere.mesh import Mesh

wp.config.log_level = wp.LOG_WARNING
compiling.PATIENCE = 1e6  # what a test finds on stderr must not depend on Warp's cache

if os.environ.pop("PYTHONDONTWRITEBYTECODE", ""):
    # or each of the many processes that tests start would compile all it imports: 0.3 to 1.4 s
    BYTE_CODE = tempfile.TemporaryDirectory(prefix="swe-sphere-byte-code.")
    os.environ["PYTHONPYCACHEPREFIX"] = BYTE_CODE.name


@pytest.fixture(scope="session")
def small_mesh() -> Mesh:
    """Stretched and turned, so that no symmetry hides a mistake: 24 elements of np 4."""
    return Mesh.build(2, 4, stretch=1.5, centre=(40.0, 23.0), spin=17.0)
