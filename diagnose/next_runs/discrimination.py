"""Design of the next run: the one on which hypotheses that explain the same runs differ most.

Hypotheses are simulated, with the numbers fitted to the runs there are, on variations of those
runs. The run to make is the one on which the readings of the first hypothesis and those of its
nearest rival differ by most noise floors.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import msgspec
import numpy as np

from diagnose.dataset import RigDataset, with_zeta
from diagnose.hypotheses.hypothesis import Hypothesis
from diagnose.model.augmented_model import AugmentedModel, with_effects
from diagnose.run_pool import RunPool
from drftjax.common.arrays import as_real
from drftjax.effects.catalogue import reported_names
from drftjax.recorded.observation import SHOWN, comparable_channels
from drftjax.recorded.prepared_run import PreparedRun
from drftjax.results.advice import ProposedRun
from drftjax.runlog.record import CHANNELS
from drftjax.simulation.step_choice import choose_step
from drftjax.simulation.trial import Trial


@dataclass(frozen=True)
class NextRunSettings:
    """Runs that may be proposed, and the difference that makes one worth proposing.

    Attributes:
        instrument_noise: Noise floor of channels not recorded, by what the instruments of a wheel
            test bed can be trusted to [m, N, N m].
        max_omega: Fastest angular velocity of the wheel [rad/s].
        speed_factors: Speeds that are tried, over that of the run varied [-].
        load_factors: Vertical masses that are tried, likewise [-].
        hold: Time for which the wheel stands, or holds its speed, in stop and go [s].
        acceleration: Of the wheel in stop and go [rad/s2]; less than rigs of the field have.
        min_floors: A smaller difference does not tell hypotheses apart [noise floors].
        log_zeta_step: Step of log zeta by which the change of sinkage is taken [-].
        max_log_zeta_step: Largest change of log zeta by which the mean sinkages of two hypotheses
            are made equal [-].
    """

    instrument_noise: tuple[tuple[str, float], ...] = (
        ("x", 5e-5),
        ("z", 2e-5),
        ("fx", 1.0),
        ("fz", 1.0),
        ("torque", 0.1),
    )
    max_omega: float = float(np.deg2rad(300.0))
    speed_factors: tuple[float, ...] = (0.5, 2.0, 4.0, 8.0)
    load_factors: tuple[float, ...] = (0.7, 1.3)
    hold: float = 0.5
    acceleration: float = 4.0
    min_floors: float = 2.0
    log_zeta_step: float = 0.01
    max_log_zeta_step: float = 0.2


DEFAULT_NEXT_RUN = NextRunSettings()


def next_run(
    dataset: RigDataset,
    first: Hypothesis,
    others: Sequence[Hypothesis],
    floors: Mapping[str, float],
    pool: RunPool,
    settings: NextRunSettings = DEFAULT_NEXT_RUN,
) -> dict:
    r"""Choose the run, and the channel, that would tell hypotheses apart.

    The run v and channel c with the largest $\min_k \mathrm{rms}(y_1 - y_k) / n_c$, over the
    readings y of the first hypothesis and of its rivals k, with the noise floor n.

    Args:
        dataset: The runs there are.
        first, others: Hypotheses fitted to them, the most probable first: the first one is to be
            told from all others, or, where no variation does that, from the most probable of them.
        floors: Noise floor of each recorded channel [m, N, N m].
        pool: Threads.
        settings: Runs that may be proposed.

    Returns:
        Plain values: `tells`, the hypotheses told apart; `run` to make; and `channel` to record on
        a run as made, among those that a diagnosis compares. Either is None where nothing helps.
    """
    base = _typical_run(dataset)
    variations = _variations(dataset, base, settings)

    def differences(variation: Variation) -> list[dict[str, float]]:
        return _differences(variation, base, first, others, settings)

    # The run as it was is simulated first, so that its programs are compiled once.
    by_variation = [differences(variations[0])]
    by_variation += pool.map(differences, variations[1:])
    floor = dict(settings.instrument_noise) | dict(floors)
    compared = comparable_channels(dataset.runs[base].setup.rig.carriage == "driven")
    advice = {}
    for count in sorted({len(others), 1}, reverse=True):
        proposals = []
        for variation, found in zip(variations, by_variation, strict=True):
            proposals += _proposals(variation.words, found[:count], compared, floor)
        hypotheses = (first, *others[:count])
        names = ["+".join(reported_names(each.names) or ("none",)) for each in hypotheses]
        as_made, recorded = variations[0].words, set(dataset.channels)
        advice = {"tells": names} | _best_of(proposals, as_made, recorded, settings.min_floors)
        if advice["run"] or advice["channel"]:
            break
    return advice


def _proposals(
    words: str,
    differences: Sequence[Mapping[str, float]],
    compared: Sequence[str],
    floor: Mapping[str, float],
) -> list[ProposedRun]:
    """A run by channel, with its smallest difference from several hypotheses.

    Args:
        words: The run in words.
        differences: By hypothesis and channel [m, N, N m]; empty where one cannot be simulated.
        compared: Channels that a diagnosis compares.
        floor: Noise floor by channel [m, N, N m].
    """
    if not all(differences):
        return []
    found = []
    for channel in compared:
        difference = min(each[channel] for each in differences)
        unit, scale = SHOWN[channel]
        floors = difference / floor[channel]
        found.append(ProposedRun(words, channel, scale * difference, unit, floors))
    return found


def _best_of(
    proposals: Sequence[ProposedRun], as_made: str, recorded: set[str], min_floors: float
) -> dict:
    """The run to make, and the channel to record on a run as made."""
    already = [p.floors for p in proposals if p.channel in recorded and p.run == as_made]
    new = [
        p
        for p in proposals
        # A run that tells them apart no better than one that is there shows nothing new.
        if p.channel in recorded and p.run != as_made and p.floors > max(already, default=0.0)
    ]
    now = [p for p in proposals if p.channel not in recorded and p.run == as_made]
    return {"run": _best(new, min_floors), "channel": _best(now, min_floors)}


def _best(proposals: Sequence[ProposedRun], min_floors: float) -> dict | None:
    """The proposal of the largest difference, if that is large enough."""
    best = max(proposals, key=lambda each: each.floors, default=None)
    large = best is not None and best.floors >= min_floors
    return msgspec.to_builtins(best) if large else None


@dataclass(frozen=True, eq=False)
class Variation:
    """A run that could be made.

    Attributes:
        words: The run in words.
        trial: The run, padded.
        duration: Time over which it is simulated [s].
    """

    words: str
    trial: Trial
    duration: float


def _shortened(variation: Variation, duration: float = np.inf) -> Variation:
    """The same over `duration` [s] at most, and no longer than its padded rows last.

    The words say so where that shortens the run.
    """
    trial = variation.trial
    duration = min(duration, trial.rows * trial.every * float(trial.step))
    if duration >= variation.duration:
        return variation
    return Variation(f"{variation.words}, its first {duration:.1f} s", trial, duration)


def _with_speed_scaled(trial: Trial, factor: float) -> Trial:
    """The same command with the speeds of wheel and carriage times `factor`."""
    return replace(trial, omega=trial.omega * factor, vx=trial.vx * factor)


def _commanded_travel(trial: Trial) -> float:
    """Travel of the rim or, where the wheel never turns, of the carriage [m], negative backward."""
    omega = np.asarray(trial.omega)
    speed = omega * float(trial.simulator.wheel.radius) if omega.any() else np.asarray(trial.vx)
    return float(np.trapezoid(speed, np.asarray(trial.time)))


def _path_lengths(trial: Trial) -> np.ndarray:
    """Path up to each knot of the faster of rim and carriage [m], never falling, shape (knots,)."""
    time, radius = np.asarray(trial.time), float(trial.simulator.wheel.radius)
    speed = np.maximum(radius * np.abs(np.asarray(trial.omega)), np.abs(np.asarray(trial.vx)))
    return np.append(0.0, np.cumsum(np.diff(time) * (speed[1:] + speed[:-1]) / 2))


def _typical_run(dataset: RigDataset) -> int:
    """Index of the run of median top speed."""
    tops = [float(np.abs(np.asarray(each.trial.omega)).max()) for each in dataset.runs]
    return int(np.argsort(tops)[len(tops) // 2])


def _variations(
    dataset: RigDataset, base: int, settings: NextRunSettings = DEFAULT_NEXT_RUN
) -> list[Variation]:
    """The run as it was, at other speeds, in the other direction, stop and go, other loads."""
    run, trial = dataset.runs[base], dataset.trials[base]
    duration = _end_of_motion(run.trial)
    as_made = Variation(f"{run.name} as it was", trial, duration)
    top = float(np.abs(np.asarray(trial.omega)).max())
    return [
        as_made,
        *_faster_and_slower(dataset, as_made, run.name, top, settings),
        *_other_way(dataset, as_made, run),
        *_started_and_stopped(as_made, run.name, top, settings),
        *_other_loads(as_made, run.name, settings),
    ]


def _faster_and_slower(
    dataset: RigDataset, as_made: Variation, name: str, top: float, settings: NextRunSettings
) -> list[Variation]:
    """The run at other speeds, no farther than the longest run so far."""
    farthest = max(float(_path_lengths(each.trial)[-1]) for each in dataset.runs)
    found = []
    for factor in settings.speed_factors:
        if not 0 < top * factor <= settings.max_omega:
            continue
        scaled = _with_allowed_step(_with_speed_scaled(as_made.trial, factor))
        duration = float(np.interp(farthest, _path_lengths(scaled), np.asarray(scaled.time)))
        words = f"{name} at {np.rad2deg(top * factor):.0f} deg/s"
        found.append(_shortened(Variation(words, scaled, as_made.duration), duration))
    return found


def _other_way(dataset: RigDataset, as_made: Variation, run: PreparedRun) -> list[Variation]:
    """The run in the other direction, where all runs so far went in one."""
    if len({np.sign(_commanded_travel(each.trial)) for each in dataset.runs}) > 1:
        return []
    direction = "backward" if _commanded_travel(run.trial) > 0 else "forward"
    reversed_trial = _with_speed_scaled(as_made.trial, -1.0)
    return [Variation(f"{run.name} {direction}", reversed_trial, as_made.duration)]


def _started_and_stopped(
    as_made: Variation, name: str, top: float, settings: NextRunSettings
) -> list[Variation]:
    if not top > 0:
        return []
    words = f"{name} in stop and go, each time to {np.rad2deg(top):.0f} deg/s"
    trial = _stop_and_go(as_made.trial, top, settings)
    # No longer than the run that it takes the place of.
    return [_shortened(Variation(words, trial, _end_of_motion(trial)), as_made.duration)]


def _other_loads(as_made: Variation, name: str, settings: NextRunSettings) -> list[Variation]:
    """The run with other vertical masses, which start proportionally deeper."""
    trial, found = as_made.trial, []
    for factor in settings.load_factors:
        mass = float(trial.simulator.rig.mass_z) * factor
        loaded = eqx.tree_at(
            lambda t: (t.simulator.rig.mass_z, t.start.position),
            trial,
            (as_real(mass), trial.start.position.at[1].multiply(factor)),
        )
        found.append(Variation(f"{name} with {mass:.1f} kg", loaded, as_made.duration))
    return found


def _stop_and_go(trial: Trial, top: float, settings: NextRunSettings = DEFAULT_NEXT_RUN) -> Trial:
    """The wheel started and stopped over and over.

    Args:
        trial: The run that is varied.
        top: Angular velocity between the ramps [rad/s].
        settings: Time at it and at rest, and how fast the wheel speeds up.
    """
    ramp, hold = top / settings.acceleration, settings.hold
    ends = np.cumsum(np.resize([hold, ramp], len(trial.time) - 1))
    speeds = np.resize([0.0, 0.0, top, top], len(trial.time))
    # A driven carriage keeps the ratio that it had to the wheel at its fastest.
    fastest = int(np.argmax(np.abs(np.asarray(trial.omega))))
    vx = float(trial.vx[fastest] / trial.omega[fastest]) * speeds
    time = jnp.append(0.0, ends)
    return _with_allowed_step(
        replace(trial, time=time, omega=jnp.asarray(speeds), vx=jnp.asarray(vx))
    )


def _with_allowed_step(trial: Trial) -> Trial:
    """The same with a time step chosen for it, over as much of it as can be simulated."""
    # Padded knots lie far beyond the end of the motion.
    last = min(_end_of_motion(trial), trial.rows * trial.every * float(trial.step))
    knots = max(2, int(np.searchsorted(np.asarray(trial.time), last, side="right")))
    time, omega, vx = (each[:knots] for each in (trial.time, trial.omega, trial.vx))
    chosen = choose_step(replace(trial, time=time, omega=omega, vx=vx))
    return replace(trial, step=as_real(chosen.step))


@eqx.filter_jit
def _simulate(model: AugmentedModel, trial: Trial, coordinates, rows):
    return with_effects(trial, model.build(coordinates)).extrapolated(rows, CHANNELS)


def _differences(
    variation: Variation,
    base: int,
    first: Hypothesis,
    others: Sequence[Hypothesis],
    settings: NextRunSettings,
) -> list[dict[str, float]]:
    """RMS difference of the readings of each other hypothesis from the first's, by channel.

    A new run has its own zeta: that of each hypothesis is changed so that its mean sinkage is the
    first one's.

    Args:
        variation: The run.
        base: Index of the run that it is a variation of.
        first, others: Hypotheses.
        settings: Steps of log zeta.

    Returns:
        By hypothesis [m, N, N m]; empty for one that cannot be simulated.
    """
    trial = variation.trial
    rows = min(trial.rows, math.ceil(variation.duration / (trial.every * float(trial.step))))

    def readings(hypothesis: Hypothesis, log_zeta_change: float = 0.0) -> np.ndarray:
        scaled = with_zeta(trial, hypothesis.log_zeta[base] + log_zeta_change)
        at = jnp.asarray(hypothesis.coordinates, float)
        found = _simulate(hypothesis.model, scaled, at, jnp.asarray(rows))
        return np.asarray(jax.block_until_ready(found))[:, : rows + 1]

    z, step, longest = CHANNELS.index("z"), settings.log_zeta_step, settings.max_log_zeta_step
    of_first = readings(first)

    def difference(hypothesis: Hypothesis) -> dict[str, float]:
        found, moved = readings(hypothesis), readings(hypothesis, step)
        slope = (moved[z].mean() - found[z].mean()) / step
        if slope > 0:
            change = (of_first[z] - found[z]).mean() / slope
            found = readings(hypothesis, float(np.clip(change, -longest, longest)))
        power = np.mean((of_first - found) ** 2, axis=1)
        if not np.isfinite(power).all():
            return {}
        return dict(zip(CHANNELS, np.sqrt(power).tolist(), strict=True))

    return [difference(each) for each in others]


def _end_of_motion(trial: Trial) -> float:
    """Time at which the wheel stops for good [s]; the end of a command that ends in motion."""
    time, omega = np.asarray(trial.time), np.asarray(trial.omega)
    moving = np.flatnonzero(omega != 0)
    return float(time[min(moving[-1] + 1, len(time) - 1)]) if moving.size else float(time[-1])
