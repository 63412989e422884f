"""Files of TOML and JSON that cannot be read, in words of this project."""

import re
from datetime import date, time
from pathlib import Path

import msgspec
import pytest

from drftjax.common.errors import InputError
from drftjax.common.structured_files import read_document, to_structure

# Words of the parsers, which a user need not know.
OF_LIBRARIES = r"Expecting|Expected|Invalid|Cannot|char \d|set_int_max|recursion|unicode|`"


class Axle(msgspec.Struct, forbid_unknown_fields=True):
    """A table."""

    radius: float
    width: float = 0.1


class Note(msgspec.Struct, forbid_unknown_fields=True):
    """One of a list of tables."""

    words: str = ""


class Rover(msgspec.Struct, forbid_unknown_fields=True):
    """A document."""

    axle: Axle
    name: str = ""
    notes: list[Note] = msgspec.field(default_factory=list, name="note")


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("a.toml", "[axle\nb = 1", "is not TOML: line 1, '[axle', cannot be read from column 6 on"),
        ("a.toml", "x = 1\ny : 2", "is not TOML: line 2, 'y : 2', cannot be read from column 3"),
        ("a.toml", "x = 1\nx = 2", "is not TOML: its last line gives an entry that is there"),
        ("a.toml", "x = 1\nx = 2\n", "is not TOML: line 2, 'x = 2', gives an entry that is there"),
        ("a.toml", "[a]\n[b]\n[a]", "is not TOML: line 3, '[a]', gives an entry that is there"),
        ("a.toml", 'x = """never', "is not TOML: it ends inside an entry"),
        ("a.toml", "x = " + "[" * 10_000, "its entries lie too deep in one another"),
        ("a.toml", "x = " + "9" * 5000, "holds a number of too many digits"),
        ("a.json", '{\n"x": 1,\n}', "is not JSON: line "),
        ("a.json", '{"x": }', "is not JSON: line 1, '{\"x\": }', cannot be read from column 7 on"),
        ("a.json", "", "is not JSON: it ends at line 1, inside an entry"),
        ("a.json", "[" * 100_000, "its entries lie too deep in one another"),
        ("a.json", '{"x": ' + "9" * 5000 + "}", "holds a number of too many digits"),
        ("a.json", '"' + "y" * 500, "is not JSON: line 1, '\"" + "y" * 59 + "', cannot be read"),
        ("a.json", "[1, 2]", "must hold named entries, holds a list"),
    ],
)
def test_text_of_another_grammar_is_named_by_its_line(tmp_path, name, text, said):
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        read_document(path)
    assert str(caught.value).startswith(f"{path}: {said}")
    assert not re.search(OF_LIBRARIES, str(caught.value))


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"axle": {"radius": 1, "name": "x"}}, "unknown entry 'name' in [axle]"),
        ({"axle": {"radius": 1}, "width": 2}, "unknown entry 'width'; it belongs in [axle]"),
        ({"axle": {"radius": 1}, "words": ""}, "unknown entry 'words'; it belongs in [[note]]"),
        ({"axle": {"radis": 1}}, "unknown entry 'radis' in [axle]; did you mean 'radius' or"),
        ({"axle": {"radius": 10**400}}, "axle.radius: the number is larger than a computer holds"),
        ({"axle": {"radius": date(2026, 7, 1)}}, "axle.radius: expected a number, got a date"),
        ({"axle": {"radius": time(12)}}, "axle.radius: expected a number, got a time of day"),
        ({"note": [3], "axle": {"radius": 1}}, "note[0]: expected a table of entries, got a whole"),
    ],
)
def test_an_entry_that_cannot_be_is_named_with_its_table(given, said):
    with pytest.raises(InputError) as caught:
        to_structure(given, Rover, Path("rover.toml"))
    assert str(caught.value).startswith(f"rover.toml: {said}")
    assert not re.search(OF_LIBRARIES, str(caught.value))
