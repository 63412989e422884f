"""Layout of a file that is read as a table: the signs of its text, and the lines that hold data."""

import codecs
from dataclasses import dataclass, fields

from drftjax.common.errors import InputError


@dataclass(frozen=True)
class Layout:
    """Place of the headings and rows in a table of text or a sheet.

    Attributes:
        separator: Character between cells; None to find it out from the headings.
        decimal: Sign between whole and decimal digits, "." or ",".
        encoding: Name of the text's encoding; None for UTF-8, or what its first bytes say.
        skip_lines: Lines above the headings.
        skip_below: Lines between the headings and the first row, such as one of units.
        headings: False where there is no line of headings; the columns are then "1", "2", ...
        end_at: Beginning of the first line that is no row any more, "" for an empty line; None
            where the table goes to the end of the file.
        sheet: Name of the sheet of a workbook; None for the first.

    Raises:
        InputError: a sign or a number cannot be one.
    """

    separator: str | None = None
    decimal: str = "."
    encoding: str | None = None
    skip_lines: int = 0
    skip_below: int = 0
    headings: bool = True
    end_at: str | None = None
    sheet: str | None = None

    def __post_init__(self) -> None:
        for name in ("skip_lines", "skip_below"):
            if getattr(self, name) < 0:
                raise InputError(f"{name} is {getattr(self, name)}, it must not be negative")
        if self.separator is not None and len(self.separator) != 1:
            raise InputError(f"separator is {self.separator!r}, it must be one character")
        if self.separator is not None and self.separator in '"\r\n\0':
            raise InputError(f"separator is {self.separator!r}, which cannot stand between cells")
        if self.decimal not in (".", ","):
            raise InputError(f'decimal is {self.decimal!r}, it must be "." or ","')
        if self.decimal == self.separator:
            raise InputError(f"decimal and separator are both {self.decimal!r}, they must differ")
        if self.encoding is not None:
            try:
                codecs.lookup(self.encoding)
            except (LookupError, ValueError):
                raise InputError(
                    f"encoding is {self.encoding!r}, which is not known; utf-8, utf-16 and cp1252 "
                    "are usual ones"
                ) from None

    def set_keys(self) -> list[str]:
        """Names of the fields that differ from their defaults."""
        return [each.name for each in fields(self) if getattr(self, each.name) != each.default]


DEFAULT_LAYOUT = Layout()
