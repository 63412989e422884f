"""Writing figures to files."""

import io
import warnings
from pathlib import Path

from matplotlib.figure import Figure

from drftjax.common.errors import InputError
from drftjax.common.output_files import make_folder, replace_file

KINDS = (".png", ".pdf", ".svg")
"""Suffixes of the formats that a figure can be written in."""


def check_figure_name(path: Path) -> None:
    """Refuse a file name whose suffix is not that of a figure.

    Called before the computation whose result the figure shows.

    Raises:
        InputError: names the file and what must hold.
    """
    if path.suffix.lower() not in KINDS:
        raise InputError(f"{path}: a figure's name must end in {', '.join(KINDS)}")


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure atomically as PNG, PDF or SVG, and create its folder.

    Raises:
        InputError: names the file and what must hold.
    """
    check_figure_name(path)
    make_folder(path.parent)
    image = io.BytesIO()
    with warnings.catch_warnings():
        # A name may be in a script that the font lacks; it is drawn as boxes.
        warnings.filterwarnings("ignore", message="Glyph")
        figure.savefig(image, format=path.suffix.lower()[1:], dpi=130)
    replace_file(path, image.getvalue())
