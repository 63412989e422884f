"""Unknown errors found in the stage where they were put in, and what they follow."""

from dataclasses import replace
from functools import cache

import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, Float

from diagnose.dataset import RigDataset, with_zeta, without_step_errors
from diagnose.linear.input_sensitivity import READINGS, effect_sensitivity, propagate
from diagnose.linear.linearized_runs import linearize_run, linearize_runs
from diagnose.model.augmented_model import AugmentedModel
from diagnose.run_pool import RunPool
from diagnose.unknown.dependence import (
    choose_disturbance,
    fit_curve,
    rank_dependence,
    signal_against,
)
from diagnose.unknown.disturbances import Disturbance, estimate_disturbances
from diagnose.unknown.settings import DEFAULT_UNKNOWN_EFFECT
from drftjax.common.errors import InputError
from drftjax.effects.base import (
    AbstractPlane,
    AbstractSensor,
    AbstractStressFactor,
    EffectInfo,
    MemorylessZetaFactor,
    strength,
)
from drftjax.effects.catalogue import field_metadata
from drftjax.effects.correction import correction_class, correction_variables, fields
from drftjax.effects.drive import SpeedGain
from drftjax.effects.surface import SurfaceSlope
from drftjax.effects.terrain import Loosening
from tests.helpers.synthetic_runs import BELIEVED_ZETA, coarse, recorded, setup_of

TRUE_ZETA = 0.75
NOISE = 10e-6
KNOTS = 6
# A drive that turns too fast by so much tells itself from a force that pushes [-].
GAIN = 0.08
# About the step that is chosen for such runs [s].
STEP = 2.5e-3
# A step is differentiated once a node only, and plates cross corners in between.
LINES_ERR = 0.25
# What a stage explains that made the gap, and what a signal follows that made it: all but a tenth.
# Of noise alone a stage explains no tenth.
NEARLY_ALL, NEXT_TO_NOTHING = 0.9, 0.1
# A curve's six knots are told by three runs of a few seconds: its slope by a twentieth of itself,
# and where a run ends by less than that of the gap.
SLOPE, CLOSED = 0.0075, 0.05
# A curve of zeros is zero to the bit, and so is what it changes. A compiler rounds a product and
# its sum once in one program, and twice in the other.
ROUNDED = 2
# A wheel's load ripples by some per cent as plates come and go; a median is closer.
CARRIED = 0.03
# An error holds its signal's truth within this many standard errors nearly everywhere; responses
# are straight lines, which takes the rest.
SIGMAS, NEARLY_EVERYWHERE = 3.0, 0.9


@cache
def dataset() -> RigDataset:
    runs = []
    for speed in (0.8, 1.0, 1.4):
        profile = ([0.0, 0.25, 1.25, 3.5, 4.5], [0.0, 0.0, speed, speed, 0.2 * speed])
        setup = setup_of(profile, TRUE_ZETA)
        setup.integrator.step = STEP
        runs.append(coarse(f"run {speed:g}", recorded(setup), step=STEP))
    # One program simulates each of these.
    shared = AugmentedModel((SpeedGain, SurfaceSlope, Loosening))
    with RunPool() as pool:
        return replace(without_step_errors(RigDataset.of(runs), pool), shared=shared)


@cache
def driven_dataset() -> RigDataset:
    profile = ([0.0, 0.25, 1.25, 3.5], [0.0, 0.0, 1.0, 1.0])
    setup = setup_of(profile, TRUE_ZETA, vx=[0.0, 0.0, 0.1, 0.1])
    run = recorded(setup, channels=("z", "fx", "fz", "torque"), force_noise=0.1)
    return RigDataset.of([coarse("driven", run)])


def log_zeta() -> np.ndarray:
    return np.full(len(dataset().runs), np.log(TRUE_ZETA / BELIEVED_ZETA))


@cache
def plain() -> list[np.ndarray]:
    return [
        dataset().prediction(AugmentedModel(), run, z, np.zeros(0))
        for run, z in enumerate(log_zeta())
    ]


def with_(effect: type, **values: float) -> list[np.ndarray]:
    """What every run would record with an effect, but for noise."""
    model = AugmentedModel((effect,))
    at = [f.coordinate(values[f.field]) if f.field in values else 0.0 for f in model.free]
    return [dataset().prediction(model, run, z, np.array(at)) for run, z in enumerate(log_zeta())]


def left(recorded: list[np.ndarray], seed: int = 0) -> list[np.ndarray]:
    random = np.random.default_rng(seed)
    return [
        simulated - true + NOISE * random.standard_normal(true.shape)
        for simulated, true in zip(plain(), recorded, strict=True)
    ]


def disturbances_of(residual: list[np.ndarray], of: RigDataset | None = None) -> list[Disturbance]:
    runs = dataset() if of is None else of
    with RunPool() as pool:
        linearized = linearize_runs(runs, log_zeta()[: len(runs.runs)], pool)
        return estimate_disturbances(runs, linearized, pool, residual)


@cache
def of_gain() -> list[Disturbance]:
    return disturbances_of(left(with_(SpeedGain, gain=GAIN)))


def named(found: list[Disturbance], name: str) -> Disturbance:
    return next(each for each in found if each.name == name)


def values_of(values) -> dict[str, float]:
    return dict(zip(fields(len(values)), (float(v) for v in values), strict=True))


def test_noise_needs_no_stage():
    found = disturbances_of(left(plain()))
    assert max(each.evidence for each in found) < 3
    assert max(each.explained for each in found) < NEXT_TO_NOTHING


def test_a_drive_that_turns_too_fast_is_an_error_of_speed_that_follows_the_speed():
    found = of_gain()
    assert found[0].name == "speed"
    assert found[0].evidence > found[1].evidence + DEFAULT_UNKNOWN_EFFECT.tied_evidence
    assert found[0].explained > 0.95  # of the gap: noise is under a per mille of it
    ranked = [
        (v, s)
        for v, s in rank_dependence(dataset(), found[0])
        if v in correction_variables("speed")
    ]
    assert ranked[0][0] == "angular velocity"
    assert ranked[0][1] > NEARLY_ALL


@pytest.mark.parametrize("which", range(len(DEFAULT_UNKNOWN_EFFECT.curves)))
def test_a_curve_in_its_place_closes_the_gap(which):
    found = fit_curve(dataset(), of_gain()[0], "angular velocity")[which]
    knots, values = np.asarray(found.effect_type.knots), found.values
    assert np.polyfit(knots, values, 1)[0] == pytest.approx(GAIN, abs=SLOPE)
    before = with_(SpeedGain, gain=GAIN)
    after = with_(found.effect_type, **values_of(values))
    for run, (truth, corrected) in enumerate(zip(before, after, strict=True)):
        x = dataset().channels.index("x")
        gap = np.abs(truth[x] - plain()[run][x])[-1]
        assert np.abs(truth[x] - corrected[x])[-1] < CLOSED * gap


def test_sand_that_loosens_is_an_unknown_zeta_that_follows_the_turning():
    found = disturbances_of(left(with_(Loosening, loss=0.15, decay=1.5)))
    zeta = named(found, "zeta")
    # A slow change of the load sinks the wheel alike.
    assert found[0].name in ("zeta", "force_z")
    assert zeta.evidence > found[0].evidence - DEFAULT_UNKNOWN_EFFECT.tied_evidence
    assert zeta.evidence > named(found, "speed").evidence + DEFAULT_UNKNOWN_EFFECT.tied_evidence
    shares = dict(rank_dependence(dataset(), zeta))
    assert max(shares["turning"], shares["travel"]) > NEARLY_ALL
    assert max(shares, key=lambda each: shares[each]) in ("turning", "travel")
    first, followed = choose_disturbance(dataset(), found)
    assert first.name in ("zeta", "force_z")
    assert followed[0][0] in ("turning", "travel")
    (where, signal), *_ = signal_against(dataset(), zeta, "turning")
    assert where.shape == signal.shape
    assert signal[0] > signal[-2]


def test_a_slope_is_an_unknown_height_that_follows_the_travel():
    found = disturbances_of(left(with_(SurfaceSlope, slope=0.02)))
    first, followed = choose_disturbance(dataset(), found)
    # Rising slowly, the surface and a reading of z differ by the slope's pull alone.
    assert first.name in ("height", "reading z")
    assert {"travel", "turning"} == {name for name, _ in followed[:2]}


def test_a_known_force_is_recovered_within_its_error():
    knots = np.linspace(0, 5, KNOTS)
    truth = np.array([0.0, 0.0, -4.0, -4.0, 2.0, 2.0])
    kind = correction_class("force_x", "time", knots.tolist())
    found = disturbances_of(left(with_(kind, **values_of(truth))))
    assert found[0].name == "force_x"
    inside = []
    for time, signal, error in zip(found[0].time, found[0].signal, found[0].error, strict=True):
        away = np.abs(signal - np.interp(time, knots, truth))
        inside.append(away < SIGMAS * error)
    assert np.concatenate(inside).mean() > NEARLY_EVERYWHERE
    assert dict(rank_dependence(dataset(), found[0]))["time"] > NEARLY_ALL


@pytest.mark.parametrize(
    ("stage", "variable", "knots"),
    [
        ("zeta", "travel", (0.0, 0.05, 0.1, 0.2, 0.3, 0.4)),
        ("reading z", "wheel angle", None),
        ("height", "travel", (-0.1, 0.0, 0.1, 0.2, 0.3, 0.4)),
    ],
)
def test_a_correction_is_an_effect_like_any(stage, variable, knots):
    knots = tuple(np.arange(KNOTS) * 2 * np.pi / KNOTS) if knots is None else knots
    kind = correction_class(stage, variable, knots)
    assert kind is correction_class(stage, variable, list(knots))
    assert not np.any(jnp.stack([kind().at(at) for at in jnp.linspace(-1.0, 7.0, 9)]))
    for null, reference in zip(with_(kind), plain(), strict=True):
        np.testing.assert_array_max_ulp(null, reference, maxulp=ROUNDED)
    small = 0.01 * field_metadata(kind)["at_1"]["typical"]
    moved = with_(kind, at_1=small)[0]
    trial = with_zeta(dataset().trials[0], float(log_zeta()[0]))
    linearized = linearize_run(dataset(), 0, float(log_zeta()[0]))
    of = effect_sensitivity(kind, trial, linearized, jnp.asarray(linearized.node_interval), {}, {})
    slope = np.asarray(propagate(linearized, of))
    nodes = np.asarray(linearized.time)[: int(linearized.nodes) + 1]
    z = slope[: len(nodes), READINGS.index("z"), 1]
    line = small * np.interp(dataset().time(0), nodes, z)
    row = dataset().channels.index("z")
    exact = moved[row] - plain()[0][row]
    assert np.abs(exact).max() > 0
    assert np.abs(exact - line).max() < LINES_ERR * np.abs(exact).max()


class LooserAndLower(MemorylessZetaFactor, AbstractPlane):
    """Acts in two places at once, as an effect of a user's own may."""

    about = EffectInfo("looser_and_lower", "terrain", "ζ = ζ (1 - loss), h = -lower", "two in one")
    loss: Float[Array, ""] = strength("-", 0.02, "share of zeta lost")
    lower: Float[Array, ""] = strength("m", 0.002, "how far the surface lies lower")

    def factor(self, moment, memory):
        return 1 - self.loss

    def plane(self, axle, memory):
        return -self.lower, jnp.zeros_like(axle)


@pytest.mark.parametrize(("field", "small"), [("loss", 2e-4), ("lower", 2e-5)])
def test_an_effect_that_acts_in_two_places_is_seen_in_both(field, small):
    trial = with_zeta(dataset().trials[0], float(log_zeta()[0]))
    linearized = linearize_run(dataset(), 0, float(log_zeta()[0]))
    slope = np.asarray(
        propagate(
            linearized,
            effect_sensitivity(
                LooserAndLower, trial, linearized, jnp.asarray(linearized.node_interval), {}, {}
            ),
        )
    )
    nodes = np.asarray(linearized.time)[: int(linearized.nodes) + 1]
    column = slope[: len(nodes), READINGS.index("z"), ("loss", "lower").index(field)]
    line = small * np.interp(dataset().time(0), nodes, column)
    row = dataset().channels.index("z")
    exact = with_(LooserAndLower, **{field: small})[0][row] - plain()[0][row]
    assert np.abs(exact).max() > 0
    assert np.abs(exact - line).max() < LINES_ERR * np.abs(exact).max()


class StrongerAndReadSo(AbstractStressFactor, AbstractSensor):
    """Bears on plates, and on the scale that their force is read by."""

    about = EffectInfo(
        "stronger_and_read_so", "terrain", "σ = σ (1 + more), F read so", "two in one"
    )
    more: Float[Array, ""] = strength("-", 0.02, "share of stress, and of what is read of it")

    def factor(self, motion):
        return 1 + self.more * jnp.ones_like(motion.depth)

    def begin(self, output):
        return ()

    def read(self, output, dt, memory):
        return replace(output, fz=(1 + self.more) * output.fz), memory


def test_an_effect_on_plates_and_on_a_scale_is_read_once():
    more = 2e-4
    driven = driven_dataset()
    at = log_zeta()[0]
    trial = with_zeta(driven.trials[0], float(at))
    linearized = linearize_run(driven, 0, float(at))
    node = jnp.asarray(linearized.node_interval)
    slope = np.asarray(
        propagate(
            linearized, effect_sensitivity(StrongerAndReadSo, trial, linearized, node, {}, {})
        )
    )
    nodes = np.asarray(linearized.time)[: int(linearized.nodes) + 1]
    fz = slope[: len(nodes), READINGS.index("fz"), 0]
    line = more * np.interp(driven.time(0), nodes, fz)
    model = AugmentedModel((StrongerAndReadSo,))
    strengths = np.array([f.coordinate(more) for f in model.free])
    row = driven.channels.index("fz")
    exact = (
        driven.prediction(model, 0, at, strengths)[row]
        - driven.prediction(AugmentedModel(), 0, at, np.zeros(0))[row]
    )
    # The wheel carries its load all along: what it weighs, read too high by that share.
    weight = float(trial.simulator.rig.mass_z) * 9.81
    assert np.median(exact) == pytest.approx(more * weight, rel=CARRIED)
    assert np.median(line) == pytest.approx(np.median(exact), rel=CARRIED)


def test_a_correction_refuses_what_its_stage_cannot_know():
    knots = list(range(KNOTS))
    with pytest.raises(InputError, match="may follow"):
        correction_class("speed", "sinkage", knots)
    with pytest.raises(InputError, match="stage"):
        correction_class("weather", "time", knots)
    with pytest.raises(InputError, match="must ascend"):
        correction_class("zeta", "time", [0.0] * KNOTS)


def test_one_run_alone_is_described():
    one = RigDataset.of(dataset().runs[:1])
    found = disturbances_of(left(with_(SpeedGain, gain=GAIN))[:1], one)
    assert found[0].name == "speed"
    assert rank_dependence(one, found[0])[0][1] > NEARLY_ALL


def test_a_driven_carriage_has_stages_too():
    driven = driven_dataset()
    at = log_zeta()[:1]
    reference = driven.prediction(AugmentedModel(), 0, at[0], np.zeros(0))
    shifted = reference.copy()
    growing = 2.0 * np.clip(driven.time(0) - 1, 0, 2)
    shifted[driven.channels.index("torque")] += growing
    found = disturbances_of([reference - shifted], driven)
    assert found[0].name == "reading torque"
    # A bend's corner lies between two knots: a little of it, beside the error.
    assert found[0].signal[0][6] == pytest.approx(4.0, abs=SIGMAS * found[0].error[0][6] + 0.05)
    assert "force_x" not in {
        each.name for each in found if each.evidence > DEFAULT_UNKNOWN_EFFECT.tied_evidence
    }
