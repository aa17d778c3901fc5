"""Verification: errors, orders and invariants of every scene, each held against a bound."""

from swe_sphere.studies.verify.case import Case, Figure, Rung, Setting
from swe_sphere.studies.verify.cases import CASES, FAMILIES, choose
from swe_sphere.studies.verify.page import page
from swe_sphere.studies.verify.verdict import Check, Row, verify

__all__ = [
    "CASES", "FAMILIES", "Case", "Check", "Figure", "Row", "Rung", "Setting", "choose", "page",
    "verify",
]  # fmt: skip
