"""What is compiled: the C++ that Warp generates holds the terms of a scene and nothing else."""

from __future__ import annotations

import ast
import re
from dataclasses import dataclass
from pathlib import Path

import pytest
import warp as wp
from support import make_scene

import swe_sphere.kernels
from swe_sphere.equations.model import Model
from swe_sphere.mesh import Mesh
from swe_sphere.operators import Launcher
from swe_sphere.testcases import get_scene

MESH = Mesh.build(1, 4)
SHAPES = ("element", "node")
OPTIONAL = {
    "gravity": ("pressure",),
    "bottom": ("orography",),
    "wind": ("wind",),
    "nu": ("viscosity",),
    "nu4": ("hyperviscosity",),
    "laplacian": ("hyperviscosity",),
    "inverse_jacobian": ("viscosity", "hyperviscosity"),
    "fluxes": ("viscosity", "hyperviscosity"),
    "coriolis": ("rotation",),
    "forcing": ("forcing",),
    "linear": ("drag", "quadratic-drag"),
    "quadratic": ("quadratic-drag",),
    "rate": ("relaxation",),
    "equilibrium": ("relaxation",),
    "base": ("linearised",),
}
"""Names of arrays and coefficients, and the effects that call for each."""


@dataclass(frozen=True)
class Code:
    """Generated code without comments, of the kernels of one right-hand side."""

    text: str

    def has(self, name: str) -> bool:
        """Whether the code uses an array or coefficient of that name."""
        return re.search(rf"\b{name}\b", self.text) is not None

    def count(self, *calls: str) -> int:
        """How often any of these functions of Warp, or in C++ of ours, is called."""
        names = rf"(?:wp::|(?:= |  )(?:\w+__locals__)?)(?:{'|'.join(calls)})(?:_\d+)?\("
        return len(re.findall(names, self.text))

    @property
    def arithmetic(self) -> int:
        return self.count("add", "sub", "mul", "product", "line_sum", "neg")

    @property
    def loads(self) -> int:
        return self.count("address", "load", "load_nodes")

    @property
    def stores(self) -> int:
        """Stores, of which `store_stage` makes one a field."""
        fields = [int(number) for number in re.findall(r"f < (\d+); \+\+f", self.text)]
        return self.count("array_store", "put") + self.count("store_stage") * max(fields, default=0)

    @property
    def branches(self) -> int:
        """Conditions but ends of loops, those of DSS, which nodes need it, and what is a stage."""
        of_warp = r"_store\w+\(.*?^\}"
        of_ours = r"(gather|_load_nodes|stage_store)\w+\(.*?^\}$"
        own = rf"^static [^\n]* ({of_warp}|{of_ours})"
        text = re.sub(own, "", self.text, flags=re.M | re.S)
        conditions = re.findall(r"\bif \((?!.*\) goto end_for_)", text)
        return len(conditions) + Code(text).count("where", "select")


def source(kernel: wp.Kernel) -> str:
    """The C++ in Warp's cache that this kernel was built from."""
    name = kernel.module.get_module_identifier(block_dim=1)
    text = (Path(wp.config.kernel_cache_dir) / name / f"{name}.cpp").read_text()
    text = re.sub(r"//[^\n]*", "", text[re.search(r"^(struct|static) ", text, re.M).start() :])
    return re.split(r"\w+_cpu_(?:block_payload_forward|forward_tasks)", text)[0]  # no launch code


def code_of(scene, shape: str, component: str = "all") -> Code:
    model = Model(MESH, scene, shape=shape)
    kernels = kernels_of(operator_of(model, component), model)
    return Code("\n".join(source(kernel) for kernel in kernels))


def kernels_of(operator, model: Model) -> list[wp.Kernel]:
    """The kernels that an operator launches; of each name the last one, which has no lanes."""
    kernels = {}

    def record(launch, kernel, *arguments, **options):
        kernels[kernel.key] = kernel

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Launcher, "__call__", record)
        operator(model.zeros(), model.zeros())
    return [*kernels.values()]


def operator_of(model: Model, component: str = "all"):
    """The last operator of a right-hand side: the earlier ones prepare what it reads."""
    return model.right_hand_side(component).operations[-1].operator


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize(
    "effects",
    [
        ("advection", "pressure"),
        ("advection", "pressure", "rotation"),
        ("pressure", "orography"),
        ("advection", "pressure", "rotation", "orography", "viscosity"),
        ("pressure", "rotation", "hyperviscosity"),
        ("wind",),
        ("wind", "viscosity"),
        ("wind", "forcing"),
        ("advection", "pressure", "forcing"),
        ("pressure", "rotation", "viscosity", "forcing"),
        ("advection", "pressure", "drag"),
        ("pressure", "rotation", "quadratic-drag"),
        ("pressure", "rotation", "relaxation"),
        ("wind", "relaxation"),
        ("advection", "pressure", "rotation", "linearised"),
        ("pressure", "orography", "quadratic-drag", "relaxation", "linearised"),
        ("advection", "pressure", "rotation", "orography", "viscosity", "hyperviscosity"),
    ],
    ids="+".join,
)
@pytest.mark.thorough
def test_only_the_named_effects_are_compiled(effects, shape) -> None:
    """Each optional name is in the code if and only if an effect of the scene calls for it."""
    code = code_of(make_scene(*effects), shape)
    for name, callers in OPTIONAL.items():
        wanted = any(effect in effects for effect in callers)
        if name == "bottom":
            wanted = "orography" in effects and {"pressure", "viscosity"} & set(effects)
        if name in ("bottom", "equilibrium") and "linearised" in effects:
            wanted = False  # what is constant has no derivative
        if name == "fluxes" and shape == "element":
            wanted = False
        assert code.has(name) == bool(wanted), name
    assert code.branches == 0


@pytest.mark.parametrize("shape", ["element", pytest.param("node", marks=pytest.mark.thorough)])
@pytest.mark.parametrize("effect", ["advection", "rotation", "orography", "viscosity"])
def test_each_effect_costs_loads_and_arithmetic_only_where_it_is(effect: str, shape: str) -> None:
    all_of_them = ("advection", "pressure", "rotation", "orography", "viscosity")
    without = tuple(name for name in all_of_them if name != effect)
    full, less = (code_of(make_scene(*names), shape) for names in (all_of_them, without))
    assert less.arithmetic < full.arithmetic
    assert less.loads < full.loads
    assert len(less.text) < len(full.text)


@pytest.mark.parametrize("shape", SHAPES)
def test_scenes_compile_their_own_equations_only(shape: str) -> None:
    """A steady flow knows no bottom; a carried bell has a third of the unknowns and no momentum."""
    steady, mountain, bell = (
        code_of(get_scene(name), shape) for name in ("williamson2", "williamson5", "williamson1")
    )
    assert mountain.has("bottom") and not steady.has("bottom")
    assert bell.has("wind") and not steady.has("wind")
    assert not any(bell.has(name) for name in ("gravity", "coriolis", "bottom", "base"))
    assert bell.stores < 0.5 * steady.stores
    assert bell.arithmetic < 0.5 * steady.arithmetic < 0.5 * mountain.arithmetic


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize(
    "effects",
    [("advection", "pressure"), ("pressure", "rotation", "orography"), ("pressure", "forcing")],
    ids="+".join,
)
def test_dynamics_do_not_know_of_effects_that_are_taken_apart(effects, shape) -> None:
    """The conservative part of a scene is word by word that of one without drag and the like."""
    added = ("viscosity", "quadratic-drag", "relaxation")
    apart = code_of(make_scene(*effects, *added), shape, "conservative")
    assert apart.text == code_of(make_scene(*effects), shape).text


@pytest.mark.parametrize("effects", [("pressure",), ("pressure", "rotation"), ("wind",)])
def test_without_pointwise_effects_the_assembly_is_given_nothing_for_them(effects) -> None:
    """As one that never heard of forcing, drag and relaxation."""
    model = Model(MESH, make_scene(*effects))
    *_, assembly = kernels_of(operator_of(model), model)
    (read,) = (arg.type for arg in assembly.adj.args if arg.label == "c")
    assert {*read.vars} == ({"coriolis"} if "rotation" in effects else set())


@pytest.mark.parametrize("effects", [("drag",), ("relaxation",), ("quadratic-drag", "forcing")])
def test_pointwise_effects_alone_assemble_nothing(effects, monkeypatch) -> None:
    loaded, load = [], Launcher.load
    monkeypatch.setattr(Launcher, "load", lambda *given: (loaded.extend(given[1:]), load(*given)))
    operator_of(Model(MESH, make_scene(*effects)))
    kernel = loaded[-1]
    code = Code(source(kernel))
    assert not any(code.has(name) for name in ("places", "inverse_area", "local"))


def test_momentum_has_no_arrays_under_a_prescribed_wind() -> None:
    model = Model(MESH, get_scene("williamson1"))
    operator = operator_of(model)
    assert model.zeros().shape == (MESH.size,)
    assert operator.local.values.shape[-1] == 1
    *_, assembly = kernels_of(operator, model)
    assert Code(source(assembly)).stores == 1


@pytest.mark.parametrize("shape", SHAPES)
def test_tangent_has_a_base_and_no_bottom(shape: str) -> None:
    """What is constant has no derivative."""
    tangent = code_of(get_scene("williamson5"), shape, "tangent")
    assert tangent.has("base") and not tangent.has("bottom")
    forced = code_of(make_scene("pressure", "forcing"), shape, "tangent")
    assert forced.text == code_of(make_scene("pressure"), shape, "tangent").text


def kernel_functions() -> list[tuple[str, ast.FunctionDef]]:
    """Every function of kernels/ that Warp compiles."""
    found = []
    for path in sorted(Path(swe_sphere.kernels.__file__).parent.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.FunctionDef):
                decorators = " ".join(ast.unparse(item) for item in node.decorator_list)
                if re.search(r"\b(func|kernel)\b", decorators):
                    found.append((f"{path.name}:{node.lineno}", node))
    return found


def bare_literals(function: ast.FunctionDef) -> list[int]:
    """Lines with a float that no conversion such as real(...) makes one of the right precision."""
    converted = {
        id(argument)
        for call in ast.walk(function)
        if isinstance(call, ast.Call) and ast.unparse(call.func) in ("real", "value", "wp.float64")
        for argument in call.args
    }
    return [
        node.lineno
        for node in ast.walk(function)
        if isinstance(node, ast.Constant)
        and isinstance(node.value, float)
        and id(node) not in converted
    ]


def test_kernels_have_no_bare_float_literals() -> None:
    """To Warp a bare literal is a float32, which silently loses digits in float64."""
    functions = kernel_functions()
    assert len(functions) > 20
    assert {where: lines for where, node in functions if (lines := bare_literals(node))} == {}


def test_bare_literals_are_found() -> None:
    source_code = "def f(x: float):\n    y = real(0.5)\n    return 0.5 * x + real(1.0 / 3.0)"
    assert bare_literals(ast.parse(source_code).body[0]) == [3, 3, 3]
