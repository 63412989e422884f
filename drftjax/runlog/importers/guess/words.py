"""Words by which people name the channels of a wheel's log, in several languages."""

import re
import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from drftjax.runlog.importers import units

SURE: Final = 1.0

LIKELY: Final = 0.6
"""Score of a word that also names other things, such as speed."""

WORDS: Final[Mapping[str, tuple[tuple[str, ...], tuple[str, ...]]]] = {
    "time": (
        ("t", "time", "zeit", "temps", "tempo", "tiempo", "timestamp", "elapsed", "clock"),
        ("stamp", "date", "datum", "sec", "seconds"),
    ),
    "omega": (
        ("omega", "rpm", "drehzahl", "angular", "winkelgeschwindigkeit", "giri", "ω", "revs"),
        ("w", "wheel", "rad", "rotation", "speed", "velocity", "vitesse", "velocita", "motor"),
    ),
    "vx": (
        ("vx", "carriage", "vorschub", "schlitten", "chariot", "carrello"),
        ("v", "forward", "speed", "velocity", "geschwindigkeit", "vitesse", "velocita"),
    ),
    "x": (
        ("x", "travel", "weg", "distance", "distanz", "strecke", "distanza", "avance"),
        ("position", "displacement", "deplacement", "spostamento", "pos"),
    ),
    "z": (
        ("z", "sinkage", "einsinkung", "enfoncement", "affondamento", "hundimiento", "depth"),
        ("height", "hohe", "hoehe", "tiefe", "profond", "heave", "vertical"),
    ),
    "fx": (
        ("fx", "drawbar", "zugkraft", "traction", "dbp"),
        ("pull", "longitudinal", "thrust", "horizontal"),
    ),
    "fz": (
        ("fz", "radlast", "normalkraft"),
        ("normal", "load", "vertical", "weight", "force", "kraft"),
    ),
    "torque": (
        ("torque", "drehmoment", "couple", "coppia", "par"),
        ("moment", "my", "momento"),
    ),
}
"""Words of each channel: those that name it, and those that may."""

DOWNWARD: Final = ("sink", "depth", "tiefe", "enfonc", "affond", "hundim", "profond")
"""Parts of words for a height that is counted downward."""

_BRACKETS: Final = re.compile(r"^(.*?)[\s_]*[\[(]\s*([^\])]*?)\s*[\])]\s*$")


@dataclass(frozen=True)
class NamedColumn:
    """Heading of a column, taken apart.

    Attributes:
        words: Its words in small letters, without accents.
        unit: Unit that it states; None where it states none that is known.
    """

    words: tuple[str, ...]
    unit: str | None


def taken_apart(heading: str, unit_cell: str = "") -> NamedColumn:
    """Words and unit of a heading such as "Weg [mm]", "x_mm", "field.speed (rpm)".

    Args:
        heading: The heading.
        unit_cell: Cell below it in a row of units.
    """
    name, unit = heading, None
    match = _BRACKETS.match(heading)
    if match is not None:
        name, unit = match[1], match[2] if units.is_unit(match[2]) else None
    else:
        parts = re.split(r"[\s_/]+", heading)
        for count in (2, 1):
            tail = "/".join(parts[-count:])
            if len(parts) > count and units.is_unit(tail) and tail not in ("m", "g", "h", "1"):
                name, unit = "_".join(parts[:-count]), tail
                break
            if len(parts) > count and count == 1 and tail == "m":
                name, unit = "_".join(parts[:-count]), tail
    if units.is_unit(unit_cell):
        unit = unit_cell
    return NamedColumn(_words(name), None if unit is None else units.spelled(unit))


def score(role: str, column: NamedColumn) -> float:
    """Likelihood, from 0 to 1, that a heading names a channel."""
    sure, likely = WORDS[role]
    if any(_names(word, each) for word in sure for each in column.words):
        return SURE
    return LIKELY if any(_names(word, each) for word in likely for each in column.words) else 0.0


def _names(word: str, given: str) -> bool:
    """True where a heading's word is a channel's; a long one may be part of a compound."""
    return given == word or (len(word) > 3 and word in given)


def _words(name: str) -> tuple[str, ...]:
    """Words of a name in small letters, without accents."""
    plain = unicodedata.normalize("NFKD", re.sub(r"([a-z])([A-Z])", r"\1 \2", name))
    bare = "".join(each for each in plain if not unicodedata.combining(each)).lower()
    return tuple(each for each in re.split(r"[^a-zω]+", bare) if each)
