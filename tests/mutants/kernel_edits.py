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

_FLUX_1 = "f1[i, j] = mul(h, wedge(u, v, geo.basis[e, n, 2], geo.basis[e, n, 3]))"
_RU = "ru = -wedge(b1, b2, geo.basis[e, n, 1], geo.basis[e, n, 3])"
_DH = "out[e, n, 2] = -geo.weight[i, j] * (d1(d, f1, i, j) + d2(d, f2, i, j))"
_ZETA = "zeta = d1(d, c2, i, j) - d2(d, c1, i, j)"
_CURL = "curl[i, j] = mul(w, d1(d, c2, i, j) - d2(d, c1, i, j))"
_GATHER = "total += local[at[2] + offset] + local[at[3] + offset]"

ELEMENT = tuple(
    Edit(name, "kernels/element.py", cases, old, new)
    for name, cases, old, new in (
        ("vorticity of the wrong sign", STEADY, _ZETA, f"zeta = -({_ZETA[7:]})"),
        ("vorticity misses a term", STEADY, _ZETA, "zeta = d1(d, c2, i, j)"),
        ("wrong entry of the basis in the gradient", STEADY, _RU, _RU.replace("n, 3]", "n, 2]")),
        ("wrong sign in the mass flux", UNSTEADY, _DH, _DH.replace(") + d2", ") - d2")),
        ("weights along one line only", UNSTEADY, _DH, _DH.replace("[i, j] *", "[i, i] *")),
        ("wrong entry of the basis in transport", TRANSPORT, _FLUX_1, _FLUX_1.replace("3]", "1]")),
        ("curl of diffusion of the wrong sign", DECAY, _CURL, _CURL.replace(") - d2", ") + d2")),
        (
            "weak divergence misses a term",
            DECAY,
            "r = -t1(geo.derivative, f1, i, j) - t2(geo.derivative, f2, i, j)",
            "r = -t1(geo.derivative, f1, i, j)",
        ),
        (
            "covariant wind misses a term",
            UNSTEADY,
            "c2[i, j] = dot(a21, a22, u, v)\n",
            "c2[i, j] = mul(a21, u)\n",
        ),
    )
)

NODES = tuple(
    Edit(f"{name}, a thread a node", "kernels/node.py", cases, old, new)
    for name, cases, old, new in (
        (
            "vorticity of the wrong sign",
            NODE,
            "ru += zeta * x[geo.size + node]",
            "ru -= zeta * x[geo.size + node]",
        ),
        (
            "transport flux of the wrong sign",
            TRANSPORT_NODE,
            "div += geo.derivative[j, m] * x[node] * flux",
            "div -= geo.derivative[j, m] * x[node] * flux",
        ),
        ("diffusion misses a term", DECAY_NODE, "p2 += d2 * geo.fluxes[e, q, 2]", "p2 += d2"),
        ("curl of the wrong sign", DECAY_NODE, "curl -= d * dot", "curl += d * dot"),
    )
)

KERNELS = (
    Edit(
        "kinetic energy + 1 %",
        "kernels/formulas.py",
        STEADY,
        "real(0.5) * dot",
        "real(0.505) * dot",
    ),
    Edit(
        "pressure + 0.1 %",
        "kernels/formulas.py",
        STEADY,
        "geo.gravity * height",
        "real(1.001) * geo.gravity * height",
    ),
    Edit(
        "bottom left out",
        "kernels/formulas.py",
        UNSTEADY,
        "return h + load(geo.bottom, 0, node)",
        "return h",
    ),
    Edit("viscosity + 1 %", "kernels/formulas.py", DECAY, "geo.nu * x", "real(1.01) * geo.nu * x"),
    Edit(
        "hyperviscosity of the wrong sign",
        "kernels/formulas.py",
        HYPER,
        "r -= geo.nu4",
        "r += geo.nu4",
    ),
    Edit(
        "hyperviscosity + 1 %",
        "kernels/formulas.py",
        HYPER,
        "geo.nu4 * load",
        "real(1.01) * geo.nu4 * load",
    ),
    Edit(
        "Coriolis force of the wrong sign",
        "kernels/assembly.py",
        STEADY,
        "stride) - f * x[node]",
        "stride) + f * x[node]",
    ),
    Edit(
        "Coriolis force on one component only",
        "kernels/assembly.py",
        STEADY,
        " + f * x[size + node]",
        "",
    ),
    Edit(
        "Coriolis force of the wrong sign beside forcing",
        "kernels/pointwise.py",
        ("williamson4-day",),
        "f = c.coriolis[i]",
        "f = -c.coriolis[i]",
    ),
    Edit("forcing of depth left out", "kernels/pointwise.py", FORCED, "r += c.forcing[k]", "pass"),
    Edit(
        "forcing of the winds mixed up",
        "kernels/pointwise.py",
        FORCED,
        "pair(c.forcing[i], c.forcing[j])",
        "pair(c.forcing[j], c.forcing[i])",
    ),
    Edit(
        "flux of tracers takes the wrong entry of the basis",
        "kernels/tracers.py",
        ("deformational-np",),
        "return mul(m, wedge(u, v, a21, a22))",
        "return mul(m, wedge(u, v, a21, a21))",
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
        "kernels/assembly.py",
        STEADY,
        _GATHER,
        "total += local[at[2] + offset]",
    ),
    Edit(
        "DSS counts a contributor twice",
        "kernels/assembly.py",
        STEADY,
        _GATHER,
        _GATHER.replace("at[3]", "at[2]"),
    ),
    Edit(
        "leapfrog over 2.02 steps",
        "kernels/leapfrog.py",
        ("stepper-leapfrog",),
        "two_dt * tendency[i]",
        "real(1.01) * two_dt * tendency[i]",
    ),
    Edit(
        "average vector field: a weight 1 % off",
        "kernels/average.py",
        ("stepper-average-vector-field",),
        "(u0 * u0 + u0 * u1 + u1 * u1) / real(6.0)",
        "(u0 * u0 + u0 * u1 + u1 * u1) / real(6.06)",
    ),
)

KERNEL_EDITS = (*ELEMENT, *NODES, *KERNELS)
"""All of them."""
