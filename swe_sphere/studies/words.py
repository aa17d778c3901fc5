"""Short texts of numbers, with their units."""

import math

NOTHING = "–"


def number(value: float, digits: int = 3, unit: str = "") -> str:
    """Return a number with some significant digits, without an exponent if it stays readable."""
    if not math.isfinite(value):
        return NOTHING
    if value == 0.0 or 1e-3 <= abs(value) < 1e6:
        places = max(0, digits - 1 - math.floor(math.log10(abs(value)))) if value else 0
        return f"{value:.{places}f}{unit}".replace("-", "−")
    return error(value, digits - 1) + unit


def error(value: float, places: int = 1) -> str:
    """Return a number with an exponent: 3.4e-5."""
    if not math.isfinite(value):
        return NOTHING
    if value == 0.0:
        return "0"
    mantissa, exponent = f"{value:.{places}e}".split("e")
    mantissa = mantissa.replace("-", "−")
    return f"{mantissa}e{int(exponent)}" if int(exponent) else mantissa


def level(value: float) -> str:
    """Return a target error with up to three digits: 1e-3, 2.5e-4."""
    return error(value, next((n for n in range(2) if float(f"{value:.{n}e}") == value), 2))


def step(value: float) -> str:
    """Return a time step, to a second or to four digits."""
    return f"{value:.0f} s" if value >= 1000.0 else f"{value:.4g} s"


def seconds(value: float) -> str:
    """Return a measured duration with two or three digits."""
    return number(value, 2 if value < 10.0 else 3, " s")


def times(value: float) -> str:
    """Return a multiple: 29×."""
    return number(value, 2, "×")


def percent(value: float) -> str:
    """Return a fraction of one in percent, two digits."""
    return number(100.0 * value, 2, " %")


def count(value: float) -> str:
    """Return a whole number."""
    return f"{value:.0f}" if math.isfinite(value) else NOTHING
