"""Where a gap lies: shares worked out by hand, and lines put into made-up errors."""

import dataclasses
from functools import cache

import numpy as np
import pytest

from diagnose.dataset import RigDataset
from diagnose.gap.gap import gaps
from diagnose.linear.linearized_runs import linearize_run
from diagnose.localization.kinematics import PHASES, kinematics_of_run
from diagnose.localization.localization import localization_sentence, localize
from diagnose.localization.settings import LocalizationSettings
from diagnose.localization.shares import GapShare, bootstrap_counts
from drftjax.runlog.record import Measured, RecordedCommand, RunLog
from tests.helpers.synthetic_runs import FAST, FAST_STEP, SLOW, coarse, recorded, setup_of

# Shares that are sums of squares alone are exact; a band's edge leaks a little of a line.
EXACT = 1e-9
LEAK = 0.12
# Phases end where the slope of a command that is read every 20 ms has half changed: of 12 s, each
# edge may be an eighth of one off, and a steady phase has two.
EDGE = 0.03
# An angle summed up over samples of 20 ms at 0.5 rad/s counts each at one end.
SAMPLE = 0.02
# A ripple's slope is that of a grid whose ends lie elsewhere by a rounding [m/rad].
RIPPLE = 1e-6
FLOOR = {"x": 1e-4, "z": 1e-4, "fx": 1.0, "fz": 1.0, "torque": 0.1}


@cache
def template(driven: bool = False) -> RunLog:
    vx = [0.0, 0.0, 0.06, 0.06] if driven else None
    channels = ("z", "fx", "fz", "torque") if driven else ("x", "z")
    return recorded(setup_of(SLOW, vx=vx), channels=channels)


def run_of(speed: float, seconds: float = 12.0, vx: bool = False, sampled: float = 0.02) -> RunLog:
    """A run that stands for 1 s, speeds up for 1 s, keeps its speed [rad/s], slows down for 1 s."""
    knots = np.array([0.0, 1.0, 2.0, seconds - 1.0, seconds])
    omega = np.array([0.0, 0.0, speed, speed, 0.0])
    time = np.arange(0, seconds, sampled)
    x = 0.1 * np.interp(time, knots, np.r_[0, 0, 0.5 * speed, speed * (seconds - 2.5), 0])
    values = {"z": np.full(len(time), -0.02), "x": x}
    if vx:
        values |= {name: np.ones(len(time)) for name in ("fx", "fz", "torque")}
    command = RecordedCommand(knots, omega, 0.1 * omega if vx else None)
    return dataclasses.replace(
        template(vx), command=command, measured=Measured(time=time, **values)
    )


def case_of(*runs: RunLog, masses: tuple[float, ...] = ()) -> RigDataset:
    candidates = [coarse(f"run {k}", run) for k, run in enumerate(runs)]
    for each, mass in zip(candidates, masses, strict=False):
        each.setup.rig.mass_z = mass
    return RigDataset.of(candidates)


def clock(case: RigDataset, run: int = 0) -> np.ndarray:
    """Time of a run's samples from its first command on [s]."""
    return case.time(run) + case.runs[run].rest_left_out


def nothing(case: RigDataset) -> list[np.ndarray]:
    return [np.zeros((len(case.channels), len(case.time(run)))) for run in range(len(case.runs))]


def on(shares: list[GapShare], axis: str) -> dict[str, float]:
    return {each.label: each.share for each in shares if each.axis == axis}


def check(shares: list[GapShare]) -> None:
    """On each axis shares add up to one, each within its interval."""
    for axis in {each.axis for each in shares}:
        assert sum(on(shares, axis).values()) == pytest.approx(1, abs=EXACT), axis
    for each in shares:
        assert 0 <= each.interval[0] <= each.share <= each.interval[1] <= 1 + EXACT, each


def test_shares_of_a_made_up_gap_are_its_squares():
    case = case_of(run_of(0.5), run_of(1.0), masses=(18.0, 14.0))
    z = case.channels.index("z")
    residual = nothing(case)
    time = clock(case)
    steady, late = (time > 2.5) & (time < 10.5), (time > 11.2) & (time < 11.8)
    residual[0][z, steady] = 2e-4
    residual[1][z, late] = 4e-4
    first, second = 4.0 * steady.sum(), 16.0 * late.sum()
    shares = localize(case, residual, FLOOR)
    check(shares)
    expected = first / (first + second)
    assert on(shares, "run")["run 0"] == pytest.approx(expected, abs=EXACT)
    assert on(shares, "load")["18 kg on the wheel"] == pytest.approx(expected, abs=EXACT)
    assert on(shares, "phase")["steady"] == pytest.approx(expected, abs=EXACT)
    assert on(shares, "phase")["decelerate"] == pytest.approx(1 - expected, abs=EXACT)
    assert on(shares, "channel")["z"] == pytest.approx(1, abs=EXACT)
    assert on(shares, "profile")["up to 28.6 deg/s in 12 s"] == pytest.approx(expected, abs=EXACT)


def test_runs_count_by_their_time_however_often_they_were_sampled():
    case = case_of(run_of(0.5), run_of(0.5, sampled=0.1))
    z = case.channels.index("z")
    residual = nothing(case)
    for each in residual:
        each[z] = 2e-4
    shares = localize(case, residual, FLOOR)
    check(shares)
    assert on(shares, "run")["run 0"] == pytest.approx(0.5, abs=EXACT)
    spent = {each.label: each.time for each in shares if each.axis == "run"}
    assert spent["run 0"] == pytest.approx(0.5, abs=EXACT)
    residual[0][z] = 4e-4
    gap = gaps(case, residual, nothing(case), FLOOR)["z"]
    assert gap.before == pytest.approx(np.sqrt((16e-8 + 4e-8) / 2), rel=EXACT)


def test_one_early_slip_does_not_count_for_ever():
    case = case_of(run_of(0.5))
    residual = nothing(case)
    time = clock(case)
    residual[0][case.channels.index("x"), time >= 1.5] = 5e-3
    shares = localize(case, residual, FLOOR)
    check(shares)
    # But for its edge.
    assert on(shares, "phase")["accelerate"] > 1 - EDGE


def test_time_spent_is_told_beside_the_share():
    case = case_of(run_of(0.5))
    residual = nothing(case)
    # The second that the wheel stands at first is left out.
    # All of the gap in one second of the nine that the wheel turns steadily.
    residual[0][:, (clock(case) > 5) & (clock(case) < 6)] = 1e-4
    assert on(localize(case, residual, FLOOR), "phase")["steady"] == pytest.approx(1, abs=EXACT)
    phases = {e.label: e.time for e in localize(case, residual, FLOOR) if e.axis == "phase"}
    assert phases["steady"] == pytest.approx(9 / 11, abs=EDGE)
    assert phases["stand"] < EDGE


def wave(case: RigDataset, run: int, order: float | None, hertz: float = 0.0) -> np.ndarray:
    """A millimetre's wave while the wheel turns, in its angle or in time."""
    time = case.time(run)
    knots = case.runs[run].trial
    omega = np.interp(time, np.asarray(knots.time), np.asarray(knots.omega))
    angle = np.cumsum(omega) * 0.02
    phase = 2 * np.pi * hertz * time if order is None else order * angle
    return 1e-3 * np.sin(phase) * (omega > 0)


@pytest.mark.parametrize(
    ("order", "hertz", "label"),
    [
        (1.0, 0.0, "once a turn"),
        (12.0, 0.0, "grouser passing (12 a turn)"),
        (7.0, 0.0, "drive order 7"),
        (None, 3.0, "at 3 Hz, whatever the speed"),
    ],
)
def test_a_line_is_named_by_what_it_is_locked_to(order, hertz, label):
    case = case_of(*(run_of(speed, 20.0) for speed in (1.5, 2.4, 3.3)))
    residual = nothing(case)
    for run, each in enumerate(residual):
        each[case.channels.index("z")] = wave(case, run, order, hertz)
    shares = localize(case, residual, FLOOR)
    check(shares)
    found = on(shares, "order")
    near = {name: share for name, share in found.items() if name == label}
    assert sum(near.values()) > 1 - LEAK, found
    assert label in localization_sentence(shares)


def without(run: RunLog, begin: float, end: float) -> RunLog:
    """The run without the samples between two times [s]."""
    measured = run.measured
    kept = (measured.time < begin) | (measured.time > end)
    channels = {name: values[kept] for name, values in measured.channels().items()}
    return dataclasses.replace(run, measured=Measured(time=measured.time[kept], **channels))


def test_a_line_keeps_its_frequency_where_samples_were_lost():
    case = case_of(*(without(run_of(speed, 20.0), 8.0, 10.0) for speed in (1.5, 2.4, 3.3)))
    residual = nothing(case)
    for run, each in enumerate(residual):
        each[case.channels.index("z")] = wave(case, run, None, 3.0)
    shares = localize(case, residual, FLOOR)
    check(shares)
    assert on(shares, "order")["at 3 Hz, whatever the speed"] > 1 - LEAK


def test_in_few_turns_a_drift_is_no_period():
    case = case_of(*(run_of(speed, 12.0) for speed in (0.5, 1.5)))
    assert max(np.ptp(kinematics_of_run(case, run).turning) for run in (0, 1)) < 3 * 2 * np.pi
    residual = nothing(case)
    for run, each in enumerate(residual):
        each[case.channels.index("z")] = 1e-4 * clock(case, run)
    shares = localize(case, residual, FLOOR)
    check(shares)
    found = on(shares, "order")
    assert "once a turn" not in found
    assert found["once a turn or slower"] > 1 - LEAK
    assert "a turn" not in localization_sentence(shares)


def test_runs_of_few_turns_beside_one_of_many_are_booked_apart():
    case = case_of(run_of(0.5, 20.0), run_of(1.5, 20.0))
    residual = nothing(case)
    for run, each in enumerate(residual):
        each[case.channels.index("z")] = wave(case, run, 1.0)
    shares = localize(case, residual, FLOOR)
    check(shares)
    found = on(shares, "order")
    assert found["once a turn"] == pytest.approx(0.5, abs=LEAK)
    assert found["once a turn or slower"] == pytest.approx(0.5, abs=LEAK)


def part(label: str, share: float, time: float = 0.1) -> GapShare:
    return GapShare("phase", label, share, (share, share), time)


def test_most_is_half_at_least():
    much = [part("steady", 0.3, 0.6), part("accelerate", 0.4), part("stand", 0.3, 0.3)]
    assert localization_sentence(much).startswith(
        "Much of the gap lies in the phase “accelerate” (40%"
    )
    load = [GapShare("load", f"{m} kg", s, (s, s), 0.5) for m, s in ((18, 0.8), (14, 0.2))]
    assert localization_sentence(load).startswith("Most of the gap lies at 18 kg (80%")
    both = localization_sentence([*much, *load])
    assert both.startswith("Most of the gap lies at 18 kg (80%")
    assert "; much of it in the phase “accelerate” (40%" in both


def test_a_driven_carriage_has_a_slip_and_forces():
    case = case_of(run_of(0.5, vx=True))
    residual = nothing(case)
    residual[0][case.channels.index("fx")] = 3.0
    residual[0][case.channels.index("torque")] = 0.1
    shares = localize(case, residual, FLOOR)
    check(shares)
    assert on(shares, "channel")["fx"] == pytest.approx(0.9, abs=EXACT)
    assert "travel" in {each.axis for each in shares}
    assert sum(s for label, s in on(shares, "slip").items() if "standing" not in label) > 10 / 12


def test_what_is_drawn_does_not_hang_on_names_of_groups():
    numbers = [*range(8), *range(8)]
    sizes = [4] * len(numbers)
    named = [f"{number} kg on the wheel" for number in numbers]
    one, other = (
        bootstrap_counts(np.random.default_rng(0), sizes, each) for each in (numbers, named)
    )
    np.testing.assert_array_equal(one, other)


def test_no_gap_has_no_shares():
    case = case_of(run_of(0.5))
    assert localize(case, nothing(case), FLOOR) == []
    assert localize(case, [], FLOOR) == []
    assert localize(case, [np.zeros((2, 0))], FLOOR) == []
    assert localization_sentence([]) == "There is no gap to speak of."


def test_a_sentence_names_where_the_gap_is_dense():
    case = case_of(run_of(0.5), run_of(1.0))
    residual = nothing(case)
    for each in residual:
        each[case.channels.index("z"), clock(case) > 11.0] = 1e-3
    told = localization_sentence(localize(case, residual, FLOOR))
    assert "“decelerate”" in told
    assert "in z beside the changes of x (" in told


def test_bands_and_thresholds_can_be_varied():
    case = case_of(run_of(0.5), run_of(1.0))
    residual = nothing(case)
    for each in residual:
        each[case.channels.index("z"), clock(case) > 11.0] = 1e-3
    settings = LocalizationSettings(frequency_edges=(0.5,), min_named_share=1.0)
    shares = localize(case, residual, FLOOR, settings)
    bands = [each for each in shares if each.axis == "frequency"]
    assert [each.label for each in bands] == ["under 0.5 Hz", "over 0.5 Hz"]
    assert sum(each.share for each in bands) == pytest.approx(1.0)
    assert "spread about evenly" in localization_sentence(shares, settings)


def test_a_wheel_that_turns_back_slows_down_and_speeds_up_and_its_turning_counts_either_way():
    knots, omega = (
        np.array([0.0, 1.0, 2.0, 4.0, 8.0, 10.0]),
        np.array([0.0, 0.0, 0.5, 0.5, -0.5, -0.5]),
    )
    run = run_of(0.5, 10.0)
    motion = kinematics_of_run(
        case_of(dataclasses.replace(run, command=RecordedCommand(knots, omega))), 0
    )
    assert motion.angle[-1] == pytest.approx(0.25 + 1 + 0 - 1, abs=SAMPLE)
    assert motion.turning[-1] == pytest.approx(0.25 + 1 + 1 + 1, abs=SAMPLE)
    phases = np.array(PHASES)[motion.phase]
    time = motion.time + 1.0  # which it stood
    assert set(phases[(time > 4.5) & (time < 5.5)]) == {"decelerate"}
    assert set(phases[(time > 6.5) & (time < 7.5)]) == {"accelerate"}


def test_a_grouser_s_ripple_is_told_of_a_wheel_that_turns_backward():
    time, omega = FAST
    along = []
    for sense in (1, -1):
        setup = setup_of((time, [sense * each for each in omega]))
        # A run backward is the mirror image of one forward by this form only.
        setup.terrain.bisector = "arc"
        setup.integrator.step, setup.start.angle = FAST_STEP, sense * 0.1
        each = coarse("run", recorded(setup, noise=0.0), model=setup, step=FAST_STEP)
        along.append(linearize_run(RigDataset.of([each]), 0, 0.0))
    forward, backward = (np.asarray(each.ripple)[: int(each.nodes)] for each in along)
    assert np.all(np.abs(forward).max(axis=0) > 10 * RIPPLE)
    np.testing.assert_allclose(backward * [1, -1], forward, rtol=0, atol=RIPPLE)


def test_shares_of_noise_add_up():
    case = case_of(*(run_of(0.5 + 0.1 * k, 24.0) for k in range(9)))
    residual = [np.random.default_rng(0).normal(size=each.shape) for each in nothing(case)]
    check(localize(case, residual, FLOOR))
