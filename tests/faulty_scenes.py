"""Scene files with a fault each, made systematically: every function with every kind of fault."""

from __future__ import annotations

from collections.abc import Iterator

FLOW, WIND, LINEAR = "flow", "wind", "linear"
"""Kinds of scenes: together they have every function that a scene can have."""

SOUND = """
import sys
import numpy as np
from swe_sphere.equations.effects import *
from swe_sphere.equations.scene import Scene
from swe_sphere.planet import Planet

def initial(lon, lat):
    return 10.0 * np.cos(lat), 0.0 * lat, 1000.0 + np.sin(lat)

def exact(lon, lat, t):
    return initial(lon, lat)

def base(lon, lat):
    return initial(lon, lat)

def wind(lon, lat, t):
    return 10.0 * np.cos(lat), 0.0 * lat

def forcing(lon, lat, t):
    return 1e-9 * np.cos(lat), 0.0 * lat, 0.0 * lat

def bottom(lon, lat):
    return np.cos(lat)

def coriolis(lon, lat):
    return 1e-4 * np.sin(lat)

def equilibrium(lon, lat):
    return 1000.0 + 0.0 * lat

def tracer(lon, lat):
    return np.cos(lat)

def exact_tracers(lon, lat, t):
    return {"q": np.cos(lat)}

given = dict(
    name="mine", title="mine", reference="none", ne=1, np=4, days=0.02,
    initial=initial, exact=exact,
)
flow = dict(
    effects=(*DYNAMICS, Rotation(), Orography(), Forcing(), Relaxation(1e5), Tracers()),
    forcing=forcing, bottom=bottom, coriolis=coriolis, equilibrium=equilibrium,
    tracers={"q": tracer}, exact_tracers=exact_tracers,
)
wind = dict(effects=(PrescribedWind(),), wind=wind)
linear = dict(effects=(*DYNAMICS, LinearisedDynamics()), base=base)

def scene():
    return Scene(**given | KIND | dict(CHANGES))
"""

FIELDS = {
    "initial": ("10.0 * np.cos(lat)", "0.0 * lat", "1000.0 + np.sin(lat)"),
    "exact": ("10.0 * np.cos(lat)", "0.0 * lat", "1000.0 + np.sin(lat)"),
    "base": ("10.0 * np.cos(lat)", "0.0 * lat", "1000.0 + np.sin(lat)"),
    "wind": ("10.0 * np.cos(lat)", "0.0 * lat"),
    "forcing": ("1e-9 * np.cos(lat)", "0.0 * lat", "0.0 * lat"),
    "bottom": ("np.cos(lat)",),
    "coriolis": ("1e-4 * np.sin(lat)",),
    "equilibrium": ("1000.0 + 0.0 * lat",),
    "tracer": ("np.cos(lat)",),
    "exact_tracers": ("np.cos(lat)",),
}
"""What the functions return, a formula for each field."""

UNSTEADY = ("exact", "wind", "forcing", "exact_tracers")
"""Functions that are also given the time."""

BAD_FIELDS = {
    "complex": "1j * lat",
    "text": "'deep'",
    "texts": "np.full(lat.size, 'deep')",
    "nothing": "None",
    "objects": "np.full(lat.size, None)",
    "short": "lat[:-1]",
    "long": "np.append(lat, 0.0)",
    "column": "lat[:, None]",
    "stacked": "np.zeros((2, lat.size))",
    "empty": "[]",
    "ragged": "[lat, lat[:-1]]",
    "a function": "np.cos",
    "infinite": "np.where(lat > 1.0, np.inf, 0.0)",
    "masked": "np.ma.masked_greater(lat, 1.0)",
    "dates": "np.full(lat.size, np.datetime64('2001-01-01'))",
}
"""Formulas for a field that nothing can be done with."""

MAY_BE_NAN = ("exact", "exact_tracers")
"""Functions that may say by NaN that nothing is known."""

BAD_BODIES = {
    "raises": "1 / 0",
    "raises a KeyError": "{}['depth']",
    "ends the program": "sys.exit(3)",
    "ends it with a word": "sys.exit('enough')",
    "returns nothing": "None",
    "returns a text": "'uvh'",
    "calls what is not there": "absent(lat)",
    "writes to its arguments": "np.add(lat, 1.0, out=lat)",
    "recurses": "again(again)",
}
"""What a function may return instead of its fields, or do on the way."""


def scene_file(kind: str = FLOW, override: str = "", changes: str = "") -> str:
    """Text of a scene file: the sound one with functions written anew and attributes changed."""
    sound = SOUND.replace("KIND", kind).replace("CHANGES", changes)
    head, mark, tail = sound.partition("given = dict(")
    return head + override + mark + tail


def function(name: str, result: str) -> str:
    """A function of a scene in Python, that returns the result."""
    time = ", t" if name in UNSTEADY else ""
    return f"def {name}(lon, lat{time}):\n    again = lambda f: f(f)\n    return {result}\n\n"


def returning(name: str, fields: tuple[str, ...]) -> str:
    """The function with other formulas for its fields."""
    if name == "exact_tracers":
        return function(name, f"{{'q': {fields[0]}}}")
    return function(name, fields[0] if len(fields) == 1 else f"({', '.join(fields)})")


def kind_of(name: str) -> str:
    """A kind of scene that has the function."""
    return {"wind": WIND, "base": LINEAR}.get(name, FLOW)


def faulty_functions() -> Iterator[tuple[str, str]]:
    """Names and texts of scene files, each with a function that is wrong."""
    for name, sound in FIELDS.items():
        kind = kind_of(name)
        for number in range(len(sound)):
            for fault, bad in BAD_FIELDS.items():
                if name in MAY_BE_NAN and fault == "masked":
                    continue
                fields = (*sound[:number], bad, *sound[number + 1 :])
                yield f"{name} {number} {fault}", scene_file(kind, returning(name, fields))
        for fault, body in BAD_BODIES.items():
            yield f"{name} {fault}", scene_file(kind, function(name, body))
        if name not in MAY_BE_NAN:
            fields = (*sound[:-1], "np.where(lat > 1.0, np.nan, 0.0)")
            yield f"{name} NaN", scene_file(kind, returning(name, fields))
        for signature in ("", "lon", "lon, lat, t, more", "*, lon"):
            override = f"def {name}({signature}):\n    return 0.0\n\n"
            yield f"{name}({signature})", scene_file(kind, override)
        if name != "tracer":
            yield f"{name} is a number", scene_file(kind, changes=f"{name}=3.0")
        if len(sound) > 1:
            yield from _wrong_numbers(name, kind, sound)


def _wrong_numbers(name: str, kind: str, sound: tuple[str, ...]) -> Iterator[tuple[str, str]]:
    for fault, result in {
        "one too many": f"({', '.join((*sound, '0.0'))})",
        "one too few": f"({', '.join(sound[:-1])},)",
        "none": "()",
        "a number": "1.0",
        "one array": "lat",
        "a dictionary": "{'u': lat, 'v': lat, 'h': lat}" if len(sound) == 3 else "{'u': 1, 'v': 2}",
    }.items():
        yield f"{name} returns {fault}", scene_file(kind, function(name, result))


def later(name: str) -> str:
    """The function, which fails after ten minutes."""
    fields = FIELDS[name]
    return returning(name, (f"{fields[0]} if t < 600.0 else 1 / 0", *fields[1:]))


OTHERS = {
    "tracers of another name": scene_file(override=function("exact_tracers", "{'p': lat}")),
    "exact tracers are an array": scene_file(override=function("exact_tracers", "lat")),
    **{
        f"{name} {depth}": scene_file(
            kind_of(name), returning(name, ("0.0", "0.0", f"{depth} + 0.0 * lat"))
        )
        for name in ("initial", "base")
        for depth in ("0.0", "-1.0", "1e-300", "5e-324", "1e300")
    },
}
"""Faults of functions that have no like."""

ATTRIBUTES = (
    "ne='2'", "ne=2.5", "ne=0", "ne=-1", "ne=None", "ne=True", "ne=10**400", "ne=16**9000",
    "np='4'", "np=2.5", "np=99", "np=2", "np=None", "np=10**400", "np=float('nan')",
    "days=float('nan')", "days=float('inf')", "days=-1.0", "days=0", "days='1'", "days=None",
    "days=True", "days=10**400", "days=1e300", "days=1e-300", "days=1j",
    "name=''", "name=None", "name=3", "name='  '", "name='a\\x00b'", "title=None", "title=3",
    "title='\\ud800'", "title='a\\x00b'", "reference=None", "reference=b'a'",
    "effects=None", "effects=Rotation()", "effects=[]", "effects=('rotation',)",
    "effects=(Rotation,)", "effects=(*DYNAMICS, *DYNAMICS)", "effects='rotation'",
    "effects=DYNAMICS", "effects=(Viscosity(-1.0),)", "effects=(Viscosity('1'),)",
    "effects=(Relaxation(None),)",
    "planet=None", "planet=Planet(radius=-1.0)", "planet=Planet(radius='1')",
    "planet=Planet(gravity=float('nan'))", "planet=Planet(gravity=0.0)",
    "planet=Planet(rotation=float('inf'))", "planet=Planet(rotation=None)",
    "error_field='depth'", "error_field=None", "error_field=[]", "steady_forcing='no'",
    "parameters=None", "parameters=3", "parameters={'a': np.zeros(3)}", "parameters={1: 2}",
    "initial=None", "tracers=None", "tracers={}", "tracers=[tracer]", "tracers={'q': 3.0}",
    "tracers={'q': None}", "tracers={1: tracer}", "tracers={'q 1': tracer}",
    "exact_tracers=3", "depth=3", "exact=exact(0.0, 0.0, 0.0)",
)  # fmt: skip
"""Attributes of a scene that are wrong."""

FILES = {
    "empty": "",
    "no scene": "x = 1\n",
    "scene is a number": "scene = 3\n",
    "scene is a type": "scene = dict\n",
    "scene is built in": "scene = len\n",
    "returns nothing": "def scene():\n    pass\n",
    "returns a class": "def scene():\n    return dict\n",
    "syntax": "def scene(:\n",
    "no text": "\x00\x01",
    "indentation": "def scene():\npass\n",
    "import": "import no_such_module_at_all\n",
    "import of a name": "from swe_sphere.equations.scene import Scenery\n",
    "exit on import": "import sys\nsys.exit(3)\n",
    "exit": "def scene():\n    raise SystemExit\n",
    "exit as if all were well": "import sys\nsys.exit(0)\n",
    "base exception": "raise BaseException('odd')\n",
    "raises on import": "1 / 0\n",
    "raises": "def scene():\n    return [][3]\n",
    "raises in lines": "def scene():\n    raise ValueError('two\\nlines')\n",
    "recursion": "def scene():\n    return scene()\n",
    "parameter without a value": "def scene(speed):\n    pass\n",
    "unknown annotation": "def scene(speed: Speed = 1):\n    pass\n",
    "later annotation": (
        "from __future__ import annotations\ndef scene(speed: Speed = 1):\n    pass\n"
    ),
    "missing arguments": (
        "from swe_sphere.equations.scene import Scene\n"
        "def scene():\n    return Scene(name='mine')\n"
    ),
    "generator": "def scene():\n    yield 3\n",
}
"""Whole files that are wrong."""


def faulty_scenes() -> dict[str, str]:
    """Texts of scene files, by a few words on the fault of each."""
    attributes = {change: scene_file(changes=change) for change in ATTRIBUTES}
    return dict(faulty_functions()) | OTHERS | attributes | FILES
