"""Growth of computational modes in flows off the cube's axes, and dissipation against it.

python benchmarks/off_axis.py [SECTION ...]"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import lru_cache, partial, reduce

import matplotlib.pyplot as plt
import numpy as np
import scipy
import typer
from sections import PAGES, Section, command
from threadpoolctl import threadpool_limits

from swe_sphere import Simulation
from swe_sphere.equations.effects import (
    EdgePenalty,
    Effect,
    Hyperviscosity,
    hyperviscosity_default,
    penalty_default,
)
from swe_sphere.equations.model import Model
from swe_sphere.equations.scene import Scene
from swe_sphere.errors import RunFailed
from swe_sphere.io.integrals import by_name, norms
from swe_sphere.io.reference_solution import SHIPPED, OnGrid, Reference
from swe_sphere.mesh import Mesh
from swe_sphere.mesh.interpolate import Interpolator
from swe_sphere.pictures.panels import COLOURS
from swe_sphere.planet import DAY, EARTH
from swe_sphere.steppers import STEPPERS
from swe_sphere.testcases import get_scene

ANGLES = (0.0, 0.3, 0.6, 1.0)
"""Tilt of the axis of the flow of williamson2 against that of the planet [radians]."""
SPEED, DEPTH = 2.0 * np.pi * EARTH.radius / (12.0 * DAY), 2.94e4 / EARTH.gravity
C = 0.01
MESHES = tuple((ne, np_) for ne in (2, 3, 4) for np_ in (4, 5, 6, 7, 8))


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
    product = model.jacobian().update(model.initial_state(), 0.0)
    direction, out, size = model.zeros(), model.zeros(), model.size
    unit, columns = np.zeros(size), []
    for k in range(size):
        unit[k] = 1.0
        direction.assign(unit)
        product(direction, out)
        columns.append(scipy.sparse.csc_array(out.numpy()[:, None]))
        unit[k] = 0.0
    return scipy.sparse.hstack(columns, format="csc")


def bases(mesh: Mesh, matrix: scipy.sparse.csc_array) -> list[scipy.sparse.csc_array]:
    """Return orthonormal bases (n, m) of invariant subspaces, as symmetries separate them.

    Solid-body flow and the cube are unchanged by point reflection, and by half a turn about the
    axis of the planet if the flow has the same axis; a stretched mesh has one basis.
    """
    found = [scipy.sparse.eye_array(3 * mesh.size, format="csc")]
    for turn in (-np.eye(3), np.diag([-1.0, -1.0, 1.0])):
        apart, other = scipy.spatial.KDTree(mesh.xyz).query(mesh.xyz @ turn)
        ones, places = np.ones(mesh.size), np.arange(mesh.size)
        swap = scipy.sparse.csc_array((ones, (places, other)), shape=(mesh.size, mesh.size))
        frames = np.stack([mesh.east, mesh.north])
        turned = np.einsum("inx,xy,jny->ijn", frames, turn, frames[:, other])
        wind = [[scipy.sparse.diags_array(turned[i, j]) @ swap for j in range(2)] for i in range(2)]
        image = scipy.sparse.block_diag([scipy.sparse.block_array(wind), swap], format="csc")
        off = abs(image @ matrix - matrix @ image).max() / abs(matrix).max()
        if apart.max() < 1e-9 and off < 1e-9:
            found = [half for basis in found for half in halves(basis, image)]
    return found


def halves(
    basis: scipy.sparse.csc_array, image: scipy.sparse.csc_array
) -> Iterator[scipy.sparse.csc_array]:
    """Yield bases of the vectors that an involution leaves unchanged, and of those it negates."""
    inner = (basis.T @ image @ basis).tocsr()
    inner.data[abs(inner.data) < 1e-12] = 0.0
    inner.eliminate_zeros()
    _, label = scipy.sparse.csgraph.connected_components(inner)
    rows, columns, values, signs = [], [], [], []
    for group in np.split(np.argsort(label, kind="stable"), np.cumsum(np.bincount(label))[:-1]):
        sign, vectors = np.linalg.eigh(inner[group][:, group].toarray())
        for k, vector in zip(sign, vectors.T, strict=True):
            rows.extend(group)
            columns.extend([len(signs)] * group.size)
            values.extend(vector)
            signs.append(k)
    vectors = scipy.sparse.csc_array((values, (rows, columns)), shape=inner.shape)
    for sign in (1.0, -1.0):
        yield basis @ vectors[:, np.flatnonzero(np.array(signs) * sign > 0.0)]


def blocks(mesh: Mesh, scene: Scene) -> Iterator[tuple[scipy.sparse.csc_array, ...]]:
    """Yield parts of the Jacobian [s-1] that share no eigenvectors, each with its basis."""
    matrix = jacobian(mesh, scene)
    for basis in bases(mesh, matrix):
        yield (basis.T @ matrix @ basis).tocsc(), basis


def eigenvalues(mesh: Mesh, scene: Scene) -> np.ndarray:
    """Return all eigenvalues [s-1] of the tendency linearised about the initial flow."""
    return np.concatenate([np.linalg.eigvals(x.toarray()) for x, _ in blocks(mesh, scene)])


def fastest(mesh: Mesh, scene: Scene) -> tuple[complex, np.ndarray]:
    """Return the eigenvalue of the largest real part [s-1] among all, and its vector."""
    best, small, basis = -np.inf + 0j, scipy.sparse.csr_array((0, 0)), np.empty(0)
    for block, each in blocks(mesh, scene):
        values = np.linalg.eigvals(block.toarray())
        if values.real.max() > best.real:
            best, small, basis = complex(values[np.argmax(values.real)]), block, each
    near = best + 1e-7 * abs(best)
    unit = scipy.sparse.eye_array(small.shape[0], format="csc")
    solve = scipy.sparse.linalg.splu((small - near * unit).tocsc()).solve
    vector = np.random.default_rng(1).normal(size=small.shape[0]).astype(complex)
    for _ in range(3):
        vector = solve(vector)
        vector /= np.linalg.norm(vector)
    return best, basis @ vector


@lru_cache
def of_williamson2(ne: int, np_: int, alpha: float) -> tuple[complex, np.ndarray]:
    """Return the fastest mode about williamson2 without dissipation."""
    return fastest(Mesh.build(ne, np_), get_scene("williamson2", alpha=alpha))


def rates(mesh: Mesh, *scenes: Scene) -> list[str]:
    """Return the largest growth rates [1/day] about the initial flows of scenes."""
    return [per_day(max(eigenvalues(mesh, scene).real)) for scene in scenes]


def per_day(rate: float) -> str:
    """Return the growth rate [s-1] as text in units of 1/day."""
    rate *= DAY
    return f"{rate:.3f}" if abs(rate) > 5e-4 else "0" if abs(rate) < 1e-7 else f"{rate:.0e}"


def growth() -> list[list[str]]:
    """Return rows of growth rates about williamson2 by mesh, edge penalty and angle."""
    rows = []
    for ne, np_ in MESHES:
        for called, effects in (("none", ()), ("c₀", (EdgePenalty(),))):
            scenes = [damped(get_scene("williamson2", alpha=alpha), *effects) for alpha in ANGLES]
            rows.append([f"ne{ne} np{np_}", called, *rates(Mesh.build(ne, np_), *scenes)])
    return rows


def damped(scene: Scene, *effects: Effect) -> Scene:
    """Return a scene with more effects."""
    return reduce(Scene.with_effect, effects, scene)


def spectrum() -> Section:
    """Largest growth rates by mesh and angle, from all eigenvalues."""
    return Section(
        "Growth rates of the discrete equations",
        "Largest real part [1/day] among all eigenvalues of the tendency linearised about the exact"
        " flow of williamson2 whose axis is tilted by α [rad]; 0 is below 1e-7, and c₀ the default"
        " strength of the edge penalty. All modes of the continuous equations are neutral."
        " Eigenvalues are those of dense blocks, which symmetries of mesh and flow separate.",
        ["mesh", "edge penalty", *(f"α = {alpha:g}" for alpha in ANGLES)],
        growth(),
    )


def dependence() -> Section:
    """Growth rates by wind speed, depth and stretching."""
    meshes = Mesh.build(3, 4), Mesh.build(2, 6)
    flows = [(5.0, DEPTH), (20.0, DEPTH), (SPEED, DEPTH), (SPEED, 10000.0), (60.0, 10000.0)]
    flows += [(5.0, 250.0), (5.0, 1000.0)]
    cases = [
        (f"{speed:.3g} m/s, {depth:.0f} m", meshes, tilted_flow(1.0, speed, depth))
        for speed, depth in flows
    ]
    finer = tuple(Mesh.build(m.ne, m.np, stretch=3.0, centre=(40.0, 23.0)) for m in meshes)
    cases.append(("williamson2, stretched 3 times", finer, get_scene("williamson2", alpha=1.0)))
    rows = [
        [
            called,
            *(rate for mesh in of for rate in rates(mesh, scene, damped(scene, EdgePenalty(C)))),
        ]
        for called, of, scene in cases
    ]
    return Section(
        "Dependence on wind, depth and stretching",
        "Largest real part [1/day] for α = 1, by the wind speed and the depth at the equator of the"
        " flow; the stretched meshes carry williamson2 itself.",
        ["flow", "ne3 np4", "ne3 np4, c = 0.01", "ne2 np6", "ne2 np6, c = 0.01"],
        rows,
    )


PARTS = (0.0, 1.0 / 300.0, 1.0 / 100.0, 1.0 / 30.0, 1.0)


def diffusion() -> Section:
    """Growth rates by the coefficient of hyperviscosity."""
    rows = []
    for ne, np_ in ((3, 4), (2, 6)):
        scene, whole = get_scene("williamson2", alpha=1.0), 30.0 * hyperviscosity_default(ne, np_)
        scenes = [damped(scene, Hyperviscosity(whole * part)) if part else scene for part in PARTS]
        rows.append([f"ne{ne} np{np_}", f"{whole:.2e}", *rates(Mesh.build(ne, np_), *scenes)])
    return Section(
        "What hyperviscosity hides",
        "Largest real part [1/day] for α = 1, by the coefficient of ∇⁴ as a part of ν₀ ="
        " 10¹⁵ m⁴/s (30/ne)^3.32 at np 4, the rule of CAM-SE, at equal node spacing for other np.",
        ["mesh", "ν₀ [m⁴/s]", "none", *(f"ν₀/{1 / part:.0f}" for part in PARTS[1:-1]), "ν₀"],
        rows,
    )


def modes() -> Section:
    """Return frequencies and shapes of the fastest growing modes."""
    _draw_mode(Mesh.build(4, 4), of_williamson2(4, 4, 1.0)[1])
    rows = []
    for ne, np_, alpha in ((3, 4, 1.0), (4, 4, 1.0), (3, 5, 1.0), (2, 6, 1.0), (3, 4, 0.0)):
        portrait = _portrait(Mesh.build(ne, np_), *of_williamson2(ne, np_, alpha))
        rows.append([f"ne{ne} np{np_}", f"{alpha:g}", *portrait])
    return Section(
        "The fastest modes",
        "Share of kinetic energy; share of ∫δ² and ∫ζ² that is jump between elements; share of"
        " the wind in the last Legendre mode along either coordinate; |v|² at the corners of the"
        " cube over its mean. The map of the page is that of ne4 np4 at α = 1; lines are the edges"
        " of elements, dots the corners of the cube.",
        ["mesh", "α", "growth [1/day]", "frequency [s⁻¹]", "kinetic", "jump of δ", "jump of ζ",
         "last mode", "cube corners"],
        rows,
    )  # fmt: skip


def _draw_mode(mesh: Mesh, vector: np.ndarray) -> None:
    """Draw |v|² of a mode on the plane of longitude and latitude."""
    u, v, _ = vector.reshape(3, -1)
    square = np.abs(u) ** 2 + np.abs(v) ** 2
    lon, lat = np.arange(-180.0, 180.5, 1.0), np.arange(-90.0, 90.5, 1.0)
    points = np.stack(np.meshgrid(np.radians(lon), np.radians(lat)), -1).reshape(-1, 2)
    values = Interpolator(mesh, *points.T)(square).reshape(lat.size, lon.size)
    figure, axes = plt.subplots(figsize=(7.0, 3.6), layout="constrained")
    image = axes.pcolormesh(
        lon, lat, values / square.max(), cmap="magma_r", vmin=0.0, rasterized=True
    )
    axes.set(xlabel="longitude [°]", ylabel="latitude [°]", xticks=range(-180, 181, 45))
    figure.colorbar(image, label="|v|² over its largest value")
    nodes = mesh.nodes.reshape(mesh.elements, mesh.np, mesh.np)
    x, y = np.degrees((mesh.lon + np.pi) % (2.0 * np.pi) - np.pi), np.degrees(mesh.lat)
    for line in [*nodes[:, 0], *nodes[:, -1], *nodes[:, :, 0], *nodes[:, :, -1]]:
        if np.ptp(x[line]) < 180.0 and np.abs(y[line]).max() < 89.9:
            axes.plot(x[line], y[line], color="grey", linewidth=0.5)
    corner = np.bincount(mesh.nodes.ravel(), minlength=mesh.size) == 3
    axes.plot(x[corner], y[corner], "o", color="#0072B2", markersize=4)
    figure.savefig(PAGES / "off_axis_mode.png", dpi=130)
    plt.close(figure)


def _portrait(mesh: Mesh, value: complex, vector: np.ndarray) -> list[str]:
    scene = get_scene("williamson2")
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


DAYS = (10, 30, 50, 100)


RIVALS: dict[str, dict[str, object]] = {
    "none": {},
    **{called: {"edge-penalty.c": factor} for called, factor in
       (("c₀/3", 1 / 3), ("c₀", 1.0), ("3 c₀", 3.0), ("10 c₀", 10.0))},
    **{called: {"hyperviscosity.factor": factor} for called, factor in
       (("∇⁴, ν₀/30", 1.0), ("∇⁴, ν₀/10", 3.0), ("∇⁴, ν₀", 30.0))},
}  # fmt: skip
"""Dissipation to compare; the number for c is a multiple of the default c₀ of np."""
RECOMMENDED = ("none", "c₀", "∇⁴, ν₀/30", "∇⁴, ν₀/10")
"""Dissipation that is also run on the largest mesh."""


def rivals(ne: int, np_: int, names: Iterable[str] = RIVALS) -> Iterator[dict[str, object]]:
    """Yield the effects of the named dissipation on a mesh."""
    for name in names:
        effects = dict(RIVALS[name])
        if "edge-penalty.c" in effects:
            effects["edge-penalty.c"] *= penalty_default(np_)
        yield effects


def runs() -> Section:
    """Errors of williamson2 over a hundred days."""
    rows, curves, names = [], {}, ("none", "c₀", "∇⁴, ν₀")
    for ne, np_ in ((4, 4), (4, 5), (4, 6), (4, 7), (4, 8), (8, 4)):
        for called, effects in zip(names, rivals(ne, np_, names), strict=True):
            sim = Simulation(
                "williamson2", alpha=1.0, ne=ne, np=np_, stepper="rk4", effects=effects
            )
            curves[f"ne{ne} np{np_}", called] = curve = errors_by_day(sim, range(5, 101, 5))
            rows.append([f"ne{ne} np{np_}", called, *at_days(curve)])
    _draw_errors(curves)
    return Section(
        "Errors over a hundred days",
        "l2(v) of williamson2 with α = 1, rk4 at its automatic step; c₀ = 0.16/np² is the default"
        " strength of the edge penalty, and ν₀ the coefficient of CAM-SE, 10¹⁵ m⁴/s (30/ne)^3.32 at"
        " np 4. A dash: the run had stopped.",
        ["mesh", "dissipation", *(f"day {day}" for day in DAYS)],
        rows,
    )


def at_days(curve: dict[int, float]) -> list[str]:
    """Return the errors at DAYS, a dash where there is none."""
    return [f"{curve[day]:.1e}" if day in curve else "–" for day in DAYS]


def errors_by_day(sim: Simulation, days: Iterable[int]) -> dict[int, float]:
    """Return l2(v) at some days, until the run stops."""
    curve = {}
    for day in days:
        try:
            done = sim.run(days=day)
        except RunFailed:
            break
        if done.status != "completed":
            break
        curve[day] = done["l2_v"]
    return curve


def _draw_errors(curves: dict[tuple[str, str], dict[int, float]]) -> None:
    """Draw errors against time by mesh and dissipation."""
    figure, axes = plt.subplots(figsize=(7.0, 4.0), layout="constrained")
    styles = {"none": "-", "c₀": "--", "∇⁴, ν₀": ":"}
    colours = dict(zip(dict.fromkeys(mesh for mesh, _ in curves), COLOURS, strict=False))
    for (mesh, called), curve in curves.items():
        axes.semilogy(curve.keys(), curve.values(), styles[called], color=colours[mesh])
    for mesh, colour in colours.items():
        axes.plot([], [], color=colour, label=mesh)
    for called, style in styles.items():
        axes.plot([], [], style, color="grey", label=called)
    axes.set(xlabel="day", ylabel="l2(v)", xlim=(0, 100))
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
    figure.savefig(PAGES / "off_axis_errors.svg")
    plt.close(figure)


def symmetric() -> Section:
    """Errors along axes of symmetry of the cube, with and without a disturbance."""
    rows = []
    for alpha, called in ((0.0, "0"), (np.pi / 4.0, "π/4"), (1.0, "1")):
        for size in (0.0, 1e-6, 1e-3):
            sim = Simulation(disturbed(alpha, size), ne=4, np=5, stepper="rk4")
            rows.append([called, f"{size:g}", *at_days(errors_by_day(sim, DAYS))])
    return Section(
        "Why axes of symmetry hide the growth",
        "l2(v) of williamson2 on ne4 np5 without dissipation, rk4 at its automatic step, where the"
        " eastward wind of the initial state is multiplied by 1 + ε r with a random number r in"
        " [−1, 1] at each node. A dash: the run had stopped.",
        ["α", "ε", *(f"day {day}" for day in DAYS)],
        rows,
    )


def disturbed(alpha: float, size: float) -> Scene:
    """Return williamson2 with a random disturbance of the eastward wind of a relative size."""
    scene = get_scene("williamson2", alpha=alpha)

    def initial(lon: np.ndarray, lat: np.ndarray) -> tuple[np.ndarray, ...]:
        u, v, h = scene.initial(lon, lat)
        return u * (1.0 + size * np.random.default_rng(1).uniform(-1.0, 1.0, u.shape)), v, h

    return replace(scene, initial=initial) if size else scene


AGAINST: dict[str, dict[str, tuple[dict[str, object], dict[int, str]]]] = {
    "williamson2": {"williamson2": ({}, {10: ""})},
    "williamson5": {"williamson5": ({}, {15: "williamson5_day15"})},
    "williamson6": {"williamson6": ({}, {7: "williamson6_day7", 14: "williamson6_day14"})},
    "galewsky": {
        "galewsky": ({}, {6: "galewsky_day6"}),
        "galewsky with viscosity": ({"viscosity.nu": 1e5}, {6: "galewsky_viscous_day6"}),
    },
}
"""Variants by scene: effects, and references by day ("" for the exact solution)."""
COMPARED = ((5, 4), (8, 4), (16, 4), (4, 8), (8, 8), (12, 8))


def strength(scene: str) -> Section:
    """Errors of a standard scene by the strength of the dissipation."""
    rows = []
    for ne, np_ in COMPARED:
        names = RECOMMENDED if (ne, np_) == COMPARED[-1] else tuple(RIVALS)
        for label, (given, references) in AGAINST[scene].items():
            columns = {
                name: against(scene, ne, np_, references, given | effects)
                for name, effects in zip(names, rivals(ne, np_, names), strict=True)
            }
            for day in references:
                for which, what in enumerate(("height", "vorticity")):
                    what = "wind" if which and not references[day] else what
                    rows.append([f"ne{ne} np{np_}", f"{label}, day {day}, {what}", *(
                        columns[name].get(day, ("–", "–"))[which] if name in names else ""
                        for name in RIVALS
                    )])  # fmt: skip
    return Section(
        f"Errors of {scene}",
        "l2 against the exact flow with α = 1." if scene == "williamson2" else
        "l2 of the free surface and of vorticity against the spectral references that come with"
        " the package; rk4 at its automatic step. A dash: the run had stopped.",
        ["mesh", "scene, field", *RIVALS],
        rows,
    )  # fmt: skip


def against(
    scene: str, ne: int, np_: int, references: dict[int, str], effects: dict[str, object]
) -> dict[int, tuple[str, str]]:
    """Return l2 of the surface and of vorticity (or wind) by day, until the run stops."""
    tilt = {} if all(references.values()) else {"alpha": 1.0}
    sim = Simulation(scene, ne=ne, np=np_, stepper="rk4", parameters=tilt, effects=effects)
    found = {}
    for day, reference in references.items():
        try:
            if sim.run(days=day).status != "completed":
                break
        except RunFailed:
            break
        errors, second = sim.diagnostics, "l2_v"
        if reference:
            grid, second = OnGrid(Reference(SHIPPED / f"{reference}.nc"), sim.mesh), "l2_vorticity"
            errors = by_name(grid.errors(sim.snapshot.all_fields, "surface"))
        found[day] = f"{errors['l2_h']:.2e}", f"{errors[second]:.2e}"
    return found


def early_jet() -> Section:
    """Departure of the balanced jet of galewsky from its balance in a day, on coarse meshes."""
    rows = []
    for ne, np_ in ((5, 4), (8, 4), (5, 6)):
        cells = []
        for effects in rivals(ne, np_):
            balanced = get_scene("galewsky", perturbed=False)
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


def drifts() -> Section:
    """Measure the drift of conserved quantities by polynomial degree."""
    names = ("mass_drift", "energy_drift", "enstrophy_drift", "angular_momentum_drift")
    rows = []
    for scene in ("williamson6", "galewsky"):
        for np_ in (4, 6, 8, 12):
            sim = Simulation(scene, ne=4, np=np_, stepper="rk4", dt=100.0)
            done = sim.run(days=1)
            rows.append([scene, f"ne4 np{np_}", *(f"{done[name]:.1e}" for name in names)])
    return Section(
        "Drifts by polynomial degree",
        "Relative drifts after a day without dissipation, rk4 in steps of 100 s. The axial angular"
        " momentum is relative to the length of the vector, which is mostly the planet's rotation.",
        ["scene", "mesh", "mass", "energy", "potential enstrophy", "angular momentum"],
        rows,
    )


def price() -> Section:
    """Automatic steps and iterations with the edge penalty over those without."""
    rows = []
    for ne, np_ in ((4, 5), (8, 4), (4, 8)):
        runs = {
            name: [
                Simulation("williamson5", ne=ne, np=np_, stepper=name, effects=effects)
                for effects in rivals(ne, np_, ("none", "c₀"))
            ]
            for name in STEPPERS
        }
        limits = {name: [sim.stable_dt() for sim in sims] for name, sims in runs.items()}
        steps = {name: damped / plain for name, (plain, damped) in limits.items() if plain < np.inf}
        least = min(steps, key=steps.__getitem__)
        counts = [sim.run(days=15)["krylov_iterations"] for sim in runs["bdf2"]]
        rows.append([
            f"ne{ne} np{np_}", f"{steps[least]:.3f} ({least})", f"{len(steps)}",
            *(f"{count:.0f}" for count in counts),
        ])  # fmt: skip
    return Section(
        "Steps and iterations with the edge penalty",
        "Least stability limit of the step with the default penalty over the limit without it,"
        " among all steppers that have a limit; Krylov iterations of bdf2 at its automatic step"
        " over 15 days of williamson5, without and with the penalty.",
        ["mesh", "least ratio", "steppers", "iterations, none", "iterations, c₀"],
        rows,
    )


LONG: dict[str, tuple[int, dict[str, object]]] = {
    "williamson6": (60, {}),
    "galewsky": (20, {}),
    "turbulence": (60, {"hyperviscosity.nu": 0.0}),
}
"""Days and effects of long runs by scene."""


PENALISED = {"edge-penalty.c": "default"}
"""Settings with the default edge penalty."""


def endurance() -> Section:
    """Drift of energy in long runs of every stepper with the edge penalty alone."""
    rows = []
    for name in STEPPERS:
        cells = []
        for scene, (days, given) in LONG.items():
            effects = PENALISED | given
            sim = Simulation(scene, ne=4, np=4, stepper=name, effects=effects)
            try:
                done = sim.run(days=days)
            except RunFailed as error:
                cells.append(str(error))
                continue
            drift = done["energy_drift"] if done.status == "completed" else np.nan
            cells.append(done.status if np.isnan(drift) else f"{drift:.1e}")
        rows.append([f"`{name}`", *cells])
    return Section(
        "Every stepper for 20 and 60 days",
        "Drift of energy at the end of runs with the default edge penalty alone at automatic steps,"
        " ne4 np4; a word instead of a number says why a run stopped early.",
        ["stepper", *(f"{scene}, {days} days" for scene, (days, _) in LONG.items())],
        rows,
    )


def separate() -> Section:
    """Time error of steppers that apply the edge penalty separately or hold it constant."""
    rows = []
    for scene in ("williamson5", "williamson6", "galewsky"):
        without, area = vorticity_at_day_5(scene, "esdirk4", 300.0, {})
        penalised, _ = vorticity_at_day_5(scene, "esdirk4", 300.0, PENALISED)
        change = norms(area, penalised, without)["l2"]
        for name in ("rk4", "forward-backward", "semi-implicit", "tr-bdf2"):
            errors = [
                norms(area, vorticity_at_day_5(scene, name, "auto", effects)[0], exact)["l2"]
                for effects, exact in ((PENALISED, penalised), ({}, without))
            ]
            rows.append([scene, f"`{name}`", *(f"{x:.1e}" for x in (*errors, change))])
    return Section(
        "Time error of the edge penalty",
        "l2 of the vorticity after five days on ne8 np4, relative to `esdirk4` in steps of 300 s,"
        " whose stages contain the penalty; automatic steps. *change*: l2 between the runs of"
        " `esdirk4` with and without the penalty.",
        ["scene", "stepper", "with the penalty", "without", "change"],
        rows,
    )


def vorticity_at_day_5(
    scene: str, stepper: str, dt: float | str, effects: dict[str, object]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the vorticity (N,) at the end of a run, and the nodal areas."""
    sim = Simulation(scene, ne=8, np=4, stepper=stepper, dt=dt, effects=effects)
    sim.run(days=5)
    return sim.state.vorticity.values.ravel(), sim.mesh.area


SECTIONS = {
    "runs": runs, "spectrum": spectrum, "modes": modes, "symmetric": symmetric,
    "dependence": dependence, "diffusion": diffusion, "drifts": drifts, "jet": early_jet,
    "price": price, "endurance": endurance, "separate": separate,
    **{scene: partial(strength, scene) for scene in AGAINST},
}  # fmt: skip


main = command("off_axis", SECTIONS)

if __name__ == "__main__":
    with threadpool_limits(1):
        typer.run(main)
