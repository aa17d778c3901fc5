"""Verification: errors, orders and invariants of every scene, each held against a bound."""

from swe_sphere.studies.verify.case import Case, Level, Published
from swe_sphere.studies.verify.families import all_cases, choose, families
from swe_sphere.studies.verify.page import page
from swe_sphere.studies.verify.verdict import Row, verify

__all__ = [
    "Case", "Level", "Published", "Row", "all_cases", "choose", "families", "page", "verify",
]  # fmt: skip
