"""Faults planted in the sources of the kernels."""

from __future__ import annotations

from mutants.kinds import Edit

__all__ = ["KERNEL_EDITS"]

STEADY = ("williamson2-tilted-np",)
UNSTEADY = ("lauter-day",)
NODE = ("lauter-node",)
TRANSPORT = ("williamson1-smooth-np",)
TRANSPORT_NODE = ("williamson1-node",)
DECAY = ("viscosity-np",)
FORCED = ("driven",)
HYPER = ("hyperviscosity-np",)
DECAY_NODE = ("viscosity-node",)

_FLUX = "return wedge(u, v, b[e, n, 2], b[e, n, 3])"
_COVARIANT = "dot(b[e, n, 2], b[e, n, 3], u, v)"
_GRADIENT = "return wedge(d1, d2, b[e, n, 1], b[e, n, 3])"
_CURL = "return d1 - d2"
_DH = "r[2] = -weight * divergence(d1[1], d2[1])"
_DIFFUSED_CURL = "zeta = mul(w, curl(d1[at_curl], d2[at_curl]))"
_WEIGHT = "weight = geo.weight[n // np_, n % np_]\n        gu, gv"
_TRACERS = "fv = mul(m, w[first + 1])"
_GATHER = "total += local.data[at.c[2] + offset] + local.data[at.c[3] + offset]"

FORMULAS = tuple(
    Edit(name, f"kernels/{file}.py", cases, old, new)
    for file, name, cases, old, new in (
        ("metric", "vorticity of the wrong sign", STEADY, _CURL, "return d2 - d1"),
        ("metric", "vorticity misses a term", STEADY, _CURL, "return d1"),
        (
            "metric",
            "wrong entry of the basis in the gradient",
            STEADY,
            _GRADIENT,
            _GRADIENT.replace("n, 3]", "n, 2]"),
        ),
        (
            "dynamics",
            "wrong sign in the mass flux",
            UNSTEADY,
            _DH,
            _DH.replace("divergence(d1[1], d2[1])", "(d1[1] - d2[1])"),
        ),
        (
            "dynamics",
            "weights along one line only",
            UNSTEADY,
            _WEIGHT,
            _WEIGHT.replace("n % np_", "n // np_"),
        ),
        (
            "metric",
            "wrong entry of the basis in transport",
            TRANSPORT,
            _FLUX,
            _FLUX.replace("3]", "1]"),
        ),
        (
            "metric",
            "covariant wind takes one component twice",
            UNSTEADY,
            _COVARIANT,
            _COVARIANT.replace("u, v)", "u, u)"),
        ),
        (
            "diffusion",
            "curl of diffusion of the wrong sign",
            DECAY,
            _DIFFUSED_CURL,
            _DIFFUSED_CURL.replace("curl(", "divergence("),
        ),
        (
            "diffusion",
            "weak divergence misses a term",
            DECAY,
            "-divergence(t1[0], t2[0])",
            "-t1[0]",
        ),
    )
)

OTHER_LINE = "i, j", "j, i"
NODES = tuple(
    Edit(f"{name}, a thread a node", "kernels/node.py", cases, old, old.replace(*change))
    for name, cases, old, change in (
        (
            "derivative of the wrong line",
            NODE,
            "across(room, geo.derivative, i, j)",
            OTHER_LINE,
        ),
        ("transport of the wrong sign", TRANSPORT_NODE, "return along(", ("along", "-along")),
        (
            "transposed along the wrong line",
            DECAY_NODE,
            "t1, t2 = line_sums",
            ("t1, t2", "t2, t1"),
        ),
        ("weak derivative of the wrong sign", DECAY_NODE, "result(geo, t1, t2", ("t1", "-t1")),
    )
)

KERNELS = (
    Edit(
        "kinetic energy + 1 %",
        "kernels/dynamics.py",
        STEADY,
        "real(0.5) * dot",
        "real(0.505) * dot",
    ),
    Edit(
        "pressure + 0.1 %",
        "kernels/dynamics.py",
        STEADY,
        "geo.gravity * surface(geo, node, h)",
        "real(1.001) * geo.gravity * surface(geo, node, h)",
    ),
    Edit(
        "bottom left out",
        "kernels/dynamics.py",
        UNSTEADY,
        "return h + load_nodes(geo.bottom, 0, node)",
        "return h",
    ),
    Edit("viscosity + 1 %", "kernels/diffusion.py", DECAY, "geo.nu * x", "real(1.01) * geo.nu * x"),
    Edit(
        "hyperviscosity of the wrong sign",
        "kernels/diffusion.py",
        HYPER,
        "r -= geo.nu4",
        "r += geo.nu4",
    ),
    Edit(
        "hyperviscosity + 1 %",
        "kernels/diffusion.py",
        HYPER,
        "geo.nu4 * load_nodes",
        "real(1.01) * geo.nu4 * load_nodes",
    ),
    Edit(
        "Coriolis force of the wrong sign",
        "kernels/pointwise.py",
        STEADY,
        "r[1] - mul(f, load(w, node))",
        "r[1] + mul(f, load(w, node))",
    ),
    Edit(
        "Coriolis force left out inside elements",
        "kernels/assembly.py",
        STEADY,
        "rate = add(geo.point, node, geo.size, x, rate)",
        "pass",
    ),
    Edit(
        "Coriolis force on one component only",
        "kernels/pointwise.py",
        STEADY,
        " + mul(f, load(w, size + node))",
        "",
    ),
    Edit(
        "Coriolis force of the wrong sign beside forcing",
        "kernels/pointwise.py",
        ("williamson4-day",),
        "f = load(c.coriolis, node)",
        "f = -load(c.coriolis, node)",
    ),
    Edit(
        "forcing of depth left out",
        "kernels/pointwise.py",
        FORCED,
        "if wp.static(point.forcing):",
        "if wp.static(point.forcing and is_wind):",
    ),
    Edit(
        "forcing of the winds mixed up",
        "kernels/pointwise.py",
        FORCED,
        "r[1] = load(c.forcing, size + node)",
        "r[1] = r[0]\n            r[0] = load(c.forcing, size + node)",
    ),
    Edit(
        "flux of tracers takes one wind twice",
        "kernels/dynamics.py",
        ("deformational-np",),
        _TRACERS,
        _TRACERS.replace(" + 1", ""),
    ),
    Edit(
        "limiter forgets the masses of nodes",
        "kernels/limiter.py",
        ("deformational-limiter-day",),
        "out[e, n, k] = mul(node_area(geo, e, n), change)",
        "out[e, n, k] = change",
    ),
    Edit(
        "DSS misses the fourth contributor",
        "kernels/simd/gather.cpp",
        STEADY,
        _GATHER,
        "total += local.data[at.c[2] + offset]",
    ),
    Edit(
        "DSS counts a contributor twice",
        "kernels/simd/gather.cpp",
        STEADY,
        _GATHER,
        _GATHER.replace("at.c[3]", "at.c[2]"),
    ),
    Edit(
        "leapfrog over 2.02 steps",
        "kernels/vectors.py",
        ("stepper-leapfrog",),
        "of_change * load(change, i)",
        "real(1.01) * of_change * load(change, i)",
    ),
    Edit(
        "average vector field: a weight 1 % off",
        "kernels/average.py",
        ("stepper-average-vector-field",),
        "(u0 * u0 + u0 * u1 + u1 * u1) / real(6.0)",
        "(u0 * u0 + u0 * u1 + u1 * u1) / real(6.06)",
    ),
)

KERNEL_EDITS = (*FORMULAS, *NODES, *KERNELS)
"""All of them."""
