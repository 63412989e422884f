"""Screening: elementary effects are Morris's, and the rig's numbers do what algebra says."""

import importlib.util
import json
import math
from pathlib import Path

import numpy as np
import pytest

from drftjax.common.errors import InputError
from drftjax.setups.setup import CommandSetUp, SetUp, WheelSetUp
from drftjax.setups.setup_toml import setup_toml
from identify.commands.design_screen import parse_ranges
from identify.design.elementary_effects import MorrisSettings, sample_trajectories, screen_function
from identify.design.figures import plot_screening
from identify.design.fisher_information import InstrumentNoise, compared_rows
from identify.design.number_ranges import RangeSettings, RangeWidth, usual_range
from identify.design.screening import GlobalSensitivity, screen
from identify.design.screening_report import screening_document, screening_table
from tests.helpers.drft_command import Drft

# Sums and quotients of some doubles.
ROUNDING = 1e-12
# A set-up's angles are written in degrees, and read again.
WRITTEN = 1e-9
# SALib resamples a thousand times: its intervals scatter by some percent.
RESAMPLED = 0.15
# A drift of the reading passes the sensors after it, which are late by up to 0.1 s of 3 s each.
LATE = 0.1
# Readings are late as above, and travel differs with the other numbers.
OTHERS = 0.3

FEW = MorrisSettings(trajectories=2)
SEED = 5


def short_run(**parts) -> SetUp:
    """Three seconds of a slow wheel on coarse plates."""
    command = CommandSetUp([0.0, 0.2, 1.0, 3.0], [0.0, 0.0, 0.6, 0.6])
    setup = SetUp(command, wheel=WheelSetUp(plate_size=0.008), title="a short run", **parts)
    setup.integrator.step = 0.01
    return setup


@pytest.fixture(scope="module")
def screened() -> GlobalSensitivity:
    return screen(short_run(), settings=FEW, seed=SEED)


def row(result: GlobalSensitivity, label: str) -> int:
    return [each.quantity.label for each in result.ranges].index(label)


def change(result: GlobalSensitivity, label: str, channel: str) -> float:
    return float(result.effects.mean_size[row(result, label), result.channels.index(channel)])


def ishigami(points):
    """Function of Ishigami & Homma (1990) on the unit box, one sample of one channel."""
    x = np.pi * (2 * points - 1)
    y = np.sin(x[:, 0]) + 7 * np.sin(x[:, 1]) ** 2 + 0.1 * x[:, 2] ** 4 * np.sin(x[:, 0])
    return y[:, None, None]


def test_elementary_effects_of_one_output_are_those_of_salib():
    from SALib.analyze import morris

    settings = MorrisSettings(trajectories=100)
    ours = screen_function(ishigami, 3, settings, SEED)
    box = {"num_vars": 3, "names": ["a", "b", "c"], "bounds": [[0.0, 1.0]] * 3}
    points = sample_trajectories(3, settings, SEED).reshape(-1, 3)
    theirs = morris.analyze(box, points, ishigami(points).ravel(), num_resamples=1000, seed=1)
    np.testing.assert_allclose(ours.mean_size[:, 0], theirs["mu_star"], rtol=ROUNDING)
    np.testing.assert_allclose(ours.spread[:, 0], theirs["sigma"], rtol=ROUNDING)
    theirs_interval = theirs["mu_star_conf"]
    np.testing.assert_allclose(ours.interval[:, 0], theirs_interval, rtol=RESAMPLED, atol=ROUNDING)


def test_effects_of_a_linear_function_are_its_coefficients_times_the_ranges():
    # Beside a number that changes the curve a million times more.
    coefficients, wide = np.array([3.0, -2.0, 0.0, 1e6]), np.array([1.0, 4.0, 2.0, 1.0])
    time = np.linspace(0, 1, 200)
    curves = np.stack([time, np.cos(9 * time), time**2, 1 - time])

    def linear(points):
        return ((points * wide * coefficients) @ curves)[:, None, :]

    found = screen_function(linear, 4, FEW, SEED)
    truth = np.abs(coefficients * wide) * np.sqrt(np.mean(curves**2, axis=1))
    atol = ROUNDING * 1e6
    np.testing.assert_allclose(found.mean_size[:, 0], truth, rtol=ROUNDING, atol=atol)
    np.testing.assert_allclose(found.spread[:, 0], 0, atol=atol)
    np.testing.assert_allclose(found.interval[:, 0], 0, atol=atol)


def test_failed_points_are_counted_and_leave_the_others_right():
    def gaps(points):
        y = points @ np.array([3.0, 5.0])
        y[points.sum(axis=1) > 1.9] = np.inf
        return y[:, None, None]

    settings = MorrisSettings(trajectories=60)
    points = sample_trajectories(2, settings, SEED)
    bad = points.sum(axis=2) > 1.9
    found = screen_function(gaps, 2, settings, SEED)
    assert found.failed == bad.sum() > 0
    assert found.counted.sum() == (~(bad[:, 1:] | bad[:, :-1])).sum()
    np.testing.assert_allclose(found.mean_size[:, 0], [3.0, 5.0], rtol=ROUNDING)
    np.testing.assert_allclose(found.spread, 0, atol=ROUNDING)

    none = screen_function(lambda points: np.full((3, 1, 1), np.nan), 2, FEW, SEED)
    assert np.isnan(none.mean_size).all()
    assert none.failed == none.simulations == 6


def test_a_drift_of_the_scale_changes_z_by_its_ramp_and_nothing_else(screened):
    ramp = math.sqrt(np.mean(np.linspace(0, 3, 301) ** 2))
    expected = 5e-5 * ramp / screened.noise["z"]
    assert change(screened, "sinkage_drift.rate", "z") == pytest.approx(expected, rel=LATE)
    for channel in ("x", "torque"):
        assert change(screened, "sinkage_drift.rate", channel) == 0


def test_a_gain_of_the_scale_changes_x_by_a_share_of_the_travel(screened):
    x = np.asarray(short_run().trial().run().x)
    expected = 0.03 * math.sqrt(np.mean(x**2)) / screened.noise["x"]
    assert change(screened, "travel_gain.gain", "x") == pytest.approx(expected, rel=OTHERS)


def test_zeta_matters_for_sinkage_and_a_hair_of_bulk_density_does_not(screened):
    matter = [screened.ranges[index].quantity.label for index in screened.relevant]
    assert change(screened, "zeta", "z") > 10
    assert "zeta" in matter
    assert "terrain.bulk_density" not in matter
    assert "Cannot matter" in screened.summary()
    assert screened.effects.failed == 0


def test_another_seed_gives_another_result(screened):
    other = screen(short_run(), settings=FEW, seed=SEED + 1)
    assert not np.array_equal(other.effects.mean_size, screened.effects.mean_size)


def test_the_figure_has_a_bar_for_every_number_in_every_channel(screened):
    figure = plot_screening(screened)
    bars = [len(axes.patches) for axes in figure.axes]
    assert bars == [len(screened.ranges)] * 3
    assert len(screening_table(screened).columns) == 5


def test_the_document_holds_every_range_and_change(screened):
    document = json.loads(json.dumps(screening_document(screened), allow_nan=False))
    zeta = next(each for each in document["numbers"] if each["name"] == "zeta")
    value = SetUp(CommandSetUp([0, 1], [0, 1])).terrain.zeta
    assert (zeta["value"], zeta["low"], zeta["high"]) == pytest.approx(
        (value, 0.95 * value, 1.05 * value)
    )
    assert zeta["changes"]["z"]["mean_size"] == change(screened, "zeta", "z")
    assert zeta["matters"] is True
    assert document["seed"] == SEED
    largest = [max(c["mean_size"] for c in n["changes"].values()) for n in document["numbers"]]
    assert largest == sorted(largest, reverse=True)


def test_what_pulls_a_driven_carriage_is_without_effect_and_grousers_need_grousers():
    setup = short_run()
    setup.rig.carriage = "driven"
    setup.wheel.shape = "plain"
    setup.command.vx = [0.0, 0.0, 0.08, 0.08]
    found = screen(
        setup, ranges={"rate_hardening.half": (0.05, 0.2)}, settings=MorrisSettings(2), seed=SEED
    )
    assert found.channels == ("z", "fx", "fz", "torque")
    for label in ("rig.mass_x", "rig.damping_x", "horizontal_coulomb.force"):
        assert not found.effects.mean_size[row(found, label)].any(), label
    assert change(found, "zeta", "fx") > 0
    assert "with grousers" in found.excluded["grouser_height"]
    assert "(grouser_height needs a wheel with grousers)" in found.summary()
    ends = found.ranges[row(found, "rate_hardening.half")]
    assert (ends.low, ends.high) == (0.05, 0.2)


def test_rows_count_until_wheel_and_carriage_stand():
    setup = SetUp(CommandSetUp([0.0, 1.0, 2.0, 3.0, 4.0], [0.0, 1.0, 0.0, 0.0, 0.0]))
    assert compared_rows(setup, 9, interval=0.5).tolist() == [1] * 5 + [0] * 4
    setup.command.vx = [0.0, 0.1, 0.1, 0.0, 0.0]
    assert compared_rows(setup, 9, interval=0.5).tolist() == [1] * 7 + [0] * 2


def test_a_bed_that_bears_no_wheel_is_refused():
    with pytest.raises(InputError, match=r"of 164 simulations diverge or sink past the wheel's"):
        screen(short_run(), ranges={"zeta": (0.001, 0.002)}, settings=FEW, seed=SEED)


def test_usual_ranges_keep_their_bounds():
    assert usual_range(2.0, RangeWidth("a", 0.1, relative=True)) == pytest.approx((1.9, 2.1))
    assert usual_range(0.0, RangeWidth("a", 4.0)) == (-2.0, 2.0)
    assert usual_range(0.0, RangeWidth("a", 4.0, least=0.0)) == (0.0, 4.0)
    assert usual_range(0.9, RangeWidth("a", 0.5, 0.0, least=0.0, most=1.0)) == (0.5, 1.0)
    assert len({each.name for each in RangeSettings().widths}) == len(RangeSettings().widths)


@pytest.mark.parametrize(
    ("ranges", "sentence"),
    [
        ({"zeta": (0.9, 0.6)}, "the range of zeta is 0.9 to 0.6"),
        ({"zeta": (0.5, math.nan)}, "both must be finite"),
        ({"zeta": (-1.0, 0.5)}, "at -1 zeta is -1"),
        ({"loosening.loss": (0.0, 2.0)}, "at 2 loosening.loss is 2"),
        ({"nonsense": (0.0, 2.0)}, "there is no parameter 'nonsense'"),
        ({"zeta": (0.6, 0.7), "terrain.zeta": (0.6, 0.7)}, "given twice"),
        ({"terrain.zeta.steady": (0.6, 0.7)}, "has no terrain.zeta.steady"),
    ],
)
def test_ranges_that_cannot_be_are_refused_in_a_sentence(ranges, sentence):
    with pytest.raises(InputError, match=sentence):
        screen(short_run(), ranges=ranges, settings=FEW)


def test_channels_and_settings_that_cannot_be_are_refused():
    with pytest.raises(InputError, match="there is no channel 'y'"):
        screen(short_run(), instrument=InstrumentNoise(channels=("y",)))
    with pytest.raises(InputError, match="the number of trajectories is 1, must lie between 2"):
        screen(short_run(), settings=MorrisSettings(1))
    with pytest.raises(InputError, match="the levels are 3, must be an even number"):
        sample_trajectories(2, MorrisSettings(levels=3), 0)


@pytest.mark.parametrize("text", ["zeta", "zeta=1", "zeta=1..b", "=1..2..3"])
def test_a_range_in_another_form_is_refused(text):
    with pytest.raises(InputError, match=r"must be NAME=LOW\.\.HIGH"):
        parse_ranges([text])
    assert parse_ranges(["a.b=-1e-3..2"]) == {"a.b": (-1e-3, 2.0)}


def test_command_writes_numbers_and_figure_the_same_for_one_seed(
    tmp_path: Path, monkeypatch, capsys, screened
):
    drft = Drft(monkeypatch, capsys)
    given = tmp_path / "short.toml"
    given.write_text(setup_toml(short_run()))
    options = ("--screen", "--trajectories", 2, "--seed", SEED, "-o", tmp_path / "out" / "screen")
    picture = tmp_path / "screen.pdf"
    answer = drft("design", given, *options, "--plot", picture)
    assert answer.code == 0, answer.err
    assert "can matter here" in answer.out
    document = json.loads((tmp_path / "out" / "screen.json").read_text())
    sizes = {
        each["name"]: [each["changes"][channel]["mean_size"] for channel in screened.channels]
        for each in document["numbers"]
    }
    for each, expected in zip(screened.ranges, screened.effects.mean_size, strict=True):
        assert sizes[each.quantity.label] == pytest.approx(expected.tolist(), rel=WRITTEN)
    assert (tmp_path / "out" / "screen.png").read_bytes()[:4] == b"\x89PNG"
    assert picture.read_bytes()[:4] == b"%PDF"


def test_command_refuses_what_it_cannot_do(tmp_path: Path, monkeypatch, capsys):
    drft = Drft(monkeypatch, capsys)
    given = tmp_path / "short.toml"
    given.write_text(setup_toml(short_run()))
    refused = drft("design", given, "--screen", "--parameter", "zeta", "--steps", 2).refusal
    assert refused == "--parameter, --steps would be ignored: --screen searches for no run"
    refused = drft("design", given, "--range", "zeta=0.1..0.2").refusal
    assert refused == "--range would be ignored: without --screen no numbers are screened"
    refused = drft("design", given, "--screen", "--noise-z", "nan").refusal
    assert refused.startswith("the noise of z is nan")
    real = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name, *more: None if name == "SALib" else real(name)
    )
    refused = drft("design", given, "--screen").refusal
    assert refused == "--screen needs SALib: in a checkout, pip install '.[screen]'"


def test_a_recorded_run_gives_its_channels_and_the_noise_of_its_readings(monkeypatch, capsys):
    from identify.commands import design_screen

    seen = {}

    def kept(setup, *, instrument, **others):
        seen.update(instrument=instrument, setup=setup)
        raise InputError("seen")

    monkeypatch.setattr(design_screen, "screen", kept)
    drft = Drft(monkeypatch, capsys)
    assert drft("design", "--like", "data/runs/slow_a.h5", "--screen").refusal == "seen"
    own = seen["instrument"]
    # The example runs have 20 um of white noise (tests.studies.example_runs).
    assert own.channels == ("x", "z")
    assert own.noise["z"] == pytest.approx(2e-5, rel=0.2)
    given = ("--channel", "z", "--noise-z", 300)
    assert drft("design", "--like", "data/runs/slow_a.h5", "--screen", *given).refusal == "seen"
    assert seen["instrument"].channels == ("z",)
    assert seen["instrument"].noise["z"] == pytest.approx(3e-4)
