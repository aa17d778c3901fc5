"""The scenes as they begin: what their constants integrate to.

Where both the exact solution and the start of a run come from the same constant, no error tells
that it is wrong; these numbers do.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from swe_sphere.studies.verify.case import Case, Rung, Setting

__all__ = ["CASES"]

NAMES = ("mean_depth", "energy", "enstrophy", "max_wind", "rms_coriolis", "mean_bottom")


def _start(scene: str, parameters: Mapping[str, float | bool], *values: float) -> Case:
    """The start of a scene on ne 6, np 6: the numbers called `NAMES`; zero where not asked for."""
    asked = {name: value for name, value in zip(NAMES, values, strict=True) if value}
    setting = Setting(scene, parameters, np=6, days=0.0, dt=1.0)
    rung = Rung(6, values=asked, limits={"area": 1e-10}, quick=True)
    words = [f"{name}={value:.4g}" for name, value in parameters.items()]
    return Case("-".join(["start", scene, *words]), "", setting, (rung,), tolerance=1e-9)


CASES = (
    _start("williamson1", {}, 8.2284883733, 29463.8417997, 0.0, 38.610682767, 0.0, 0.0),
    _start(
        "williamson1",
        {"gaussian": True},
        49.999999897,
        156492.354676,
        1.6036216403e-07,
        38.610682767,
        0.0,
        0.0,
    ),
    _start(
        "williamson2",
        {},
        2363.02130836,
        30260755.1187,
        2.41197883073e-12,
        38.610682767,
        8.42007632586e-05,
        0.0,
    ),
    _start(
        "williamson5",
        {},
        5619.9422619,
        156907479.392,
        7.20447263216e-13,
        20,
        8.42007632586e-05,
        17.4106384505,
    ),
    _start(
        "williamson6",
        {},
        9522.9965564,
        462552387.765,
        5.53651753484e-13,
        100.00266912,
        8.42007632586e-05,
        0.0,
    ),
    _start(
        "galewsky", {}, 10000.333097, 492470218.865, 4.11904870661e-13, 80, 8.42007632586e-05, 0.0
    ),
    _start(
        "lauter",
        {},
        9506.33101296,
        738740888.076,
        9.21422276767e-13,
        38.610682767,
        8.42007632586e-05,
        3669.51786182,
    ),
    _start(
        "lake-at-rest",
        {},
        5942.58936155,
        174079503.853,
        5.96359777844e-13,
        0.0,
        8.42007632586e-05,
        17.4106384505,
    ),
    _start(
        "lake-at-rest",
        {"cone": False},
        5944.76911188,
        174090567.945,
        5.96186875298e-13,
        0.0,
        8.42007632586e-05,
        15.2308881244,
    ),
    _start(
        "williamson3",
        {},
        2791.86264607,
        39057394.7544,
        1.47544592407e-12,
        38.610682767,
        8.42007632586e-05,
        0.0,
    ),
    _start(
        "williamson3",
        {"alpha": math.pi / 3},
        2791.86264602,
        39057394.7449,
        1.47544592076e-12,
        38.610682767,
        8.42007632586e-05,
        0.0,
    ),
    _start(
        "williamson4",
        {},
        10514.5947643,
        542599288.732,
        3.53615692693e-13,
        39.9984807731,
        8.42007632586e-05,
        0.0,
    ),
    _start(
        "mcdonald-bates",
        {},
        5882.01701787,
        170320213.722,
        6.121126921e-13,
        20,
        8.42007632586e-05,
        0.0,
    ),
    _start("modons", {}, 5000, 122598600.906, 1.54705450777e-15, 50, 0.0, 0.0),
    _start("splash", {}, 2008.22848837, 19797108.2833, 0.0, 0.0, 0.0, 0.0),
    _start(
        "gravity-bumps",
        {},
        10028.3963633,
        493162719.898,
        3.52622840897e-13,
        0.0,
        8.42007632586e-05,
        0.0,
    ),
    _start("dam-break", {}, 1030.62054964, 5332356.24399, 0.0, 0.0, 0.0, 0.0),
    _start(
        "turbulence",
        {},
        10000.0000105,
        492366998.558,
        4.2120288806e-13,
        50.5284094721,
        8.42007632586e-05,
        0.0,
    ),
    _start(
        "williamson7",
        {},
        10000.0000194,
        492496241.681,
        4.07276092836e-13,
        53.5716906498,
        8.42007632586e-05,
        0.0,
    ),
    _start("moving-vortices", {}, 1000, 5921778.06806, 3.35009776294e-14, 50.3688574412, 0.0, 0.0),
    _start("deformational", {}, 1000, 6406995.49389, 1.73327327004e-13, 90.1112428855, 0.0, 0.0),
    _start(
        "matsuno", {}, 30, 4412.772, 1.18166697988e-10, 1.7097054319e-05, 8.42021488993e-05, 0.0
    ),
)
