"""Units of experimenters' tables, and their conversion to SI.

A unit is a factor and the powers of metre, kilogram and second. An angle has no power of its own,
so a rim speed divided by a radius comes out in rad/s.
"""

import math
import re
from dataclasses import dataclass
from typing import Final

from drftjax.common.errors import InputError
from drftjax.runlog.validation import nearest

Powers = tuple[int, int, int]


_NUMBER: Final = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(.*)")


@dataclass(frozen=True)
class Unit:
    """Unit or quantity.

    Attributes:
        factor: Its value in SI.
        powers: Powers of metre, kilogram and second.
    """

    factor: float
    powers: Powers


_NONE: Final = (0, 0, 0)


_LENGTH: Final = (1, 0, 0)


_TIME: Final = (0, 0, 1)


_SPEED: Final = (1, 0, -1)


_RATE: Final = (0, 0, -1)


_FORCE: Final = (1, 1, -2)


_MOMENT: Final = (2, 1, -2)


_DENSITY: Final = (-3, 1, 0)


UNITS: Final = {
    "1": Unit(1.0, _NONE),
    "%": Unit(0.01, _NONE),
    "rad": Unit(1.0, _NONE),
    "deg": Unit(math.pi / 180, _NONE),
    "rev": Unit(2 * math.pi, _NONE),
    "m": Unit(1.0, _LENGTH),
    "cm": Unit(1e-2, _LENGTH),
    "mm": Unit(1e-3, _LENGTH),
    "um": Unit(1e-6, _LENGTH),
    "in": Unit(0.0254, _LENGTH),
    "ft": Unit(0.3048, _LENGTH),
    "s": Unit(1.0, _TIME),
    "ms": Unit(1e-3, _TIME),
    "us": Unit(1e-6, _TIME),
    "ns": Unit(1e-9, _TIME),
    "min": Unit(60.0, _TIME),
    "h": Unit(3600.0, _TIME),
    "m/s": Unit(1.0, _SPEED),
    "cm/s": Unit(1e-2, _SPEED),
    "mm/s": Unit(1e-3, _SPEED),
    "m/min": Unit(1 / 60, _SPEED),
    "cm/min": Unit(1e-2 / 60, _SPEED),
    "mm/min": Unit(1e-3 / 60, _SPEED),
    "m/h": Unit(1 / 3600, _SPEED),
    "km/h": Unit(1 / 3.6, _SPEED),
    "rad/s": Unit(1.0, _RATE),
    "deg/s": Unit(math.pi / 180, _RATE),
    "mrad/s": Unit(1e-3, _RATE),
    "deg/min": Unit(math.pi / 180 / 60, _RATE),
    "rpm": Unit(math.pi / 30, _RATE),
    "rev/s": Unit(2 * math.pi, _RATE),
    "N": Unit(1.0, _FORCE),
    "kN": Unit(1e3, _FORCE),
    "mN": Unit(1e-3, _FORCE),
    "kgf": Unit(9.80665, _FORCE),
    "lbf": Unit(4.4482216152605, _FORCE),
    "N m": Unit(1.0, _MOMENT),
    "N cm": Unit(1e-2, _MOMENT),
    "N mm": Unit(1e-3, _MOMENT),
    "mN m": Unit(1e-3, _MOMENT),
    "kN m": Unit(1e3, _MOMENT),
    "kg": Unit(1.0, (0, 1, 0)),
    "g": Unit(1e-3, (0, 1, 0)),
    "lb": Unit(0.45359237, (0, 1, 0)),
    "m/s^2": Unit(1.0, (1, 0, -2)),
    "m/s2": Unit(1.0, (1, 0, -2)),
    "kg/m^3": Unit(1.0, _DENSITY),
    "kg/m3": Unit(1.0, _DENSITY),
    "g/cm^3": Unit(1e3, _DENSITY),
    "g/cm3": Unit(1e3, _DENSITY),
}


SPELLINGS: Final = {
    "U/min": "rpm",
    "1/min": "rpm",
    "min-1": "rpm",
    "min^-1": "rpm",
    "r/min": "rpm",
    "rev/min": "rpm",
    "tr/min": "rpm",
    "giri/min": "rpm",
    "RPM": "rpm",
    "U/s": "rev/s",
    "1/s": "rad/s",
    "s-1": "rad/s",
    "s^-1": "rad/s",
    "rad s-1": "rad/s",
    "rad s^-1": "rad/s",
    "deg s-1": "deg/s",
    "m s-1": "m/s",
    "m s^-1": "m/s",
    "mm s-1": "mm/s",
    "kmh": "km/h",
    "sec": "s",
    "sec.": "s",
    "second": "s",
    "seconds": "s",
    "msec": "ms",
    "usec": "us",
    "nsec": "ns",
    "Nm": "N m",
    "N.m": "N m",
    "N-m": "N m",
    "Ncm": "N cm",
    "Nmm": "N mm",
    "mNm": "mN m",
    "kNm": "kN m",
    "metre": "m",
    "meter": "m",
    "inch": "in",
    "kilogram": "kg",
    "newton": "N",
    "": "1",
    "-": "1",
}
"""Other spellings of units, after the signs of degree and micro are written out."""


def spelled(name: str) -> str:
    """Name of a unit without brackets and special signs, spelled as in `UNITS` if it is there."""
    bare = name.strip().strip("[](){}").strip()
    # Two signs are used for micro; a degree also stands where an ordinal belongs.
    for sign, word in (
        ("µ", "u"),
        ("μ", "u"),
        ("°", "deg"),
        ("º", "deg"),
        ("²", "^2"),
        ("³", "^3"),
    ):
        bare = bare.replace(sign, word)
    bare = " ".join(bare.replace("*", " ").replace("·", " ").replace("⋅", " ").split())
    bare = bare.replace("degrees", "deg").replace("degree", "deg").replace(" / ", "/")
    return SPELLINGS.get(bare, bare)


def is_unit(text: str) -> bool:
    """True of the name of a unit, also in brackets; an empty text is none."""
    return bool(text.strip()) and spelled(text) in UNITS


def unit(name: str) -> Unit:
    """Unit of that name.

    Raises:
        InputError: there is no such unit; names the nearest ones.
    """
    known = UNITS.get(spelled(name))
    if known is None:
        raise InputError(f"{name!r} is no unit known here; {nearest(name, tuple(UNITS))}")
    return known


def quantity(given: float | str) -> Unit:
    """Parse a number with its unit, such as "62.5 mm"; a bare number has no unit.

    Returns:
        Value in SI as the factor, and its powers.

    Raises:
        InputError: the text is no quantity, or not finite.
    """
    if not isinstance(given, str):
        value, of = float(given), UNITS["1"]
    else:
        match = _NUMBER.fullmatch(given)
        if match is None:
            raise InputError(f"{given!r} is no quantity; write a number and a unit, like '62.5 mm'")
        value, of = float(match[1]), unit(match[2] or "1")
    if not math.isfinite(value):
        raise InputError(f"{given!r} is not a finite number")
    return Unit(value * of.factor, of.powers)


def divide(top: Unit, bottom: Unit) -> Unit:
    """Quotient of two quantities.

    Raises:
        InputError: the divisor is 0.
    """
    if bottom.factor == 0:
        raise InputError("a division by 0 is asked for")
    a, b, c = (high - low for high, low in zip(top.powers, bottom.powers, strict=True))
    return Unit(top.factor / bottom.factor, (a, b, c))


def describe(powers: Powers) -> str:
    """Powers as text in SI, such as m kg s^-2."""
    pairs = zip(("m", "kg", "s"), powers, strict=True)
    words = (name if power == 1 else f"{name}^{power}" for name, power in pairs if power)
    return " ".join(words) or "1"
