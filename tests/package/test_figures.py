"""Every figure has the one look: colours of roles, sinkage downward, units, text that is read."""

import re

import numpy as np
import pytest
from matplotlib import colors
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.text import Text

from drftjax.common import figures as look
from drftjax.common.errors import InputError
from tests.helpers.figure_results import HEIGHT, all_figures

NARROW = 390  # pixels of a telephone's page, to which a figure is scaled
READABLE = 8.0  # pixels: smaller letters are guessed rather than read
CONTRAST = 2.9  # of a line on white; WCAG 2.2 asks 3 of a thin one, and pink comes to 2.96
APART = 15.0  # CIELAB units between two roles: six times what is just seen, 2.3

ROLES = {
    "recorded": look.RECORDED,
    "measured": look.RECORDED,
    "tuner, as logged": look.RECORDED,
    "HILS (real)": look.REAL,
    "HILS (sim)": look.SIMULATED,
    "simulated online": look.SIMULATED,
    "tuner, replayed": look.SIMULATED,
    "commanded": look.COMMANDED,
    "reference model": look.BEFORE,
    "before": look.BEFORE,
    "without": look.BEFORE,
    "given: ±0.5": look.BEFORE,
    "with the effect": look.AFTER,
    "with the effects": look.AFTER,
    "with loss 0.1, decay 2 rad": look.AFTER,
    "fitted": look.AFTER,
    "explained": look.AFTER,
    "offline": look.AFTER,
    "best: ±0.1": look.AFTER,
    "true": look.TRUE,
    "free": look.TRUE,
}


@pytest.fixture(scope="module")
def figures() -> dict[str, Figure]:
    with pytest.MonkeyPatch.context() as monkeypatch:
        return all_figures(monkeypatch)


def panels(figures: dict[str, Figure]) -> list[tuple[str, Axes]]:
    return [(name, axes) for name, figure in figures.items() for axes in figure.axes if axes.axison]


def test_a_role_looks_the_same_in_every_figure(figures):
    seen = set()
    for name, axes in panels(figures):
        for line in axes.get_lines():
            role = ROLES.get(str(line.get_label()))
            if role is not None:
                seen.add(line.get_label())
                assert line.get_color() == role.colour, name
                assert line.get_linestyle() == role.dashes, name
    assert seen == {*ROLES}


def test_sinkage_is_drawn_downward_and_named_so(figures):
    found = set()
    for name, axes in panels(figures):
        label = " ".join(axes.get_ylabel().split())
        assert label.endswith("downward") == axes.yaxis_inverted() or not label, name
        if label.startswith("sinkage"):
            assert label == "sinkage [mm], downward"
            assert all(np.nanmean(np.asarray(each.get_ydata(), float)) > 0 for each in axes.lines)
            found.add(name)
    assert found == {
        *("plot_run", "plot_hils", "sweep_figure", "slip_figure", "draw_effect", "runs_figure"),
        *("trajectory_figure", "plot_fit", "evaluation_figure", "draw_effect_of_most_numbers"),
    }
    drawn = figures["plot_fit"].axes
    values = next(each for each in drawn if each.get_ylabel().startswith("sinkage"))
    assert values.lines[0].get_ydata() == pytest.approx(-1e3 * HEIGHT)


def test_a_residual_stands_below_its_channel_with_the_noise_floor(figures):
    for name in ("plot_fit", "evaluation_figure"):
        axes = [each for each in figures[name].axes if "residual" in each.get_ylabel()]
        assert len(axes) == 4, name
        for each in axes:
            recorded = next(
                other for other in figures[name].axes
                if other.get_shared_x_axes().joined(other, each) and other is not each
            )  # fmt: skip
            assert recorded.get_position().y0 > each.get_position().y0
            (band,) = each.patches
            unit = 1e-3 if "downward" in each.get_ylabel() or "mm" in each.get_ylabel() else 1.0
            half = abs(band.get_extents().transformed(each.transData.inverted()).height) / 2
            assert half * unit == pytest.approx(2e-5 if each.yaxis_inverted() else 1e-3)


def test_every_axis_of_numbers_has_a_unit(figures):
    for name, axes in panels(figures):
        for axis in (axes.xaxis, axes.yaxis):
            texts = [each.get_text() for each in axis.get_ticklabels() if each.get_visible()]
            numbers = [each for each in texts if re.fullmatch(r"[−\d.]+", each)]
            if numbers and axis.get_tick_params().get("labelbottom", True):
                shown = axis.get_label_text().replace("order of rotation", "[-]")
                beside = any(
                    other.get_ylabel() for other in figures[name].axes
                    if axis is axes.yaxis and other.get_shared_y_axes().joined(other, axes)
                )  # fmt: skip
                assert re.search(r"\[.+\]", shown) or beside, (name, texts)


def test_text_can_be_read_on_a_telephone(figures):
    for name, figure in figures.items():
        pixels = NARROW / figure.get_size_inches()[0] / 72
        texts = [each for each in figure.findobj(Text) if each.get_text().strip()]
        assert min(each.get_fontsize() for each in texts) * pixels >= READABLE, name


def test_no_legend_is_wider_than_its_figure(figures):
    for name, figure in figures.items():
        with look.boxes_for_letters():
            figure.draw_without_rendering()
        for legend in figure.findobj(Legend):
            box = legend.get_window_extent()
            assert box.x0 >= 0, name
            assert box.x1 <= figure.bbox.x1, name


def test_the_ground_is_white_also_on_a_dark_page(figures):
    for name, figure in figures.items():
        for ground in (figure, *figure.axes):
            assert colors.to_rgba(ground.get_facecolor()) == (1, 1, 1, 1), name


# Colours ------------------------------------------------------------------------------------------

# Linear RGB to XYZ (IEC 61966-2-1), and what a person without L or M cones sees of it
# (Viénot, Brettel & Mollon 1999, Color Research & Application 24:243).
TO_XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
VISIONS = {
    "common": np.eye(3),
    "protanope": [[0.11238, 0.88762, 0], [0.11238, 0.88762, 0], [0.00401, -0.00401, 1]],
    "deuteranope": [[0.29275, 0.70725, 0], [0.29275, 0.70725, 0], [-0.02234, 0.02234, 1]],
}


def linear(colour: str) -> np.ndarray:
    given = np.array(colors.to_rgb(colour))
    return np.where(given <= 0.04045, given / 12.92, ((given + 0.055) / 1.055) ** 2.4)


def lab(rgb: np.ndarray) -> np.ndarray:
    """CIELAB under D65."""
    share = np.clip(TO_XYZ @ rgb / TO_XYZ.sum(axis=1), 0, None)
    f = np.where(share > 216 / 24389, np.cbrt(share), (24389 / 27 * share + 16) / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


LOOKS = (look.RECORDED, look.BEFORE, look.AFTER, look.SIMULATED, look.TRUE)


@pytest.mark.parametrize("vision", VISIONS)
def test_roles_are_told_apart_by_colour(vision):
    seen = [lab(np.asarray(VISIONS[vision]) @ linear(each.colour)) for each in LOOKS]
    for number, one in enumerate(seen):
        for other in seen[:number]:
            assert np.linalg.norm(one - other) > APART


def test_roles_are_told_apart_in_grey_print_and_seen_on_white():
    strokes = {(each.dashes, each.width > 2) for each in LOOKS}
    assert len(strokes) == len(LOOKS)
    for each in (*LOOKS, look.COMMANDED):
        assert 1.05 / (TO_XYZ[1] @ linear(each.colour) + 0.05) > CONTRAST


# Files --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("module", "arguments"),
    [
        ("identify.commands.fit", ["run.h5"]),
        ("identify.commands.crosscheck", ["run.h5"]),
        ("identify.commands.design", ["setup.toml"]),
        ("diagnose.commands.diagnose", ["run.h5"]),
        ("diagnose.commands.evaluate", ["run.h5", "--model", "model.toml"]),
    ],
)
def test_a_figure_of_no_known_kind_is_refused_before_any_file_is_read(module, arguments):
    from importlib import import_module

    from typer.testing import CliRunner

    app = import_module(module).app
    refused = CliRunner().invoke(app, [*arguments, "--plot", "a.jpeg"])
    assert isinstance(refused.exception, InputError)
    assert str(refused.exception) == "a.jpeg: a figure's name must end in .png, .pdf, .svg"
