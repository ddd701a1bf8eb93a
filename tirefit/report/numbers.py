"""Format numbers with as many digits as their uncertainty allows."""

import math
from collections.abc import Sequence
from typing import TypeGuard

_MOST_DIGITS = 7  # no measurement has more, and the rest would be rounding
_TOO_LARGE = 1e7
_TOO_SMALL = 1e-4


def plain_text(text: str) -> str:
    """Text for a figure without mathematics: a ``$`` in a name is printed as ``$``."""
    return text.replace("$", r"\$")


def bracketed(unit: str) -> str:
    """A unit after the name of its quantity: `` [N]``; nothing without a dimension."""
    return f" [{unit}]" if unit not in ("", "-") else ""


def places_of(std: float) -> int:
    """Decimal places that show two significant digits of ``std`` (may be negative)."""
    places = 1 - math.floor(math.log10(std))
    # 0.0996 rounds to 0.10, which has one decimal place less.
    return places - 1 if round(std, places) >= 10 ** (2 - places) else places


def _rounded(value: float, places: int) -> str:
    return f"{round(value, places):.{max(places, 0)}f}"


def _usable(std: float | None) -> TypeGuard[float]:
    return std is not None and math.isfinite(std) and std > 0


def format_number(value: float | None, digits: int = 4) -> str:
    """A number with ``digits`` significant digits; ``-`` for None."""
    if value is None or not math.isfinite(value):
        return "-"
    size = abs(value)
    if size == 0 or (_TOO_SMALL <= size < 10**digits):
        return f"{value:.{digits}g}"
    return f"{value:.0f}" if 1 <= size < _TOO_LARGE else f"{value:.{digits}g}"


def format_estimate(value: float, std: float | None) -> str:
    """``value ± std`` with two digits of the std; only the value without a std."""
    if not math.isfinite(value):
        return "-"
    if not _usable(std):
        return format_number(value)
    if std < abs(value) * 10.0 ** (1 - _MOST_DIGITS):
        return f"{value:.{_MOST_DIGITS}g} ± {std:.2g}"
    size = max(abs(value), std)
    if size >= _TOO_LARGE or size < _TOO_SMALL:
        power = math.floor(math.log10(size))
        scale = 10.0**-power
        inner = format_estimate(value * scale, std * scale)
        return f"({inner})e{power:+03d}"
    places = places_of(std)
    return f"{_rounded(value, places)} ± {_rounded(std, places)}"


def format_interval(ends: Sequence[float | None], std: float | None = None) -> str:
    """``[low, high]`` with the digits of the std; an end that is None is ``..``."""
    low, high = ends
    if low is None and high is None:
        return "-"
    known = [end for end in ends if end is not None]
    if not _usable(std) and low is not None and high is not None:
        std = (high - low) / 4 if 0 < high - low < abs(high + low) / 8 else std
    largest = max(abs(end) for end in known)
    if _usable(std) and std < largest * 10.0 ** (1 - _MOST_DIGITS):
        texts = [".." if e is None else f"{e:.{_MOST_DIGITS}g}" for e in ends]
    elif _usable(std) and _TOO_SMALL <= largest < _TOO_LARGE:
        texts = [".." if end is None else _rounded(end, places_of(std)) for end in ends]
    else:
        texts = [".." if end is None else format_number(end) for end in ends]
    return f"[{texts[0]}, {texts[1]}]"
