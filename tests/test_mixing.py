"""Diagnostics of numerical mixing on values for which the answer is plain."""

from __future__ import annotations

import numpy as np
import pytest
from mixing import BELLS, filaments, mixing
from scipy.optimize import minimize_scalar


def test_filaments_of_what_only_moved_are_all_there():
    random = np.random.default_rng(2)
    q, thresholds = random.uniform(0.1, 1.0, 500), np.linspace(0.1, 0.9, 9)
    area = np.full(500, 2.0)
    assert filaments(area, q, random.permutation(q), thresholds) == pytest.approx(100.0)


def test_filaments_count_area_above_a_threshold():
    area, start = np.array([1.0, 3.0, 2.0]), np.array([0.9, 0.5, 0.1])
    now = np.array([0.5, 0.9, 0.1])
    assert filaments(area, start, now, np.array([0.1, 0.6, 0.95])) == pytest.approx([100, 300, 0])


def means(q, other):
    return mixing(np.ones(np.size(q)), np.asarray(q, float), np.asarray(other, float))


def test_pairs_on_the_curve_are_not_mixed():
    q = np.linspace(0.1, 1.0, 301)
    assert sum(means(q, BELLS(q)).values()) < 1e-12


def test_the_mean_of_two_pairs_is_real_mixing():
    ends = np.array([0.1, 1.0])
    q, other = ends.mean(), BELLS(ends).mean()
    found = means([q], [other])
    assert found["unmixing"] == found["overshooting"] == 0.0
    width, height = 0.9, 0.792
    nearest = minimize_scalar(
        lambda x: ((x - q) / width) ** 2 + ((-0.8 * x**2 + 0.9 - other) / height) ** 2,
        bounds=(0.1, 1.0),
        method="bounded",
        options={"xatol": 1e-10},
    )
    assert found["real_mixing"] == pytest.approx(np.sqrt(nearest.fun), rel=1e-9)


def test_pairs_are_told_apart_and_weighted():
    pairs = {"unmixing": (0.2, 0.15), "overshooting": (1.05, 0.1)}
    for kind, (q, other) in pairs.items():
        found = mixing(np.array([3.0, 1.0]), np.array([0.5, q]), np.array([0.7, other]))
        assert [name for name, value in found.items() if value > 1e-9] == [kind]
    found = mixing(np.array([3.0, 1.0]), np.array([0.5, 1.09]), np.array([0.7, 0.1]))
    assert found["overshooting"] == pytest.approx(0.25 * 0.1, rel=1e-9)
