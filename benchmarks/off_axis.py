"""Growth of computational modes in flows off the cube's axes, and dissipation against it.

    python benchmarks/off_axis.py [SECTION ...]

writes docs/off_axis.md, docs/off_axis.json and the figures of the page.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy
import typer
from implicit_common import Section
from sections import command
from threadpoolctl import threadpool_limits

from swe_sphere import Simulation
from swe_sphere.equations.effects import EdgePenalty, hyperviscosity_default
from swe_sphere.equations.model import Model
from swe_sphere.equations.scene import Scene
from swe_sphere.errors import RunFailed
from swe_sphere.io.integrals import by_name
from swe_sphere.io.reference_solution import SHIPPED, OnGrid, Reference
from swe_sphere.mesh import Mesh
from swe_sphere.planet import DAY, EARTH
from swe_sphere.testcases import get_scene

HEAD = """# Stable off the cube's axes

Made by `python benchmarks/off_axis.py`; float64, one core.

**Finding.** Without dissipation, a flow that crosses the faces of the cube obliquely feeds
computational modes: the error of the steady flow of williamson2 at α = 1 grows by a factor of e in
4 to 12 days on meshes of ne4 to ne8. The [edge penalty](effects.md) with `c = 0.01` removes the
growth: errors at day 100 are at most twice those at day 10. Its effect on the errors of standard
scenes is tabled below. For example:

    swe-sphere run williamson2 --alpha 1 --ne 4 --np 5 --days 100 --set edge-penalty.c=0.01

**What grows.** The modes are inertial ones with frequencies below 2Ω. Nine tenths or more of their
energy is kinetic. Nearly all of their divergence is a jump between elements, which DSS averages
away, so that pressure does not act on them. At the corners of the cube |v|² is 10 and more times
its mean. See [the fastest modes](#the-fastest-modes).

**Why they can grow.** About the tilted axis the exact flow turns as a rigid body. In the frame that
turns with the fluid it is at rest, so that energy minus rotation rate times angular momentum is a
positive invariant of small disturbances: the continuous equations are stable. The discrete
equations conserve mass and energy exactly, but neither angular momentum nor potential enstrophy,
and no invariant prevents growth. Time steps do not matter: leapfrog, rk4, TR-BDF2 and the
average-vector-field method have the same growth.

**Why few tests show it.** With the axis of the flow along an axis of symmetry of the cube (α = 0,
π/4, π/2) truncation errors project on the fastest modes only through round-off. The growth *rates*
at α = 0 are as large as at other angles. Hyperviscosity, which operational spectral-element models
always use, hides the modes: the default ∇⁴ coefficient is a multiple of what stability needs, and
its own error is larger than that of the undissipated scheme.

**The penalty** adds, for every test wind w, −Σ γ W J [(ζ − ζ̄) curl w + (δ − δ̄) div w] at the edge
nodes of elements, where ζ̄ and δ̄ are the means over the elements that meet there and γ = c |V| dx.
It is symmetric and negative semi-definite, conserves mass, and vanishes for winds with continuous
vorticity and divergence. Penalties on jumps of derivatives stabilise continuous elements for
convection-dominated problems (Burman & Hansbo 2004, doi:10.1016/j.cma.2003.12.032). Weller (2012,
Mon. Wea. Rev. 140, 3220) removes computational modes of the hexagonal C grid by upwinded potential
vorticity.
"""
ANGLES = (0.0, 0.3, 0.6, 1.0)
"""Tilt of the axis of the flow of williamson2 against that of the planet [radians]."""
SHIFTS = 3.0e-6 + 1j * np.linspace(0.0, 1.5e-4, 16)
"""Points [s-1] near which eigenvalues are looked for: computational modes are inertial ones."""
NEAREST = 40
SPEED, DEPTH = 2.0 * np.pi * EARTH.radius / (12.0 * DAY), 2.94e4 / EARTH.gravity
DENSE = 2000
"""Up to so many unknowns all eigenvalues are computed."""
C = 0.01
MESHES = ((2, 4), (3, 4), (4, 4), (2, 5), (3, 5), (4, 5), (2, 6), (3, 6), (2, 7), (2, 8))


def tilted_flow(alpha: float, speed: float = SPEED, depth: float = DEPTH) -> Scene:
    """Return williamson2 with another wind speed [m s-1] and depth at the equator [m]."""
    scene = get_scene("williamson2", alpha=alpha)
    fall = (EARTH.radius * EARTH.rotation * speed + 0.5 * speed**2) / EARTH.gravity

    def initial(lon: np.ndarray, lat: np.ndarray) -> tuple[np.ndarray, ...]:
        sine = np.sin(lat) * np.cos(alpha) - np.cos(lon) * np.cos(lat) * np.sin(alpha)
        u, v, _ = scene.initial(lon, lat)
        return u * speed / SPEED, v * speed / SPEED, depth - fall * sine**2

    return replace(scene, initial=initial, exact=None)


def jacobian(mesh: Mesh, scene: Scene) -> scipy.sparse.csc_array:
    """Return the Jacobian [s-1] of the tendency at the initial flow of a scene."""
    model = Model(mesh, scene)
    product = model.linearise(model.initial_state(), 0.0)
    direction, out, size = model.zeros(), model.zeros(), model.size
    unit, columns = np.zeros(size), []
    for k in range(size):
        unit[k] = 1.0
        direction.assign(unit)
        product(direction, out)
        columns.append(scipy.sparse.csc_array(out.numpy()[:, None]))
        unit[k] = 0.0
    return scipy.sparse.hstack(columns, format="csc")


def fastest(mesh: Mesh, scene: Scene, c: float = 0.0) -> tuple[complex, np.ndarray]:
    """Return the eigenvalue of the largest real part [s-1] with an edge penalty, and its vector."""
    matrix = jacobian(mesh, scene.with_effect(EdgePenalty(c)) if c else scene)
    if matrix.shape[0] <= DENSE:
        values, vectors = np.linalg.eig(matrix.toarray())
        first = int(np.argmax(values.real))
        return complex(values[first]), vectors[:, first]
    matrix = matrix.astype(complex)
    best, vector = -np.inf + 0j, np.empty(0)
    for shift in SHIFTS:
        factors = scipy.sparse.linalg.splu(matrix - shift * scipy.sparse.eye_array(matrix.shape[0]))
        inverse = scipy.sparse.linalg.LinearOperator(
            matrix.shape, matvec=factors.solve, dtype=complex
        )
        values, vectors = scipy.sparse.linalg.eigs(inverse, k=NEAREST, which="LM", tol=1e-8)
        values = shift + 1.0 / values
        first = int(np.argmax(values.real))
        if values[first].real > best.real:
            best, vector = complex(values[first]), vectors[:, first]
    return best, vector


SCENES = {alpha: get_scene("williamson2", alpha=alpha) for alpha in ANGLES}


def spectrum() -> Section:
    """Largest growth rates by mesh and angle."""
    rows = []
    for ne, np_ in MESHES:
        mesh = Mesh.build(ne, np_)
        for c in (0.0, C):
            rates = [fastest(mesh, SCENES[alpha], c)[0].real for alpha in ANGLES]
            rows.append([f"ne{ne} np{np_}", f"c = {c:g}" if c else "none", *map(per_day, rates)])
    return Section(
        "Growth rates of the discrete equations",
        "Largest real part [1/day] among the eigenvalues nearest to points along the imaginary axis"
        f" up to {SHIFTS[-1].imag:.2g} s⁻¹, of the tendency linearised about the exact flow of"
        " williamson2 whose axis is tilted by α [rad]. All modes of the continuous equations are"
        " neutral.",
        ["mesh", "edge penalty", *(f"α = {alpha:g}" for alpha in ANGLES)],
        rows,
    )


def per_day(rate: float) -> str:
    """Growth rate [s-1] per day."""
    rate *= DAY
    return f"{rate:.3f}" if abs(rate) > 5e-4 else "0" if abs(rate) < 1e-10 else f"{rate:.0e}"


def dependence() -> Section:
    """Growth rates by wind speed, depth and stretching."""
    plain, finer = Mesh.build(3, 4), Mesh.build(2, 6)
    flows = [(5.0, DEPTH), (10.0, DEPTH), (20.0, DEPTH), (SPEED, DEPTH), (SPEED, 10000.0)]
    flows += [(60.0, 10000.0), (5.0, 250.0), (5.0, 500.0), (5.0, 1000.0), (5.0, 10000.0)]
    cases = [
        (f"{speed:.3g} m/s, {depth:.0f} m", plain, finer, tilted_flow(1.0, speed, depth))
        for speed, depth in flows
    ]
    cases += [
        (
            f"stretched {s:g} times",
            *(Mesh.build(m.ne, m.np, stretch=s, centre=(40.0, 23.0)) for m in (plain, finer)),
            SCENES[1.0],
        )
        for s in (2.0, 3.0)
    ]
    rows = []
    for label, *meshes, scene in cases:
        rows.append(
            [
                label,
                *(per_day(fastest(mesh, scene, c)[0].real) for mesh in meshes for c in (0.0, C)),
            ]
        )
    return Section(
        "Dependence on wind, depth and stretching",
        "Largest real part [1/day] for α = 1, by the wind speed and the depth at the equator of the"
        " flow; the stretched meshes carry williamson2 itself.",
        ["flow", "ne3 np4", "ne3 np4, c = 0.01", "ne2 np6", "ne2 np6, c = 0.01"],
        rows,
    )


def stretched(mesh: Mesh, factor: float) -> Mesh:
    """Return a mesh of as many elements that is finer at one place."""
    return Mesh.build(mesh.ne, mesh.np, stretch=factor, centre=(40.0, 23.0))


def modes() -> Section:
    """Return frequencies and shapes of the fastest growing modes."""
    rows = []
    for ne, np_, alpha in ((3, 4, 1.0), (4, 4, 1.0), (3, 5, 1.0), (2, 6, 1.0), (3, 4, 0.0)):
        mesh = Mesh.build(ne, np_)
        rows.append(
            [f"ne{ne} np{np_}", f"{alpha:g}", *_portrait(mesh, *fastest(mesh, SCENES[alpha]))]
        )
    return Section(
        "The fastest modes",
        "Share of kinetic energy; share of ∫δ² and ∫ζ² that is jump between elements; share of"
        " the wind in the last Legendre mode along either coordinate; |v|² at the corners of the"
        " cube over its mean.",
        ["mesh", "α", "growth [1/day]", "frequency [s⁻¹]", "kinetic", "jump of δ", "jump of ζ",
         "last mode", "cube corners"],
        rows,
    )  # fmt: skip


def _portrait(mesh: Mesh, value: complex, vector: np.ndarray) -> list[str]:
    scene = SCENES[0.0]
    _, _, depth = scene.initial(mesh.lon, mesh.lat)
    u, v, h = vector.reshape(3, -1)
    speed2 = np.abs(u) ** 2 + np.abs(v) ** 2
    kinetic = np.sum(mesh.area * depth * speed2)
    potential = scene.planet.gravity * np.sum(mesh.area * np.abs(h) ** 2)
    n, basis, nodes = mesh.np, mesh.basis, mesh.nodes.reshape(mesh.elements, mesh.np, mesh.np)
    jac = mesh.jacobian.reshape(mesh.elements, n, n)
    b = basis.reshape(mesh.elements, n, n, 2, 2)
    eu, ev = u[nodes], v[nodes]
    covariant = [b[..., k, 0] * eu + b[..., k, 1] * ev for k in range(2)]
    inverse = np.linalg.inv(b)
    flux = [jac * (inverse[..., 0, k] * eu + inverse[..., 1, k] * ev) for k in range(2)]
    along = (
        lambda f: np.einsum("ij,ejk->eik", mesh.derivative, f),
        lambda f: np.einsum("kj,eij->eik", mesh.derivative, f),
    )
    divergence = (along[0](flux[0]) + along[1](flux[1])) / jac
    curl = (along[0](covariant[1]) - along[1](covariant[0])) / jac
    mass = mesh.quadrature.reshape(1, n, n) * jac
    shares = []
    for field in (divergence, curl):
        mean = np.zeros(mesh.size, dtype=complex)
        np.add.at(mean, nodes.ravel(), (mass * field).ravel())
        jump = field - (mean / mesh.area)[nodes]
        shares.append(np.sum(mass * np.abs(jump) ** 2) / np.sum(mass * np.abs(field) ** 2))
    legendre = np.linalg.inv(np.polynomial.legendre.legvander(mesh.gll_points, n - 1))
    total, last = 0.0, 0.0
    norm = 2.0 / (2.0 * np.arange(n) + 1.0)
    for each in covariant:
        energy = np.abs(np.einsum("ai,eij,bj->eab", legendre, each, legendre)) ** 2
        energy = (energy * norm[:, None] * norm).sum(axis=0)
        total, last = total + energy.sum(), last + energy[-1].sum() + energy[:-1, -1].sum()
    corner = np.bincount(mesh.nodes.ravel(), minlength=mesh.size) == 3
    at_corners = speed2[corner].mean() / (np.sum(mesh.area * speed2) / mesh.area.sum())
    return [
        f"{value.real * DAY:.3f}", f"{abs(value.imag):.2e}",
        f"{kinetic / (kinetic + potential):.3f}",
        *(f"{share:.3f}" for share in shares), f"{last / total:.2f}", f"{at_corners:.0f} ×",
    ]  # fmt: skip


def runs() -> Section:
    """Errors of williamson2 over a hundred days."""
    rows = []
    for ne, np_ in ((4, 4), (4, 5), (4, 6), (4, 8), (8, 4)):
        for called in ("none", "c = 0.01", "∇⁴, default"):
            rows.append([f"ne{ne} np{np_}", called, *errors_by_day(ne, np_, RIVALS[called])])
    return Section(
        "Errors over a hundred days",
        "l2(v) of williamson2 with α = 1, rk4 at its automatic step. A dash: the run had stopped.",
        ["mesh", "dissipation", *(f"day {day}" for day in (10, 30, 50, 100))],
        rows,
    )


def errors_by_day(ne: int, np_: int, effects: dict[str, float]) -> list[str]:
    sim = Simulation("williamson2", alpha=1.0, ne=ne, np=np_, stepper="rk4", effects=effects)
    cells = []
    for day in (10, 30, 50, 100):
        try:
            done = sim.run(days=day)
            cells.append(f"{done['l2_v']:.1e}" if done.status == "completed" else "–")
        except RunFailed:
            cells.append("–")
        if cells[-1] == "–":
            return [*cells, *["–"] * (4 - len(cells))]
    return cells


STRENGTHS = (0.0, 0.003, 0.01, 0.03, 0.1)
RIVALS = {
    **{f"c = {c:g}" if c else "none": {"edge-penalty.c": c} if c else {} for c in STRENGTHS},
    "∇⁴, default": {"hyperviscosity.nu": "default"},
    "∇⁴, default/30": {"hyperviscosity.nu": 1.0 / 30.0},
}
"""Dissipation to compare; a number for nu is a multiple of the default of the mesh."""
AGAINST = {
    "williamson5, day 15": ("williamson5", {}, 15, "williamson5_day15"),
    "williamson6, day 7": ("williamson6", {}, 7, "williamson6_day7"),
    "williamson6, day 14": ("williamson6", {}, 14, "williamson6_day14"),
    "galewsky, day 6": ("galewsky", {}, 6, "galewsky_day6"),
    "galewsky with viscosity, day 6": (
        "galewsky", {"viscosity.nu": 1e5}, 6, "galewsky_viscous_day6",
    ),
}  # fmt: skip


def strength() -> Section:
    """Errors of standard scenes by the strength of the dissipation."""
    rows = []
    for label, (scene, given, day, reference) in AGAINST.items():
        for ne, np_ in ((5, 4), (8, 4), (16, 4), (4, 8), (8, 8), (12, 8)):
            pairs = [
                against(scene, ne, np_, day, reference, given | with_default(effects, ne, np_))
                for effects in RIVALS.values()
            ]
            for name, column in (("height", 0), ("vorticity", 1)):
                cells = [f"{pair[column]:.2e}" if pair else "–" for pair in pairs]
                rows.append([f"{label}, {name}", f"ne{ne} np{np_}", *cells])
    return Section(
        "Errors of standard scenes",
        "l2 of the free surface and of vorticity against the spectral references that come with"
        " the package; rk4 at its automatic step. A dash: the run stopped.",
        ["scene, field", "mesh", *RIVALS],
        rows,
    )


def with_default(effects: dict[str, object], ne: int, np_: int) -> dict[str, object]:
    nu = effects.get("hyperviscosity.nu")
    if isinstance(nu, float):
        return {"hyperviscosity.nu": nu * hyperviscosity_default(ne, np_)}
    return effects


def against(
    scene: str, ne: int, np_: int, day: int, reference: str, effects: dict[str, object]
) -> tuple[float, float] | None:
    """Return l2 of the surface and of vorticity; None where the run stopped."""
    sim = Simulation(scene, ne=ne, np=np_, stepper="rk4", effects=effects)
    try:
        if sim.run(days=day).status != "completed":
            return None
    except RunFailed:
        return None
    grid = OnGrid(Reference(SHIPPED / f"{reference}.nc"), sim.mesh)
    errors = by_name(grid.errors(sim.snapshot.all_fields, "surface"))
    return errors["l2_h"], errors["l2_vorticity"]


def early_jet() -> Section:
    """How far the balanced jet of galewsky leaves its balance on a coarse mesh in a day."""
    rows = []
    for ne, np_ in ((5, 4), (8, 4), (5, 6)):
        cells = []
        for effects in RIVALS.values():
            balanced = get_scene("galewsky", perturbed=False)
            effects = with_default(effects, ne, np_)
            sim = Simulation(balanced, ne=ne, np=np_, stepper="rk4", effects=effects)
            start = sim.state.h.values
            sim.run(days=1)
            change = sim.state.h.values - start
            cells.append(f"{np.sqrt(np.average(change**2, weights=sim.mesh.area)):.1f}")
        rows.append([f"ne{ne} np{np_}", *cells])
    return Section(
        "The balanced jet of galewsky after a day",
        "Root mean square of h − h(0) [m] without the initial perturbation: zero for exact flow.",
        ["mesh", *RIVALS],
        rows,
    )


SECTIONS = {
    "spectrum": spectrum, "dependence": dependence, "modes": modes, "runs": runs,
    "strength": strength, "jet": early_jet,
}  # fmt: skip


main = command("off_axis", HEAD, SECTIONS)

if __name__ == "__main__":
    with threadpool_limits(1):
        typer.run(main)
