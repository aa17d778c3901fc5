"""Numbers as they are read: short, with their units."""

from __future__ import annotations

import math

NOTHING = "–"


def number(value: float, digits: int = 3) -> str:
    """A number with a few significant digits, without an exponent where it can be read so."""
    if not math.isfinite(value):
        return NOTHING
    if value == 0.0 or 1e-3 <= abs(value) < 1e6:
        places = max(0, digits - 1 - math.floor(math.log10(abs(value)))) if value else 0
        return minus(f"{value:.{places}f}")
    return error(value, digits - 1)


def error(value: float, places: int = 1) -> str:
    """A number with an exponent: 3.4e-5."""
    if not math.isfinite(value):
        return NOTHING
    if value == 0.0:
        return "0"
    mantissa, exponent = f"{value:.{places}e}".split("e")
    return minus(f"{mantissa}e{int(exponent)}") if int(exponent) else minus(mantissa)


def signed(value: float) -> str:
    """A number with an exponent, and with its sign also where it is positive."""
    return f"+{error(value)}" if value > 0.0 else error(value)


def level(value: float) -> str:
    """A round error level: 1e-3, 3e-4."""
    return error(value, 0)


def minus(text: str) -> str:
    """With a minus sign that is not a hyphen in front, where there is one."""
    return f"−{text[1:]}" if text.startswith("-") else text


def seconds(value: float) -> str:
    """A duration that was measured: two or three digits."""
    return f"{number(value, 2 if value < 10.0 else 3)} s" if math.isfinite(value) else NOTHING


def step(value: float) -> str:
    """A time step, to a second or to four digits."""
    return f"{value:.0f} s" if value >= 1000.0 else f"{value:.4g} s"


def times(value: float) -> str:
    """A multiple: 29×."""
    return f"{number(value, 2)}×" if math.isfinite(value) else NOTHING


def percent(value: float) -> str:
    """A part of one in percent, two digits."""
    return f"{number(100.0 * value, 2)} %" if math.isfinite(value) else NOTHING


def count(value: float) -> str:
    """A whole number."""
    return f"{value:.0f}" if math.isfinite(value) else NOTHING


def bytes_text(value: float) -> str:
    """Memory in MiB."""
    return f"{value / 2**20:.0f} MiB" if math.isfinite(value) else NOTHING
