"""Tables of text: CSV, TSV and their like, in any encoding, also packed as .gz."""

import codecs
import csv
import gzip
import re
import zlib
from dataclasses import replace
from io import StringIO
from pathlib import Path
from typing import Final

from drftjax.common.errors import InputError, read_failure
from drftjax.common.structured_files import HDF5
from drftjax.runlog.importers.layout import DEFAULT_LAYOUT, Layout
from drftjax.runlog.importers.readers.rows import table_of_rows
from drftjax.runlog.importers.table import Table

SEPARATORS: Final = (";", "\t", ",", "|")
"""Characters that usually stand between cells."""

SIZE_LIMIT: Final = 2_000_000_000
"""Most bytes of text, unpacked: a small .gz may hold more than the memory does."""

_STATED: Final = re.compile(r"sep=(.)\r?\n")

_MARKS: Final = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)

_FIRST_BYTES: Final = (
    (HDF5, "an HDF5 file"),
    (b"PK\x03\x04", "a workbook or another zip archive"),
    (b"\xd0\xcf\x11\xe0", "a workbook of an old format; save it as .xlsx or .csv"),
    (b"PAR1", "a Parquet file"),
    (b"TDSm", "a TDMS file"),
    (b"MATLAB 5.0", "a MAT file"),
    (b"SQLite format 3", "a database or a ROS 2 bag"),
    (b"\x89MCAP", "an MCAP file"),
    (b"%PDF", "a PDF file"),
)


def read_delimited(path: Path, layout: Layout = DEFAULT_LAYOUT) -> list[Table]:
    """Read a table of text.

    Args:
        path: CSV or TSV file, also packed as .gz.
        layout: Signs of the text and place of the rows.

    Raises:
        InputError: names the file, the line and what must hold.
    """
    text = read_text(path, layout.encoding)
    layout = _with_stated_separator(text, layout)
    if layout.separator is None:
        layout = with_separator(path, text, layout)
    assert layout.separator is not None
    lines = StringIO(text, newline="")
    for line in range(layout.skip_lines):
        if not lines.readline():
            raise InputError(
                f"{path}: has {line} lines, but skip_lines is {layout.skip_lines}; the headings "
                "must come after it"
            )
    reader = csv.reader(lines, delimiter=layout.separator)
    try:
        rows = ((layout.skip_lines + reader.line_num, row) for row in reader)
        return [table_of_rows(path, rows, layout)]
    except csv.Error as error:
        raise InputError(
            f"{path}, line {layout.skip_lines + reader.line_num}: cannot be split into cells; a "
            f"quotation mark is not closed, or a cell has more than {csv.field_size_limit()} signs"
        ) from error


def read_text(path: Path, encoding: str | None = None) -> str:
    """Text of a file, by its byte-order mark where no encoding is given, else as UTF-8.

    Raises:
        InputError: the file cannot be read, or is no text of this encoding.
    """
    try:
        opened = gzip.open if path.suffix.lower() == ".gz" else open
        with opened(path, "rb") as file:
            data = file.read(SIZE_LIMIT + 1)
    except gzip.BadGzipFile as error:
        raise InputError(f"{path}: is no file of gzip, as its name says, or is damaged") from error
    except OSError as error:
        raise InputError(f"{path}: {read_failure(path, error)}") from error
    except (EOFError, zlib.error) as error:
        raise InputError(f"{path}: the file of gzip is damaged, or was cut off") from error
    if len(data) > SIZE_LIMIT:
        raise InputError(f"{path}: holds more than {SIZE_LIMIT / 1e9:g} GB of text; split it")
    for start, kind in _FIRST_BYTES:
        if data.startswith(start):
            raise InputError(f"{path}: is {kind}; a file of this name must be CSV or TSV")
    marked = next((name for mark, name in _MARKS if data.startswith(mark)), None)
    try:
        return data.decode(encoding or marked or "utf-8").removeprefix("\ufeff")
    except UnicodeDecodeError as error:
        line = data[: error.start].count(b"\n") + 1
        if encoding is not None or marked is not None:
            name = encoding or marked
            raise InputError(f"{path}, line {line}: is not a table of {name} text") from error
        if b"\0" in data[:1000]:
            raise InputError(f"{path}: is not a table of text; must be CSV or TSV") from error
        raise InputError(
            f"{path}, line {line}: is not a table of UTF-8 text; a spreadsheet on Windows writes "
            'encoding = "cp1252", which then stands in the mapping'
        ) from error


def _with_stated_separator(text: str, layout: Layout) -> Layout:
    """Layout with the separator of a first line such as sep=; that some spreadsheets write."""
    stated = _STATED.match(text)
    if stated is None or layout.skip_lines:
        return layout
    return replace(layout, separator=layout.separator or stated[1], skip_lines=1)


def with_separator(path: Path, text: str, layout: Layout) -> Layout:
    """Layout with the separator that stands between the headings.

    Args:
        path: File of the text; its suffix decides where two signs are as frequent.
        text: The text.
        layout: Layout without a separator.
    """
    plain = path.name.lower().removesuffix(".gz")
    usual = "\t" if plain.endswith((".tsv", ".txt")) else ","
    lines = text.splitlines()[layout.skip_lines : layout.skip_lines + 1]
    first = lines[0] if lines else ""
    counts = {each: first.count(each) for each in SEPARATORS if each != layout.decimal}
    found = max(counts, key=lambda each: (counts[each], each == usual))
    return replace(layout, separator=found if counts[found] else usual)
