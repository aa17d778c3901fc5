"""Numbers that tell how tracers are doing: their masses, extremes and errors.

Tracers are known here by their names alone; of each the fields hold the mass hq_NAME (N,) [m] and
the mixing ratio q_NAME (N,).
"""

from collections.abc import Iterable, Mapping

from swe_sphere.arrays import Array
from swe_sphere.io.norms import area_mean, norms
from swe_sphere.mesh import Mesh


def tracer_masses(
    mesh: Mesh, fields: Mapping[str, Array], names: Iterable[str]
) -> dict[str, float]:
    """Area mean of hq [m] by tracer."""
    return {name: area_mean(mesh.area, fields[f"hq_{name}"]) for name in names}


def tracer_numbers(
    mesh: Mesh, fields: Mapping[str, Array], start: Mapping[str, float]
) -> dict[str, float]:
    """Of each tracer mass_drift_q_NAME, min_q_NAME and max_q_NAME.

    start: what `tracer_masses` returned at the start.  The drift is relative, NaN where the mass
    of the start is zero.
    """
    numbers = {}
    for name, mass in tracer_masses(mesh, fields, start).items():
        first, q = start[name], fields[f"q_{name}"]
        numbers[f"mass_drift_q_{name}"] = (mass - first) / first if first else float("nan")
        numbers[f"min_q_{name}"], numbers[f"max_q_{name}"] = float(q.min()), float(q.max())
    return numbers


def tracer_errors(
    mesh: Mesh, fields: Mapping[str, Array], exact: Mapping[str, Array]
) -> dict[str, float]:
    """Of each tracer l1_q_NAME, l2_q_NAME and linf_q_NAME against exact mixing ratios (N,).

    NaN where the exact ones are: at times at which they are not known.
    """
    return {
        f"{norm}_q_{name}": value
        for name, q in exact.items()
        for norm, value in norms(mesh.area, fields[f"q_{name}"], q).items()
    }
