"""The scenes: one short function each, of data and formulas.

`get_scene` finds one by name, or in a file of the user: a .py file that defines
`scene(**parameters)`, or a .toml file that changes another scene.
"""

from pathlib import Path

from swe_sphere.equations.scene import Parameter, Scene
from swe_sphere.errors import unknown_name
from swe_sphere.testcases.galewsky import galewsky
from swe_sphere.testcases.lake import lake_at_rest
from swe_sphere.testcases.lauter import lauter
from swe_sphere.testcases.matsuno import matsuno
from swe_sphere.testcases.mcdonald_bates import mcdonald_bates
from swe_sphere.testcases.modons import modons
from swe_sphere.testcases.random_flow import turbulence
from swe_sphere.testcases.relaxed_jet import relaxed_jet
from swe_sphere.testcases.splash import dam_break, gravity_bumps, splash
from swe_sphere.testcases.tide import slow_ocean, tide
from swe_sphere.testcases.transport import deformational, moving_vortices
from swe_sphere.testcases.user_scenes import SceneFactory, made
from swe_sphere.testcases.williamson import (
    williamson1,
    williamson2,
    williamson3,
    williamson5,
    williamson6,
)  # fmt: skip
from swe_sphere.testcases.williamson4 import williamson4
from swe_sphere.testcases.williamson7 import williamson7

__all__ = ["SCENES", "get_scene", "list_scenes"]

_FACTORIES: tuple[SceneFactory, ...] = (
    williamson1, williamson2, williamson3, williamson4, williamson5, williamson6, williamson7,
    galewsky, lauter, moving_vortices, deformational, lake_at_rest, mcdonald_bates, modons, matsuno,
    turbulence, splash, gravity_bumps, dam_break, tide, slow_ocean, relaxed_jet,
)  # fmt: skip

SCENES = {factory.__name__.replace("_", "-"): factory for factory in _FACTORIES}
"""Factories by name; their keyword parameters are the parameters of the scene."""


def get_scene(name: str, **parameters: Parameter) -> Scene:
    """The scene of that name, or of the file of that path, with the parameters given.

    Args:
        name: a key of `SCENES`, the path of a .py file that defines `scene(**parameters)`, or
            that of a .toml file (see `swe_sphere.testcases.user_scenes`).
        parameters: numbers, switches and words, or text that can be read as such.

    Raises:
        ConfigError: unknown name or parameter, a value that cannot be read, a file that fails.
    """
    if name.endswith((".py", ".toml")):
        from swe_sphere.testcases.user_scenes import load  # few runs need it

        return load(Path(name), parameters, get_scene)
    if name not in SCENES:
        raise unknown_name("scene", name, SCENES)
    return made(name, SCENES[name], parameters)


def list_scenes() -> dict[str, str]:
    """What each scene is, in a line, by name.

    Examples:
        >>> import swe_sphere
        >>> swe_sphere.list_scenes()["williamson5"]
        'Zonal flow over an isolated mountain.'
    """
    return {name: (make.__doc__ or "").strip().splitlines()[0] for name, make in SCENES.items()}
