"""The one look of all figures: roles of lines, axes of channels, sizes of text; and their files.

The colours are those of Okabe & Ito 2008, "Color Universal Design", which people of every common
colour vision tell apart. In grey print, a role is known by its dashes and its width. The ground
is white, so that a figure is a white card on a dark page.
"""

import functools
import io
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, ParamSpec

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from drftjax.common.errors import InputError
from drftjax.common.output_files import make_folder, replace_file

Arguments = ParamSpec("Arguments")

KINDS = (".png", ".pdf", ".svg")
"""Suffixes of the formats that a figure can be written in."""


@dataclass(frozen=True)
class LineRole:
    """Look of the lines that play one role, whatever the figure.

    Attributes:
        colour: As #RRGGBB.
        dashes: Line style of matplotlib.
        width: Of the line [pt].
    """

    colour: str
    dashes: str
    width: float

    @property
    def line(self) -> dict[str, Any]:
        """Keywords of `Axes.plot`."""
        return {"color": self.colour, "linestyle": self.dashes, "linewidth": self.width}


# Recorded is the widest, as the others are drawn over it.
RECORDED: Final = LineRole("#000000", "-", 2.2)
BEFORE: Final = LineRole("#D55E00", "--", 1.5)  # the reference model
AFTER: Final = LineRole("#0072B2", "-", 1.2)  # with effects, or with fitted numbers
REAL: Final = RECORDED  # in the loop, what the rig measured
SIMULATED: Final = LineRole("#009E73", "-.", 1.5)  # in the loop, or by the model alone
COMMANDED: Final = LineRole("#595959", "-", 1.2)
TRUE: Final = LineRole("#CC79A7", ":", 2.0)  # known to be so

PARTS: Final = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#F0E442")
"""Colours of parts of one whole that play no role above, such as several effects."""

HATCHES: Final = ("", "//", "..", "xx", "\\\\", "++")
"""Of these parts, for grey print."""

FLOOR_COLOUR: Final = "#7F7F7F"

FAINT: Final = "#BFBFBF"
"""Of what is beside the point: zero lines, bars below the noise."""


@dataclass(frozen=True)
class FigureStyle:
    """Sizes of every figure.

    Attributes:
        width: Of a figure [inches]; a page scales it to its own.
        columns: Panels side by side at most: beside a third there is no room for text.
        text: Of titles [pt], 8.5 pixels where the figure is 390 pixels wide, as on
            a telephone.
        small_text: Of labels, ticks and legends [pt], 8.1 pixels there.
        dots_per_inch: Of PNG files.
    """

    width: float = 7.0
    columns: int = 2
    text: float = 11.0
    small_text: float = 10.5
    dots_per_inch: int = 130


STYLE: Final = FigureStyle()

_PARAMETERS: Final[Any] = {
    "figure.facecolor": "white",
    "axes.facecolor": "white",
    "font.size": STYLE.text,
    "axes.titlesize": STYLE.text,
    "axes.labelsize": STYLE.small_text,
    "figure.titlesize": STYLE.text,
    "figure.labelsize": STYLE.text,
    "legend.fontsize": STYLE.small_text,
    "legend.title_fontsize": STYLE.small_text,
    "legend.framealpha": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "hatch.linewidth": 0.6,
}


@dataclass(frozen=True)
class ChannelAxis:
    """Axis on which a channel is drawn.

    Attributes:
        label: Name of the quantity.
        unit: Of its values.
        scale: From the channel's SI unit to that of its values; negative where the axis shows
            the opposite of the channel.
        difference_unit, difference_scale: The same for differences of two values.
    """

    label: str
    unit: str
    scale: float
    difference_unit: str
    difference_scale: float

    @property
    def is_downward(self) -> bool:
        """True where the axis grows downward, so that up in the picture is up on the rig."""
        return self.scale < 0


CHANNEL_AXES: Final = {
    "x": ChannelAxis("travel", "m", 1.0, "mm", 1e3),
    "z": ChannelAxis("sinkage", "mm", -1e3, "mm", -1e3),
    "fx": ChannelAxis("forward force", "N", 1.0, "N", 1.0),
    "fz": ChannelAxis("upward force", "N", 1.0, "N", 1.0),
    "torque": ChannelAxis("torque", "N m", 1.0, "N m", 1.0),
}


def label_channel(axes: Axes, channel: str) -> float:
    """Label the vertical axis of a channel, and turn that of the sinkage downward.

    Args:
        axes: Panel, whose limits are not set yet.
        channel: One of x, z, fx, fz, torque; the sinkage is -z.

    Returns:
        Scale from the channel [m, N, N m] to the axis.
    """
    axis = CHANNEL_AXES[channel]
    _label(axes, axis, f"{axis.label} [{axis.unit}]")
    return axis.scale


def label_difference(axes: Axes, channel: str, name: str) -> float:
    """Label the vertical axis of a difference of a channel, such as a residual.

    Args:
        axes: Panel, whose limits are not set yet.
        channel: As for `label_channel`.
        name: Of the difference, such as "residual".

    Returns:
        Scale from the difference [m, N, N m] to the axis.
    """
    axis = CHANNEL_AXES[channel]
    _label(axes, axis, f"{name} [{axis.difference_unit}]")
    return axis.difference_scale


def _label(axes: Axes, axis: ChannelAxis, text: str) -> None:
    axes.set_ylabel(f"{text},\ndownward" if axis.is_downward else text)
    axes.yaxis.set_inverted(axis.is_downward)


def draw_floor(axes: Axes, floor: float, label: str = "noise floor") -> None:
    """Draw a noise floor, or another tolerance, as a band around zero.

    Args:
        axes: Panel of a difference.
        floor: Half the width of the band, in the unit of the axis; its sign does not matter.
        label: In the legend.
    """
    axes.axhspan(-abs(floor), abs(floor), color=FLOOR_COLOUR, alpha=0.25, lw=0, label=label)


def project_style(draw: Callable[Arguments, Figure]) -> Callable[Arguments, Figure]:
    """Decorate a function that makes a figure, so that it has the look of all others."""

    @functools.wraps(draw)
    def drawn(*given: Arguments.args, **named: Arguments.kwargs) -> Figure:
        with mpl.rc_context(_PARAMETERS):
            figure = draw(*given, **named)
        # Ticks are made when the figure is drawn, so the parameters do not reach them.
        for axes in figure.axes:
            for each in (axes, *axes.child_axes):
                each.tick_params(labelsize=STYLE.small_text, grid_color="0.88", grid_linewidth=0.6)
                each.set_axisbelow(True)
        return figure

    return drawn


def panel_rows(
    count: int, height: float, columns: int = STYLE.columns
) -> tuple[Figure, list[Axes]]:
    """A figure of `count` panels, row by row, as wide as every figure.

    Args:
        count: Panels.
        height: Of a row [inches].
        columns: Panels side by side, where there are so many.
    """
    columns = min(columns, count)
    rows = -(-count // columns)
    figure = Figure(figsize=(STYLE.width, 0.6 + height * rows), layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False).ravel().tolist()
    for spare in panels[count:]:
        spare.remove()
    return figure, panels[:count]


def legend_below(figure: Figure, axes: Sequence[Axes], columns: int = 4) -> None:
    """Put one legend of all labels below a figure, each label once."""
    found: dict[str, Any] = {}
    for each in axes:
        for handle, label in zip(*each.get_legend_handles_labels(), strict=True):
            found.setdefault(label, handle)
    figure.legend(
        [*found.values()], [*found], loc="outside lower center", ncols=columns, frameon=False
    )


def title_above(figure: Figure, text: str) -> None:
    """Put a title above a figure; a dollar sign in it is no formula, and long ones wrap."""
    figure.suptitle(text, wrap=True, parse_math=False)


@contextmanager
def boxes_for_letters() -> Iterator[None]:
    """Draw without a warning names in a script that the font lacks: they become boxes."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph")
        yield


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
    with boxes_for_letters():
        figure.savefig(image, format=path.suffix.lower()[1:], dpi=STYLE.dots_per_inch)
    replace_file(path, image.getvalue())
