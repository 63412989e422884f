"""Writing a figure to a file, with errors that help."""

import io
import warnings
from pathlib import Path

from matplotlib.figure import Figure

from drftjax.common.errors import InputError
from drftjax.common.output_files import make_folder, replace_file

KINDS = (".png", ".pdf", ".svg")


def check_figure_name(path: Path) -> None:
    """Refuse a name that no figure can have, before the work that leads to the figure.

    Raises:
        InputError: names the file and what must hold.
    """
    if path.suffix.lower() not in KINDS:
        raise InputError(f"{path}: a figure's name must end in {', '.join(KINDS)}")


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure as PNG, PDF or SVG, whole or not at all; folders are made.

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
