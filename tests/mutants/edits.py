"""Faults planted in the sources: mesh, constants of scenes, schemes, and those of the kernels."""

from __future__ import annotations

from mutants.kernel_edits import FORCED, KERNEL_EDITS, STEADY
from mutants.kinds import Edit

__all__ = ["EDITS"]

MESH = (
    Edit(
        "d alpha / d xi + 1 %",
        "swe_sphere/mesh/cubed_sphere.py",
        STEADY,
        "tangents *= 0.25 * np.pi / ne",
        "tangents *= 0.2525 * np.pi / ne",
    ),
    Edit(
        "d tan / d alpha + 1 %",
        "swe_sphere/mesh/cubed_sphere.py",
        STEADY,
        "slope = 1.0 + line",
        "slope = 1.01 + line",
    ),
    Edit(
        "equidistant angles 1 % off",
        "swe_sphere/mesh/cubed_sphere.py",
        STEADY,
        "0.5 * points / ne)",
        "0.505 * points / ne)",
    ),
    Edit(
        "quadrature weights + 1 %",
        "swe_sphere/mesh/gll.py",
        ("start-williamson2",),
        "return np.asarray(2.0 /",
        "return np.asarray(2.02 /",
    ),
    Edit(
        "GLL points 1 % off",
        "swe_sphere/mesh/gll.py",
        ("start-williamson2",),
        "return 0.5 * (points - points[::-1])",
        "return 0.5 * (points - points[::-1]) * np.where(abs(points) < 1, 1.01, 1)",
    ),
    Edit(
        "Schmidt tangent 1 % off",
        "swe_sphere/mesh/cubed_sphere.py",
        ("williamson2-stretched",),
        "2.0 * stretch * (dn",
        "2.02 * stretch * (dn",
    ),
    Edit(
        "Schmidt map 1 % off",
        "swe_sphere/mesh/cubed_sphere.py",
        ("williamson2-stretched",),
        "plus = 0.5 * stretch**2",
        "plus = 0.505 * stretch**2",
    ),
    Edit(
        "hyperviscosity scaling of 3 in place of 3.32",
        "swe_sphere/equations/effects.py",
        ("hyperviscosity-default",),
        "spacing ** (1.0 / math.log10(2.0))",
        "spacing ** 3.0",
    ),
    Edit(
        "hyperviscosity coefficient + 1 %",
        "swe_sphere/equations/effects.py",
        ("hyperviscosity-default",),
        "float(1.0e15 / 30.0 *",
        "float(1.01e15 / 30.0 *",
    ),
)

CONSTANTS = tuple(
    Edit(f"{file}: {old} for {new}", f"{folder}/{file}.py", (f"start-{scene}",), old, new)
    for folder, file, scene, old, new in (
        ("swe_sphere", "planet", "williamson2", "9.80616", "9.80716"),
        ("swe_sphere", "planet", "williamson2", "7.292e-5", "7.293e-5"),
        ("swe_sphere", "planet", "williamson2", "6.37122e6", "6.37222e6"),
        ("testcases", "flows", "williamson1", "PERIOD = 12.0 * DAY", "PERIOD = 12.01 * DAY"),
        ("testcases", "williamson", "williamson1", "500.0 * (1.0", "500.1 * (1.0"),
        ("testcases", "williamson", "williamson2", "depth = 2.94e4", "depth = 2.941e4"),
        ("testcases", "williamson", "williamson5", "5960.0", "5961.0"),
        ("testcases", "williamson", "williamson6", "float = 7.848e-6", "float = 7.849e-6"),
        ("testcases", "williamson", "williamson6", "8000.0", "8001.0"),
        ("testcases", "flows", "williamson5", "2000.0 * (1.0", "2001.0 * (1.0"),
        ("testcases", "jets", "lauter", "133681.0", "133781.0"),
        ("testcases", "jets", "lauter", "GEOPOTENTIAL = 10.0", "GEOPOTENTIAL = 10.01"),
        ("testcases", "jets", "galewsky", "float = 80.0", "float = 80.01"),
        ("testcases", "jets", "galewsky", "h: Array = 120.0", "h: Array = 120.1"),
        ("testcases", "still", "lake-at-rest", "5960.0", "5961.0"),
        ("testcases", "williamson", "williamson4", "GEOPOTENTIAL = 1e5", "GEOPOTENTIAL = 1.001e5"),
        ("testcases", "williamson", "williamson4", "-0.03 *", "-0.03003 *"),
        ("testcases", "still", "modons", "speed = 50.0", "speed = 50.01"),
    )
)

SCHEMES = (
    Edit(
        "BDF2: weight of the past 1 % off",
        "swe_sphere/steppers/dirk.py",
        ("stepper-bdf2",),
        "self.state, w**2 / (1.0",
        "self.state, 1.01 * w**2 / (1.0",
    ),
    Edit(
        "Gauss-Legendre: a node 1 % off",
        "swe_sphere/steppers/gauss.py",
        ("stepper-gauss-legendre",),
        "A = ((0.25, 0.25 - _ROOT",
        "A = ((0.2525, 0.25 - _ROOT",
    ),
    Edit(
        "semi-implicit: slope 1 % too large",
        "swe_sphere/steppers/leapfrog.py",
        ("stepper-semi-implicit",),
        "self._slope, dt, out=",
        "self._slope, 1.01 * dt, out=",
    ),
    Edit(
        "stage times of Runge-Kutta a step late",
        "swe_sphere/steppers/runge_kutta.py",
        FORCED,
        "self.time + offset",
        "self.time + self.dt",
    ),
)

EDITS = (*KERNEL_EDITS, *MESH, *CONSTANTS, *SCHEMES)
"""All of them."""
