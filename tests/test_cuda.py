"""The kernels compile for CUDA, where there is no GPU too; with one, it agrees with the CPU."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import warp as wp
from gpu import ARCHITECTURES, all_kernels, kind_of
from ptx import assemble, compile_ptx, find_ptxas

from swe_sphere.equations.effects import (
    Drag,
    Forcing,
    Hyperviscosity,
    Relaxation,
    Tracers,
    Viscosity,
)
from swe_sphere.equations.model import Model
from swe_sphere.kernels import (
    Terms,
    assembly,
    coarse,
    damping,
    helmholtz,
    limiter,
    specialise,
    tendency_kernels,
    tracers,
)
from swe_sphere.kernels.assembly import assembly_kernels
from swe_sphere.kernels.define import KernelTemplate
from swe_sphere.kernels.dynamics import gradient, transport
from swe_sphere.kernels.forward_backward import combine_levels_kernel, run_kernels
from swe_sphere.kernels.local import field_kernel
from swe_sphere.kernels.pointwise import NO_POINTWISE, PointTerm, Pointwise
from swe_sphere.kernels.simd import memory
from swe_sphere.kernels.terms import KernelTypes
from swe_sphere.kernels.vectors import ADDERS, leapfrog
from swe_sphere.mesh import Mesh
from swe_sphere.steppers import get_stepper
from swe_sphere.testcases import get_scene

wp.init()
with_cuda = pytest.mark.skipif(
    not wp._src.context.runtime.is_cuda_enabled, reason="this Warp is built without CUDA"
)
with_ptxas = pytest.mark.skipif(
    find_ptxas() is None, reason="spectral-swe-sphere[ptx] is not installed"
)
TABLE = Path(__file__).parents[1] / "benchmarks" / "results" / "gpu.json"
FULL = Terms(advection=True, pressure=True, bottom=True, diffusion=True, biharmonic=True)
TANGENT = Terms(advection=True, pressure=True, tangent=True)
TRANSPORT = Terms(passive=True, diffusion=True)


def terms(tangent: bool = False) -> tuple[PointTerm, ...]:
    """The formulas of drag and relaxation, or their derivatives."""
    found = []
    for effect in (Drag(1e-6, 1e-6), Relaxation(1e5)):
        wind, depth = effect.derivatives if tangent else effect.tendencies
        read = {name for f in (wind, depth) if f is not None for name in f.__code__.co_names}
        numbers = tuple(name for name in effect.coefficients(None) if name in read)
        fields = tuple({"equilibrium"} & read)
        found.append(PointTerm(effect.name, wind, depth, numbers, fields))
    return tuple(found)


def kernels(real: type) -> list[wp.Kernel]:
    """One of each kind that a GPU runs."""
    nodes = [KernelTypes(4, real, "node", terms) for terms in (FULL, TANGENT, TRANSPORT)]
    outer = KernelTypes(4, real, "node")
    inner = KernelTypes(4, wp.float32, "node", Terms(waves=True), given=real)
    restrict, prolong, _ = coarse.transfer_kernels(inner, 16)

    def assembled(unknowns: int, point: Pointwise) -> wp.Kernel:
        return specialise(assembly_kernels(unknowns, point)[0], real)

    def kernels_of(module, types: KernelTypes = inner) -> list[wp.Kernel]:
        """All that stand in the module by themselves."""
        made = [
            specialise(it, types) for it in vars(module).values() if isinstance(it, KernelTemplate)
        ]
        return [kernel for kernel in made if isinstance(kernel, wp.Kernel)]

    return [
        *(kernel for types in nodes for kernel in tendency_kernels(types)),
        assembled(3, Pointwise(rotation=True)),
        assembled(1, NO_POINTWISE),
        *(specialise(it, real) for it in run_kernels(3, Pointwise(True, True, terms()), True)[:2]),
        specialise(combine_levels_kernel(True), real),
        assembled(3, Pointwise(True, True, terms())),
        assembled(3, Pointwise(True, False, terms(True), True)),
        specialise(assembly_kernels(3, Pointwise(terms=terms()))[1], real),
        assembled(1, Pointwise(forcing=True, terms=terms()[1:])),
        specialise(ADDERS[4], real),
        specialise(leapfrog, real),
        restrict,
        prolong,
        specialise(helmholtz.substitute_kernel(real), wp.float32),
        specialise(helmholtz.to_nodes_kernel(real), wp.float32),
        specialise(damping.joined_kernel(real), wp.float32),
        *(kernel for module in (helmholtz, coarse, damping) for kernel in kernels_of(module)),
        *(field_kernel(outer, formula) for formula in (gradient, transport(), transport(True))),
        *(
            kernel
            for module in (tracers, limiter, assembly, memory)
            for kernel in kernels_of(module, outer)
        ),
    ]


@with_cuda
@pytest.mark.parametrize(
    "real", [wp.float64, pytest.param(wp.float32, marks=pytest.mark.exhaustive)]
)
@pytest.mark.thorough
def test_kernels_compile_for_cuda(real: type, tmp_path) -> None:
    """To PTX, by the compiler that comes with Warp; no GPU is needed.  Its code spills nothing."""
    for i, kernel in enumerate(kernels(real)):
        code = compile_ptx(kernel, tmp_path / str(i))
        assert ".entry" in code.read_text()
        if find_ptxas() is not None:
            assert [made.spills for made in assemble(code, ARCHITECTURES).values()] == [0, 0]


@with_cuda
@pytest.mark.parametrize("real", [wp.float64, wp.float32])
def test_prolongation_fuses_no_sum_with_a_product(real: type, tmp_path) -> None:
    """The bits of a node would otherwise depend on the order of the functions on its element."""
    _, prolong, _ = coarse.transfer_kernels(KernelTypes(4, real, "node"), 16)
    assert "fma.rn" not in compile_ptx(prolong, tmp_path).read_text()


@with_cuda
@with_ptxas
def test_spilled_registers_are_found(tmp_path) -> None:
    """Where a block is so large that its threads get few."""
    code = compile_ptx(tendency_kernels(KernelTypes(4, wp.float64, "node", FULL))[-1], tmp_path)
    text = code.read_text()
    code.write_text(re.sub(r"\.maxntid [^\n]*\n", "", text).replace("\n{", "\n.maxnreg 24\n{", 1))
    assert min(made.spills for made in assemble(code, ARCHITECTURES).values()) > 0


@with_cuda
@with_ptxas
@pytest.mark.exhaustive
def test_all_kernels_of_scenes_and_steppers_are_in_the_table(tmp_path) -> None:
    """And spill nothing."""
    (known,) = (s for name, s in json.loads(TABLE.read_text()).items() if name == "kernels")
    found = all_kernels()
    assert {kind_of(name) for name in found} <= {row[0] for row in known["rows"]}
    for name, kernel in found.items():
        made = assemble(compile_ptx(kernel, tmp_path / name), ARCHITECTURES)
        assert not any(code.spills for code in made.values()), name


def push(lon, lat, t):
    """A forcing that changes in time."""
    return 1e-5 * np.cos(lat) * np.cos(t / 1e3), 0.0 * lat, 1e-3 * np.sin(lon + t / 1e3)


@pytest.mark.skipif(wp.get_cuda_device_count() == 0, reason="no GPU on this machine")
@pytest.mark.parametrize(("ne", "np_"), [(4, 4), (2, 7)])
@pytest.mark.parametrize("stepper", ["rk4", "leapfrog", "tr-bdf2", "semi-implicit"])
def test_gpu_agrees_with_cpu(stepper: str, ne: int, np_: int) -> None:
    """After ten steps, to rounding errors; with every effect that a kernel may hold.

    Blocks of whole elements are whole warps with np 4, and not with np 7.
    """
    scene = get_scene("williamson5").with_effect(Viscosity(1e4)).with_effect(Hyperviscosity(1e15))
    scene = scene.with_effect(Drag(1e-6, 1e-8)).with_effect(Relaxation(1e6))
    scene = replace(scene, effects=(*scene.effects, Forcing()), forcing=push)
    bells = get_scene("deformational").tracers
    scene = replace(scene, effects=(*scene.effects, Tracers(limiter=True)), tracers=bells)
    ends = []
    for device in ("cpu", "cuda:0"):
        model = Model(Mesh.build(ne, np_), scene, device=device)
        made = get_stepper(stepper)(model, 300.0)
        made.start(model.initial_state())
        for _ in range(10):
            made.step()
        ends.append(made.state.numpy())
    bound = 1e-9 if stepper in ("rk4", "leapfrog") else 1e-5
    np.testing.assert_allclose(ends[1], ends[0], rtol=0.0, atol=bound * np.abs(ends[0]).max())
