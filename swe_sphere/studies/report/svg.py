"""Figures as SVG: standing alone, and inside a page with the colours of the page."""

from __future__ import annotations

import re
from collections.abc import Mapping
from html import escape
from io import StringIO
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["FAINT", "GRID", "INK", "PAPER", "STYLE", "inline", "save_svg"]

INK, FAINT, GRID, PAPER = "#1b1f24", "#6e7781", "#dfe3e8", "#fefefe"
"""Colours of a figure that follow the page, light or dark; no stepper has one of these."""
THEME = {INK: "var(--ink)", FAINT: "var(--faint)", GRID: "var(--grid)", PAPER: "var(--paper)"}

STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.edgecolor": FAINT,
    "axes.facecolor": PAPER,
    "figure.facecolor": PAPER,
    "xtick.color": FAINT,
    "ytick.color": FAINT,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
}
FONTS = "font-family:'DejaVu Sans',Verdana,system-ui,sans-serif"


def save_svg(figure: Figure, name: str) -> str:
    """The text of an SVG file; the same figure gives the same bytes."""
    import matplotlib as mpl

    out = StringIO()
    nothing = dict.fromkeys(("Date", "Creator", "Format", "Type"))
    with mpl.rc_context({"svg.hashsalt": name, "svg.fonttype": "none"}):
        figure.savefig(out, format="svg", metadata=nothing)
    return _shortened(out.getvalue()) + "\n"


def _shortened(text: str) -> str:
    """An SVG file without what changes nothing to the eye."""
    text = re.sub(r"<metadata>.*?</metadata>|<!DOCTYPE.*?>|<!--.*?-->", "", text, flags=re.DOTALL)
    text = re.sub(r"(\d\.\d{2})\d{3,}", r"\1", text)  # hundredths of a point are fine enough
    text = re.sub(r"\s*font-family: [^;\"]*;?", "", text)
    text = text.replace("</style>", f" text{{{FONTS}}}</style>")
    text = re.sub(r">\s+<", "><", re.sub(r"\s*\n\s*", " ", text))
    meant = set(re.findall(r"#([\w.-]+)[\")]", text))
    return re.sub(r' id="([^"]*)"', lambda m: m[0] if m[1] in meant else "", text)


def inline(svg: str, name: str, title: str, tips: Mapping[str, str]) -> str:
    """An SVG file's text as an element of a page that can hold others.

    name: made part of every id, so that ids differ between figures.
    title: read out in place of the picture.  tips: the target of a link -> what to show over it.
    """
    text = svg[svg.index("<svg") :]
    text = re.sub(r"<style.*?</style>", "", text)  # the page has it
    text = re.sub(r'\s+xmlns(?::\w+)?="[^"]*"', "", text)
    text = text.replace('<use xlink:href="#', f'<use href="#{name}-')
    text = text.replace("url(#", f"url(#{name}-").replace(' id="', f' id="{name}-')
    text = re.sub(r'<a xlink:href="(#[^"]*)"[^>]*>', lambda m: _link(m[1], tips), text)
    for colour, variable in THEME.items():
        text = text.replace(colour, variable)
    size = re.search(r'viewBox="[^"]*"', text)
    head = f'<svg {size[0] if size else ""} role="img" aria-label="{escape(title)}">'
    return re.sub(r"<svg[^>]*>", lambda _: head, text, count=1)


def _link(target: str, tips: Mapping[str, str]) -> str:
    tip = tips.get(target.removeprefix("#"))
    return f'<a href="{target}">' + (f"<title>{escape(tip)}</title>" if tip else "")
