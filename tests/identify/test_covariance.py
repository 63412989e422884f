"""Standard errors of numbers that runs tell, tell only together, or do not tell at all."""

import numpy as np
import pytest

from identify.parameters.parameter import own
from identify.results.findings import findings
from identify.results.result import FitResult
from identify.results.values import RunFit, Value
from identify.solver.whitening import Whitening
from identify.uncertainty.covariance import between_run_variance, covariance, null_directions
from identify.uncertainty.noise_model import White
from tests.helpers.synthetic_runs import setup_of

SAMPLES = 200
# The information of three that are told together is a difference of nearly equal numbers.
ROUNDING = 1e-6
# What a belief in nothing leaves of a variance, and what samples of order one tell of a number.
UNTOLD, TOLD = 1e4, 1e-4
# The same sums, scaled.
SCALED = 1e-12
NAMES = ("zeta", "wheel.width", "terrain.bulk_density", "rig.mass_z")

pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning")


def degenerate(seed: int) -> tuple[np.ndarray, Whitening]:
    """Derivatives of which three see one combination, and residuals that follow one another."""
    random = np.random.default_rng(seed)
    one = 800 * random.standard_normal((1, 2, SAMPLES))
    almost = one * (1 + 1e-12 * random.standard_normal(SAMPLES))
    blocks = np.stack([one, almost, -one, 100 * random.standard_normal(one.shape)], axis=-1)
    residual = random.standard_normal(one.shape).cumsum(axis=-1) / 5
    phase = np.repeat(np.arange(5), SAMPLES // 5)[None]
    counts = np.ones(one.shape, bool)
    return blocks, Whitening.of(
        residual, counts, np.full(one.shape, 0.7), phase, np.ones(phase.shape), White()
    )


def told(blocks: np.ndarray, whitening: Whitening) -> list[str]:
    nothing = np.zeros(len(NAMES))
    spread = covariance(blocks, whitening, 0)
    parameters = [own(name) for name in NAMES]
    errors = np.sqrt(np.diag(spread))
    values = {
        p.quantity.name: Value(1.0, float(error), "-", p.quantity.label)
        for p, error in zip(parameters, errors, strict=True)
    }
    one = np.zeros((1, 1))
    run = RunFit("run", setup_of(), values, one[0], one[0] == 0, ("z",), one, one, one)
    return findings(parameters, {}, [run], spread, null_directions(blocks, 0, nothing))


def test_no_variance_is_negative_and_what_is_told_is_told_as_without_the_others():
    for seed in range(50):
        blocks, whitening = degenerate(seed)
        variance = np.diag(covariance(blocks, whitening, 0))
        assert np.all(variance[:3] > UNTOLD)
        fewer = covariance(blocks[..., [0, 3]], whitening, 0)
        assert variance[3] == pytest.approx(fewer[1, 1], rel=ROUNDING)


def test_numbers_that_only_count_together_are_named_together():
    sentences = told(*degenerate(1))
    together = "these runs cannot tell zeta, wheel.width and terrain.bulk_density apart"
    assert sentences.count(together) == 1
    for name in NAMES[:3]:
        assert any(f"{name} cannot be identified" in sentence for sentence in sentences)
    assert not any("rig.mass_z" in sentence for sentence in sentences)


def test_a_number_that_no_sample_sees_does_not_hide_the_others():
    blocks, whitening = degenerate(2)
    blocks[..., 1:3] = 0
    variance = np.diag(covariance(blocks, whitening, 0))
    assert variance[0] < TOLD
    assert np.all(variance[1:3] > UNTOLD)
    assert not any("apart" in sentence for sentence in told(blocks, whitening))


def test_runs_that_see_nothing_at_all_say_so_without_a_warning():
    blocks, whitening = degenerate(4)
    blocks[:] = 0
    variance = np.diag(covariance(blocks, whitening, 1))
    assert np.all((variance > UNTOLD) & np.isfinite(variance))
    sentences = told(blocks, whitening)
    assert [sentence.split(" cannot be identified")[0] for sentence in sentences[:4]] == [
        f"run: {name}" for name in NAMES
    ]
    assert not any("apart" in sentence for sentence in sentences)
    moves = np.zeros((1, len(NAMES)))
    assert np.all(between_run_variance(moves, blocks, whitening, 1) == 0)


def test_a_run_of_finer_instruments_than_the_others_is_told_as_well_as_alone():
    random = np.random.default_rng(3)
    blocks = random.standard_normal((2, 1, SAMPLES, 1))
    size = np.array([0.2, 1.4])[:, None, None]
    residual = size * random.standard_normal((2, 1, SAMPLES))
    counts, nothing = np.ones(residual.shape, bool), np.zeros(residual.shape)
    clock = np.zeros((2, SAMPLES), int), np.ones((2, SAMPLES))

    def errors(size: np.ndarray) -> np.ndarray:
        whitening = Whitening.of(residual / size, counts, nothing, *clock, White())
        return np.sqrt(np.diag(covariance(blocks / size[..., None], whitening, 0)))

    together, alone = errors(np.ones_like(size)), errors(size)
    assert together == pytest.approx(alone, rel=SCALED)
    # Its noise is a seventh.
    assert alone[0] < 0.2 * alone[1]


def test_no_name_of_a_value_is_cut_off_in_a_narrow_table():
    names = ("zeta.stand", "zeta.accelerate", "zeta.steady", "zeta.decelerate")
    values = {name: Value(0.73247, 0.0012, "-", name) for name in names}
    two = np.zeros((2, 1))
    run = RunFit("slow_a", setup_of(), values, two[0], two[0] == 0, ("x", "z"), two, two, two)
    text = FitResult({}, [run], "converged", 5, {}).summary(80)
    assert "…" not in text
    assert all(name in text.split() for name in names)


@pytest.mark.parametrize("error", [np.nan, np.inf])
def test_an_error_that_is_no_number_tells_nothing(error):
    value = Value(0.75, error, "-", "lambda")
    nothing = np.zeros((0, 0))
    (sentence,) = findings([], {"terrain.inertial_coefficient": value}, [], nothing, nothing)
    assert sentence.startswith("lambda cannot be identified from these runs")


@pytest.mark.parametrize(
    ("label", "value", "error", "told"),
    [
        # A run without load tells its load to 0.035 N.
        ("rig.drawbar_load", 0.0018, 0.035, True),
        ("rig.drawbar_load", 0.0018, 0.9, False),
        ("rig.drawbar_load", 4.0, 1.9, True),
        ("start.sinkage", 1e-6, 1e-4, True),
        ("lambda", 0.0018, 0.035, False),
        ("zeta", 0.75, 0.38, False),
        ("zeta.steady", 0.75, 0.37, True),
    ],
)
def test_an_error_is_held_against_the_value_or_what_it_typically_changes_by(
    label, value, error, told
):
    each = Value(value, error, "-", label)
    assert each.identified == told
    nothing = np.zeros((0, 0))
    assert (findings([], {label: each}, [], nothing, nothing) == []) == told


def test_what_no_rig_has_is_told():
    """A damping of zero is fitted on both sides of it."""
    setup = setup_of()
    setup.rig.damping_x = -0.3
    time, z, nothing = np.arange(50.0), np.zeros((1, 50)), np.zeros((0, 0))
    runs = [RunFit(name, setup, {}, time, time >= 0, ("z",), z, z, z) for name in "ab"]
    told = [each for each in findings([], {}, runs, nothing, nothing) if "as fitted" in each]
    assert len(told) == 1
    assert "damping_x is -0.3, must lie between 0 and" in told[0]


def test_a_value_near_zero_has_a_place_in_the_table():
    assert Value(1e-5, 0.035, "N", "rig.drawbar_load").cell() == "0.000 ± 0.035"
    assert Value(1e-5, 0.035, "-", "lambda").cell() == "not identified"
