"""Measured numbers as people read them: in tables, on pages, beside pictures.

Files of results have all digits.
"""

from __future__ import annotations

import math

__all__ = ["float_text", "result_number", "signed_number"]

_DECIMALS = 6
_ROUNDED_ZERO = 1e-12
"""Smaller values are what rounding leaves of 0, in SI units."""


def float_text(value: float) -> str:
    """Format a number with four digits, or all digits before the point, in groups of three."""
    if abs(value) < _ROUNDED_ZERO:
        return "0"
    if 1e3 <= abs(value) < 1e12:
        return f"{value:,.0f}"
    return f"{value:.4g}"


def result_number(value: float) -> str:
    """Format a measured value: as `float_text`, but a small one has six decimals and no exponent.

    In a table an error of 3e-24 m is shown as 0; files of results have all digits.

    Args:
        value: The value, in SI units.
    """
    if abs(value) >= 1e-3 or not math.isfinite(value):
        return float_text(float(value))
    text = f"{value:.{_DECIMALS}f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text


def signed_number(value: float) -> str:
    """Format a measured value as `result_number`, with a plus unless it is negative."""
    text = result_number(value)
    return text if text.startswith("-") else f"+{text}"
