"""Which runs repeat each other, and the noise floor that their difference tells."""

import copy
import dataclasses
import itertools
from types import SimpleNamespace

import numpy as np
import pytest

from diagnose.gap.noise_floor import noise_floors
from drftjax.recorded.noise_floor import DEFAULT_NOISE_FLOOR
from drftjax.recorded.prepared_run import PreparedRun, prepare_run
from drftjax.recorded.repeats import RepeatTolerances, group_by_condition
from drftjax.setups.setup import SetUp
from identify.cluster.result_codec import decode_result, encode_result
from identify.commands.fit_cluster import _together
from identify.results.findings import between_run_sentences
from identify.results.noise_floor import _pairs, noise_floor, repeated_runs
from identify.results.result import FitResult
from identify.results.values import RunFit, Value
from tests.helpers.synthetic_runs import recorded, setup_of

# Of millimetres, where two differences are nothing but their roundings [m].
ROUNDING = 1e-15
# 4,000 differences tell their mean square to 2 %, the readings' own noise to as much.
SCATTER = 0.04
PROFILE = ([0.0, 0.3, 1.3, 2.0], [0.0, 0.0, 0.5, 0.5])


@pytest.fixture(scope="module")
def whole() -> PreparedRun:
    return prepare_run("whole", recorded(setup_of(PROFILE), rate=100.0))


def changed(one: PreparedRun, **numbers) -> PreparedRun:
    """The same run under a command or a set-up that differs in some numbers."""
    setup: SetUp = copy.deepcopy(one.setup)
    for name, value in numbers.items():
        part, field = name.split("_", 1)
        setattr(getattr(setup, part), field, value)
    return dataclasses.replace(one, setup=setup)


def stopped(one: PreparedRun, end: float) -> PreparedRun:
    """The same run stopped early [s]."""
    keep = one.observation.time <= end
    observation = dataclasses.replace(
        one.observation,
        time=one.observation.time[keep],
        values=one.observation.values[:, keep],
        counts=one.observation.counts[keep],
    )
    time = [0.0, 0.3, 1.3, end]
    return dataclasses.replace(
        changed(one, command_time=time, command_omega=PROFILE[1]), observation=observation
    )


def test_a_run_that_was_stopped_early_is_of_the_condition_of_the_whole_one(whole):
    assert group_by_condition([whole, stopped(whole, 1.6)]) == [[0, 1]]


def test_the_same_profile_told_by_more_knots_is_the_same_command(whole):
    more = changed(
        whole, command_time=[0.0, 0.3, 0.8, 1.3, 2.0], command_omega=[0.0, 0.0, 0.25, 0.5, 0.5]
    )
    assert group_by_condition([whole, more]) == [[0, 1]]


@pytest.mark.parametrize(
    "other",
    [
        {"command_omega": [0.0, 0.0, 0.5, 0.51]},
        {"command_time": [0.0, 0.3, 1.3, 5.0]},
        {"command_vx": [0.0, 0.0, 0.05, 0.05]},
        {"rig_mass_z": 30.0},
        {"terrain_zeta": 0.3},
    ],
)
def test_another_command_load_length_or_sand_is_another_condition(whole, other):
    assert group_by_condition([whole, changed(whole, **other)]) == [[0], [1]]


@pytest.mark.parametrize("share", [1e-4, 1e-3, -1e-3])
def test_a_measured_speed_within_what_a_drive_holds_is_the_same_command(whole, share):
    speeds = np.array(PROFILE[1]) * (1 + share)
    assert group_by_condition([whole, changed(whole, command_omega=[*speeds])]) == [[0, 1]]


def test_a_scattered_measured_speed_is_the_same_command(whole):
    time = np.linspace(0.0, 2.0, 401)
    omega = np.interp(time, *PROFILE)
    scattered = [
        changed(whole, command_time=[*time], command_omega=[*(omega + noise)])
        for noise in 0.005 * np.random.default_rng(4).standard_normal((2, len(time)))
    ]
    assert group_by_condition([whole, *scattered]) == [[0, 1, 2]]


def test_a_speed_that_swings_about_the_same_mean_is_another_command(whole):
    time = np.linspace(0.0, 2.0, 401)
    swinging = np.interp(time, *PROFILE) + 0.05 * np.sin(20 * np.pi * time)
    other = changed(whole, command_time=[*time], command_omega=[*swinging])
    assert group_by_condition([whole, other]) == [[0], [1]]


def test_runs_at_two_carriage_speeds_are_two_conditions(whole):
    slow, fast = (changed(whole, command_vx=[0.0, 0.0, v, v]) for v in (0.05, 0.06))
    assert group_by_condition([slow, fast, slow]) == [[0, 2], [1]]


def test_carriages_tuned_to_their_sinkage_repeat_each_other(whole):
    # What two runs of a rig in the loop differ by, each tuned by its own sinkage.
    one, again = (changed(whole, command_vx=[0.0, 0.0, v, v]) for v in (0.0777, 0.0778))
    assert group_by_condition([one, again]) == [[0, 1]]


def test_tolerances_of_a_repeat_can_be_varied(whole):
    fits = [fitted("a", 0.7), altered(fitted("b", 0.7, 5e-4), rig_mass_z=18.85)]
    assert repeated_runs(fits) == []
    assert repeated_runs(fits, RepeatTolerances(relative=1e-3)) == [[0, 1]]
    assert noise_floor(fits, RepeatTolerances(relative=1e-3)) == pytest.approx(
        {"z": 5e-4 / np.sqrt(2)}
    )
    sands = [whole, changed(whole, terrain_zeta=0.3)]
    assert group_by_condition(sands, RepeatTolerances(log_zeta=2.0)) == [[0, 1]]
    assert group_by_condition([whole, stopped(whole, 1.6)], RepeatTolerances(shared=0.9)) == [
        [0],
        [1],
    ]


def test_fits_and_diagnoses_call_the_same_runs_repeats(whole):
    """Carriages tuned to their sinkage too, and runs of which one was stopped half way."""
    for other in (
        {"command_vx": [0.0, 0.0, 0.0777, 0.0777]},
        {"command_time": [0.0, 0.3, 1.3, 1.5]},
        {"rig_damping_z": 3.0},
        {"wheel_width": 0.11},
    ):
        driven = {"command_vx": [0.0, 0.0, 0.0778, 0.0778]} if "command_vx" in other else {}
        prepared = [changed(whole, **driven), changed(whole, **other)]
        fits = [altered(fitted("a", 0.7), **each) for each in (driven, other)]
        groups = [each for each in group_by_condition(prepared) if len(each) > 1]
        assert groups == repeated_runs(fits)


@pytest.mark.parametrize("what", ["lengths", "sands", "paces"])
def test_the_order_of_the_runs_is_no_matter(whole, what):
    # The first and the last of three are no repeats, though each is one of the middle run.
    brief = changed(whole, command_time=[0.0, 0.3, 0.8], command_omega=[0.0, 0.0, 0.25])
    runs = {
        "lengths": [whole, stopped(whole, 1.5), brief],
        "sands": [changed(whole, terrain_zeta=zeta) for zeta in (0.7, 0.82, 0.96)],
        "paces": [changed(whole, command_vx=[0.0, 0.0, v, v]) for v in (0.05, 0.0507, 0.0514)],
    }[what]
    found = set()
    for order in itertools.permutations(range(3)):
        groups = group_by_condition([runs[k] for k in order])
        found.add(frozenset(frozenset(order[k] for k in group) for group in groups))
    assert found == {frozenset([frozenset([0, 1]), frozenset([2])])}


def dataset_of(runs: list[PreparedRun], channels=("x", "z"), times=None) -> SimpleNamespace:
    """What a noise floor asks of a dataset, at all samples of its runs or at given times."""

    def recording(run: int) -> np.ndarray:
        known = runs[run].observation.by_channel()
        return np.array([[0.0 if each in known else np.nan] for each in channels])

    return SimpleNamespace(
        runs=runs,
        channels=channels,
        time=lambda run: runs[run].observation.time if times is None else times[run],
        recording=recording,
        holds=[SimpleNamespace(masses={}) for _ in runs],
    )


def pair_of(whole: PreparedRun, short: PreparedRun) -> SimpleNamespace:
    return dataset_of([whole, short])


def of_one_length(run: int) -> np.ndarray:
    raise AssertionError(f"run {run} was recorded as long as the other")


def lifted(*lengths: int):
    """A larger zeta lifts the wheel and bears on nothing else."""
    return lambda run: np.stack([np.zeros(lengths[run]), np.ones(lengths[run])])


def test_the_floor_is_what_two_repeats_differ_by_while_both_go_on(whole):
    short = stopped(whole, 1.6)
    case = pair_of(whole, short)
    apart = 1e-3
    residual = [np.zeros((2, len(each.observation.time))) for each in (whole, short)]
    # To and fro, so that both miss the same mean sinkage.
    residual[1] += apart * np.where(np.arange(residual[1].shape[1]) % 2, 1, -1)
    own = {"x": 0.0, "z": 3e-4}
    response = lifted(*(each.shape[1] for each in residual))
    floors, how = noise_floors(case, residual, residual, own, response)  # pyright: ignore
    # Of an odd number of samples, one has none to outweigh it.
    share = 1 / residual[1].shape[1] ** 2
    assert floors == pytest.approx(
        {"x": apart / np.sqrt(2), "z": np.hypot(apart / np.sqrt(2), 3e-4)}, rel=2 * share
    )
    assert "whole and whole" in how


def test_what_grows_in_two_repeats_is_no_chance_where_one_is_shorter(whole):
    """Each has the zeta that matches its mean sinkage, and they are means over other times."""
    short = stopped(whole, 1.6)
    case, own = pair_of(whole, short), {"x": 0.0, "z": 0.0}
    time = [each.observation.time for each in (whole, short)]
    residual = [np.stack([0 * t, 1e-3 * (t - t.mean())]) for t in time]
    response = lifted(*map(len, time))
    floors, _ = noise_floors(case, residual, residual, own, response)  # pyright: ignore
    assert floors == pytest.approx({"x": 0.0, "z": 0.0}, abs=ROUNDING)
    # Of fits, whose other numbers move too, only runs of about one length are compared.
    fits = [fitted("a", 0.7), altered(fitted("b", 0.7, 5e-4), samples=80)]
    assert repeated_runs(fits) == [[0, 1]]
    assert noise_floor(fits) == {}


def test_repeats_of_a_channel_are_those_that_have_it(whole):
    """The run between them, which lacks it, is no matter."""
    lacking = dataclasses.replace(
        whole,
        observation=dataclasses.replace(
            whole.observation,
            channels=("z",),
            values=whole.observation.values[1:],
            noise=whole.observation.noise[1:],
        ),
    )
    runs = [whole, lacking, whole]
    case = dataset_of(runs)
    residual = [np.zeros((2, len(whole.observation.time))) for _ in runs]
    residual[2][0] = 1e-3
    own = {"x": 0.0, "z": 0.0}
    floors, _ = noise_floors(case, residual, residual, own, of_one_length)  # pyright: ignore
    assert floors == pytest.approx({"x": 1e-3 / np.sqrt(2), "z": 0.0})
    case = dataset_of([lacking, lacking, whole])
    _, how = noise_floors(case, residual, residual, own, of_one_length)  # pyright: ignore
    assert how.endswith("; that of x, which no repeats have, from fast scatter.")


# Samples that repeats may lose, under 5 % of them.
LOST = {
    "a gap": lambda time: (time < 0.98) | (time > 1.06),
    "a late start": lambda time: time > 0.08,
    "an early end": lambda time: time < 1.93,
}


@pytest.mark.parametrize("lost", LOST.values(), ids=LOST)
@pytest.mark.parametrize("shorter", [0, 1])
def test_samples_that_one_of_two_repeats_lost_are_not_compared(whole, lost, shorter):
    """Both miss by the same wave, which no straight line between two samples far apart follows."""
    time = whole.observation.time
    kept = [np.ones(len(time), bool), np.ones(len(time), bool)]
    kept[shorter] = lost(time)
    case = dataset_of([whole, whole], ("z",), [time[each] for each in kept])
    residual = [1e-3 * np.sin(5 * time[each])[None] for each in kept]
    response = lambda run: np.ones((1, int(kept[run].sum())))  # noqa: E731
    floors, _ = noise_floors(case, residual, residual, {"z": 0.0}, response)  # pyright: ignore
    assert floors == {"z": 0.0}
    fits = []
    for each, wave in zip(kept, residual, strict=True):
        run = fitted(f"run {len(fits)}", 0.75)
        channels = {"recorded": 0 * wave, "before": wave, "after": wave}
        counts = np.ones(int(each.sum()), bool)
        fits.append(dataclasses.replace(run, time=time[each], counts=counts, **channels))
    assert noise_floor(fits) == {"z": 0.0}


def test_without_repeats_the_floor_is_the_noise_of_the_runs_that_have_the_channel(whole):
    observation = whole.observation
    lacking = dataclasses.replace(
        observation,
        channels=("z",),
        values=observation.values[1:],
        noise=observation.noise[1:],
    )
    other = dataclasses.replace(changed(whole, rig_mass_z=25.0), observation=lacking)
    case = dataset_of([whole, other])
    # What is left scatters by more than the readings do.
    random = np.random.default_rng(0)
    scale = 10 * np.array(observation.noise)[:, None]
    residual = [scale * random.standard_normal((2, len(observation.time))) for _ in range(2)]
    own = {"x": 0.0, "z": 0.0}
    floors, how = noise_floors(case, residual, residual, own, of_one_length)  # pyright: ignore
    assert floors == pytest.approx(dict(zip(("x", "z"), observation.noise, strict=True)))
    assert "No run was repeated" in how


def fitted(name: str, zeta: float, wrong: float = 0.0, status: str = "converged") -> RunFit:
    """A run fitted to a recording that it misses by `wrong` in z [m]."""
    time = np.linspace(0.0, 2.0, 101)
    error = np.inf if status == "diverged" else 1e-4
    recorded, simulated = np.zeros((1, 101)), np.full((1, 101), wrong)
    return RunFit(
        name=name,
        setup=setup_of(PROFILE),
        values={"terrain.zeta": Value(zeta, error, "-", "zeta")},
        time=time,
        counts=time <= 2.0,
        channels=("z",),
        recorded=recorded,
        before=simulated,
        after=simulated,
        status=status,
    )


def altered(run: RunFit, delay: float = 0.0, samples: int | None = None, **numbers) -> RunFit:
    """The same run by another clock, of fewer samples, or with other numbers in its set-up."""
    kept = slice(samples)
    setup = copy.deepcopy(run.setup)
    for name, value in numbers.items():
        part, field = name.split("_", 1)
        setattr(getattr(setup, part), field, value)
    channels = {n: getattr(run, n)[:, kept] for n in ("recorded", "before", "after")}
    time, counts = run.time[kept] + delay, run.counts[kept]
    return dataclasses.replace(run, setup=setup, time=time, counts=counts, **channels)


@pytest.mark.parametrize(
    "other",
    [
        {"delay": 1e-3},
        {"samples": -1},
        {"command_omega": [0.0, 0.0, 0.5 + 1e-12, 0.5]},
        {"command_time": [7.0, 7.3, 8.3, 9.0]},
        {"rig_mass_z": 18.837 * (1 + 1e-9)},
    ],
)
def test_clocks_and_roundings_make_no_other_run(other):
    run = fitted("a", 0.7)
    assert repeated_runs([run, altered(run, **other)]) == [[0, 1]]
    # What differs by half a millimetre differs by it, whatever the clocks.
    off = fitted("b", 0.7, 5e-4)
    floor = noise_floor([run, altered(off, **other)])
    assert floor == pytest.approx({"z": 5e-4 / np.sqrt(2)})


@pytest.mark.parametrize("order", [*itertools.permutations(range(3))])
def test_the_floor_of_repeats_is_the_same_in_any_order(order):
    fits = [fitted("a", 0.7), fitted("b", 0.7, 5e-4), fitted("c", 0.7, 2e-3)]
    # Three differences, each shared by two: 0.5, 2 and 1.5 mm.
    expected = 5e-4 * np.sqrt((1 + 16 + 9) / 6)
    assert noise_floor([fits[n] for n in order]) == pytest.approx({"z": expected})


def test_a_repeat_too_short_to_compare_parts_no_others():
    fits = [fitted("a", 0.7), altered(fitted("b", 0.7), samples=80), fitted("c", 0.7, 5e-4)]
    assert repeated_runs(fits) == [[0, 1, 2]]
    assert noise_floor(fits) == pytest.approx({"z": 5e-4 / np.sqrt(2)})


@pytest.mark.parametrize(("size", "pairs"), [(2, 1), (4, 6), (21, 210), (300, 3000)])
def test_each_repeat_is_held_against_others_once(size, pairs):
    found = [frozenset(pair) for pair in _pairs(range(size), DEFAULT_NOISE_FLOOR.max_partners)]
    assert len(found) == len({*found}) == pairs


@pytest.mark.parametrize("delay", [0.0, 1.25e-4, 2.5e-4])
def test_reading_a_repeat_between_its_samples_loses_no_noise(delay):
    noise = 20e-6
    random = np.random.default_rng(4)
    time, fits = np.linspace(0.0, 2.0, 4001), []
    for late in (0.0, delay):
        wave = noise * random.standard_normal((1, len(time)))
        run = fitted(f"run {late}", 0.75)
        channels = {"recorded": 0 * wave, "before": wave, "after": wave}
        counts = np.ones(len(time), bool)
        fits.append(dataclasses.replace(run, time=time + late, counts=counts, **channels))
    assert noise_floor(fits)["z"] == pytest.approx(noise, rel=SCATTER)


@pytest.mark.parametrize("delay", [0.0, 2.5e-4])
def test_a_diagnosis_loses_no_noise_between_samples_either(whole, delay):
    noise, time = 20e-6, np.linspace(0.0, 2.0, 4001)
    random = np.random.default_rng(5)
    observation = dataclasses.replace(whole.observation, noise=np.full(2, noise))
    told = dataclasses.replace(whole, observation=observation)
    case = dataset_of([told, told], ("z",), [time, time + delay])
    residual = [noise * random.standard_normal((1, len(time))) for _ in range(2)]
    response = lambda run: np.zeros((1, len(time)))  # noqa: E731
    floors, _ = noise_floors(case, residual, residual, {"z": 0.0}, response)  # pyright: ignore
    assert floors["z"] == pytest.approx(noise, rel=SCATTER)


@pytest.mark.parametrize(
    "other",
    [
        {"rig_drawbar_load": 30.0},
        {"rig_mass_z": 18.85},
        {"rig_carriage": "driven"},
        {"wheel_grouser_height": 0.017},
        {"command_omega": [0.0, 0.0, 0.5, 0.51]},
    ],
)
def test_fits_of_another_load_wheel_or_command_are_no_repeats(other):
    run = fitted("a", 0.7)
    assert repeated_runs([run, altered(run, **other)]) == []


@pytest.mark.parametrize("order", list(itertools.permutations(range(3))))
def test_a_fit_goes_with_the_longest_run_that_it_repeats_in_any_order(order):
    # The first and last are too far apart in length, the middle one is near enough to both.
    runs = [
        altered(fitted(f"{end}", 0.7), command_time=[7.0, 7.1, 7.2, end]) for end in (9, 8.2, 7.9)
    ]
    groups = repeated_runs([runs[k] for k in order])
    assert [{order[k] for k in group} for group in groups] == [{0, 1}]


def test_a_rig_is_compared_as_it_was_believed_to_be():
    run = fitted("a", 0.7)
    other = altered(run, rig_mass_z=18.9)
    believed = (run.setup.wheel, run.setup.rig)
    fits = [dataclasses.replace(each, believed=believed) for each in (run, other)]
    assert repeated_runs(fits) == [[0, 1]]
    assert (
        decode_result(encode_result(FitResult({}, fits[1:], "converged", 1, {}))).run.believed
        == believed
    )


def test_a_run_that_diverged_says_nothing_of_what_runs_differ_by():
    runs = [fitted("a", 0.70), fitted("b", 0.75, 2e-4), fitted("c", 0.80)]
    told = between_run_sentences(runs)
    assert [sentence.split(" ")[0] for sentence in told] == ["zeta", "repeated"]
    assert "scatters by 6.7 %" in told[0]
    assert "z 0.115 mm" in told[1]
    assert between_run_sentences([*runs, fitted("lost", 0.78, 0.1, "diverged")]) == told


def test_runs_fitted_on_a_cluster_are_compared_as_in_one_process():
    runs = [fitted("a", 0.70), fitted("b", 0.75, 2e-4), fitted("c", 0.80)]
    lone = [
        FitResult(
            {}, [run], "converged", 5, {}, [f"{run.name} is fine", *between_run_sentences([run])]
        )
        for run in runs
    ]
    together = _together(
        {run.name: encode_result(each) for run, each in zip(runs, lone, strict=True)},
        {run.name: 64 * run.name for run in runs},
        {},
    )
    assert together.findings == [
        *between_run_sentences(runs),
        "a is fine",
        "b is fine",
        "c is fine",
    ]
