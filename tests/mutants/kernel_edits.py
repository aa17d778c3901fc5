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

_FLUX_1 = "return wedge(p.fu, p.fv, geo.basis[e, n, 2], geo.basis[e, n, 3])"
_COVARIANT = "r[at_curl] = dot(geo.basis[e, n, 2], geo.basis[e, n, 3], p.u, p.v)"
_RU = "ru = -wedge(s1, s2, geo.basis[e, n, 1], geo.basis[e, n, 3])"
_DH = "r[2] = -weight * (d1[1] + d2[1])"
_ZETA = "zeta = d1[curl] - d2[curl]"
_CURL = "curl = mul(w, d1[at_curl] - d2[at_curl])"
_WEIGHT = "weight = geo.weight[n // np_, n % np_]\n        if wp.static(alone)"
_TRACERS = "f1[i, j] = wedge(fu, fv, geo.basis[e, n, 2], geo.basis[e, n, 3])"
_GATHER = "total += local.data[at.c[2] + offset] + local.data[at.c[3] + offset]"

FORMULAS = tuple(
    Edit(name, f"kernels/{file}.py", cases, old, new)
    for file, name, cases, old, new in (
        ("dynamics", "vorticity of the wrong sign", STEADY, _ZETA, "zeta = d2[curl] - d1[curl]"),
        ("dynamics", "vorticity misses a term", STEADY, _ZETA, "zeta = d1[curl]"),
        (
            "dynamics",
            "wrong entry of the basis in the gradient",
            STEADY,
            _RU,
            _RU.replace("n, 3]", "n, 2]"),
        ),
        ("dynamics", "wrong sign in the mass flux", UNSTEADY, _DH, _DH.replace("+", "-")),
        (
            "dynamics",
            "weights along one line only",
            UNSTEADY,
            _WEIGHT,
            _WEIGHT.replace("n % np_", "n // np_"),
        ),
        (
            "formulas",
            "wrong entry of the basis in transport",
            TRANSPORT,
            _FLUX_1,
            _FLUX_1.replace("3]", "1]"),
        ),
        (
            "formulas",
            "covariant wind takes one component twice",
            UNSTEADY,
            _COVARIANT,
            _COVARIANT.replace("p.v", "p.u"),
        ),
        (
            "diffusion",
            "curl of diffusion of the wrong sign",
            DECAY,
            _CURL,
            _CURL.replace("] - d2", "] + d2"),
        ),
        ("diffusion", "weak divergence misses a term", DECAY, "r = -t1 - t2", "r = -t1"),
    )
)

OTHER_LINE = "i, j", "j, i"
NODES = tuple(
    Edit(f"{name}, a thread a node", "kernels/node.py", cases, old, old.replace(*change))
    for name, cases, old, change in (
        (
            "derivative of the wrong line",
            NODE,
            "lines.across(room, geo.derivative, i, j)",
            OTHER_LINE,
        ),
        ("transport of the wrong sign", TRANSPORT_NODE, "s1 = lines", ("=", "= -")),
        (
            "transposed along the wrong line",
            DECAY_NODE,
            "lines.across_transposed(room, geo.derivative, i, j)",
            OTHER_LINE,
        ),
        ("weak derivative of the wrong sign", DECAY_NODE, "t1 = lines", ("=", "= -")),
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
        "geo.gravity * h",
        "real(1.001) * geo.gravity * h",
    ),
    Edit(
        "bottom left out",
        "kernels/dynamics.py",
        UNSTEADY,
        "return h + load(geo.bottom, 0, node)",
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
        "geo.nu4 * load",
        "real(1.01) * geo.nu4 * load",
    ),
    Edit(
        "Coriolis force of the wrong sign",
        "kernels/pointwise.py",
        STEADY,
        "r[1] - mul(f, load(x, node))",
        "r[1] + mul(f, load(x, node))",
    ),
    Edit(
        "Coriolis force left out inside elements",
        "kernels/element.py",
        STEADY,
        "rate = add(geo.point, ~node[0], geo.size, x, rate)",
        "pass",
    ),
    Edit(
        "Coriolis force on one component only",
        "kernels/pointwise.py",
        STEADY,
        " + mul(f, load(x, size + node))",
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
        "r = load(c.forcing, last * size + node)",
        "pass",
    ),
    Edit(
        "forcing of the winds mixed up",
        "kernels/pointwise.py",
        FORCED,
        "r[0] = load(c.forcing, node)\n            r[1] = load(c.forcing, size + node)",
        "r[0] = load(c.forcing, size + node)\n            r[1] = load(c.forcing, node)",
    ),
    Edit(
        "flux of tracers takes the wrong entry of the basis",
        "kernels/element.py",
        ("deformational-np",),
        _TRACERS,
        _TRACERS.replace("3]", "2]"),
    ),
    Edit(
        "limiter forgets the masses of nodes",
        "kernels/limiter.py",
        ("deformational-limiter-day",),
        "out[e, n, k] = mul(mass(geo, e, n), change)",
        "out[e, n, k] = change",
    ),
    Edit(
        "DSS misses the fourth contributor",
        "kernels/access.py",
        STEADY,
        _GATHER,
        "total += local.data[at.c[2] + offset]",
    ),
    Edit(
        "DSS counts a contributor twice",
        "kernels/access.py",
        STEADY,
        _GATHER,
        _GATHER.replace("at.c[3]", "at.c[2]"),
    ),
    Edit(
        "leapfrog over 2.02 steps",
        "kernels/vectors.py",
        ("stepper-leapfrog",),
        "two_dt * entry(tendency, i)",
        "real(1.01) * two_dt * entry(tendency, i)",
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
