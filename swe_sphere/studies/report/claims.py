"""What others claim of long steps, held against the runs of a sweep: a line a scene and stepper."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from swe_sphere.studies.report import words
from swe_sphere.studies.report.content import OneMesh, Section
from swe_sphere.studies.report.palette import curves
from swe_sphere.studies.report.rows import Row
from swe_sphere.studies.report.statistics import largest_step
from swe_sphere.studies.report.table import step_text

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


def verdicts(sections: Sequence[Section], claims: Mapping[str, Claim]) -> list[list[str]]:
    """Lines under `HEADS`: the longest steps without loss, and whether that is as claimed.

    Of steppers that took steps of as many gravity-wave limits as are claimed.
    """
    return [
        line
        for section in sections
        if section.title in claims
        for mesh in section.meshes
        for line in _of_mesh(mesh, claims[section.title])
    ]


def _of_mesh(mesh: OneMesh, claim: Claim) -> Iterator[list[str]]:
    found = [metric for metric, _ in mesh.errors if metric.kind == "total"]
    shown = [metric for field in FIELDS for metric in found if metric.field == field]
    bounds = mesh.losses.limits if mesh.losses else {}
    for curve in curves([row for row in mesh.rows if row.compared]):
        longest = max(curve.rows, key=lambda row: row.dt)
        if longest.gravity_multiple < claim.gravity:
            continue
        steps = [
            largest_step(curve.rows, m, bounds[m].value) if m in bounds else None for m in shown
        ]
        met = ["yes" if claim.met(row) else "no" for row in steps]
        each = [f"{answer} ({m.symbol})" for answer, m in zip(met, shown, strict=True)]
        verdict = met[0] if len({*met}) == 1 else ", ".join(each)
        cells = [step_text(row, numbered=False) for row in (*steps, longest)]
        yield [mesh.title, curve.label, claim.text, *cells[:-1], verdict, cells[-1]]
