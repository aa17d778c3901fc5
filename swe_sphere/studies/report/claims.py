"""What others claim of long steps, held against the runs of a sweep: a line a scene and stepper."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from swe_sphere.studies.report import words
from swe_sphere.studies.report.content import OneMesh, Section
from swe_sphere.studies.report.palette import curves
from swe_sphere.studies.report.rows import Metric, Row
from swe_sphere.studies.report.statistics import largest_step, threshold

FIELDS = ("h", "vorticity")
HEADS = (
    "scene", "stepper", "claimed", "l2(h)", "l2(vorticity)", "confirmed", "longest step tried",
)  # fmt: skip


@dataclass(frozen=True)
class Claim:
    """That steps of so many gravity-wave and advective limits lose no accuracy."""

    gravity: float
    advective: float
    why: str = ""
    """Markdown: what the runs say to it."""

    @property
    def text(self) -> str:
        """Both numbers."""
        return f"{words.times(self.gravity)}, {words.times(self.advective)}"

    def met(self, row: Row | None) -> bool:
        """Whether a longest step without loss is as long as claimed."""
        return row is not None and (
            row.gravity_multiple >= self.gravity and row.advective_multiple >= self.advective
        )


def verdicts(
    sections: Sequence[Section], claims: Mapping[str, Claim]
) -> tuple[Sequence[str], list[list[str]]]:
    """Heads and lines of a table: the longest steps without loss, and whether that is as claimed.

    Of steppers that took steps of as many gravity-wave limits as are claimed.
    """
    lines = [
        line
        for section in sections
        if section.title in claims
        for mesh in section.meshes
        for line in _of_mesh(mesh, claims[section.title])
    ]
    return HEADS, lines


def _of_mesh(mesh: OneMesh, claim: Claim) -> Iterator[list[str]]:
    found = [m for m in (metric for metric, _ in mesh.errors) if m.kind == "total"]
    shown = [metric for field in FIELDS for metric in found if metric.field == field]
    for curve in curves([row for row in mesh.rows if row.compared]):
        longest = max(curve.rows, key=lambda row: row.dt)
        if longest.gravity_multiple < claim.gravity:
            continue
        steps = [_lossless(mesh.rows, curve.rows, metric) for metric in shown]
        told = {True: "yes", False: "no"}
        met = [claim.met(row) for row in steps]
        if len(set(met)) == 1:
            verdict = told[met[0]]
        else:
            verdict = ", ".join(
                f"{told[yes]} ({metric.symbol})" for yes, metric in zip(met, shown, strict=True)
            )
        cells = [_multiples(row) for row in steps]
        yield [mesh.title, curve.label, claim.text, *cells, verdict, _multiples(longest)]


def _lossless(rows: Sequence[Row], mine: Sequence[Row], metric: Metric) -> Row | None:
    bound = threshold(rows, metric)
    return None if bound is None else largest_step(mine, metric, bound.value)


def _multiples(row: Row | None) -> str:
    if row is None:
        return "none"
    several = words.times(row.gravity_multiple), words.times(row.advective_multiple)
    return f"{words.step(row.dt)} ({', '.join(several)})"
