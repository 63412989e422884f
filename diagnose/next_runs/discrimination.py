"""What to run or record next, so that explanations of the same runs part.

They are simulated, with the numbers fitted to the runs there are, on variations of those runs. The
one to make is where the first one's readings and those of its nearest rival differ by most noise
floors.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from diagnose.dataset import RigDataset, with_zeta
from diagnose.hypotheses.hypothesis import Hypothesis
from diagnose.model.augmented_model import AugmentedModel, with_effects
from drftjax.common.arrays import as_real
from drftjax.effects.catalogue import reported_names
from drftjax.physics.integrator import sharpest_ramp, steady_step
from drftjax.recorded.observation import SHOWN, comparable_channels
from drftjax.recorded.prepared_run import STEPS_A_ROW
from drftjax.runlog.record import CHANNELS
from drftjax.simulation.trial import Trial

# What the instruments of a wheel test bed can be trusted to, of channels not recorded [m, N, N m].
TRUSTED = {"x": 5e-5, "z": 2e-5, "fx": 1.0, "fz": 1.0, "torque": 0.1}


# A rig's limits: fastest wheel [rad/s], and the load over the one that was run.
FASTEST = np.deg2rad(300.0)


SPEEDS = (0.5, 2.0, 4.0, 8.0)


LOADS = (0.7, 1.3)


# Stop and go: how long the wheel stands, or holds its speed, each time [s].
HELD = 0.5


# Differences under so many floors part nothing.
TELLING = 2.0


@dataclass(frozen=True)
class NextRun:
    """A run, and how far two explanations part on it.

    Attributes:
        run: The run in words.
        channel: The channel in which they part most.
        difference: Root mean square of how they differ there, in `unit`.
        unit: Of the difference.
        floors: The same in noise floors.
    """

    run: str
    channel: str
    difference: float
    unit: str
    floors: float

    def document(self) -> dict:
        """Plain values."""
        return {
            "run": self.run,
            "channel": self.channel,
            "difference": self.difference,
            "unit": self.unit,
            "floors": self.floors,
        }


def next_run(
    case: RigDataset, first: Hypothesis, others: Sequence[Hypothesis], floors: Mapping[str, float]
) -> dict:
    """The variation of a run that parts hypotheses, and the channel that would part them now.

    Args:
        case: The runs there are.
        first, others: Hypotheses settled on them, the likeliest first: one is to be told from all
            others, or, where no variation does that, from the likeliest of them.
        floors: Noise floor of each recorded channel [m, N, N m].

    Returns:
        Plain values: `tells` the hypotheses apart, `run` to make, and `channel` to record on a run
        as made, among those that a diagnosis compares; either is None where nothing helps.
    """
    base = _typical(case)
    variations = _variations(case, base)
    # Compiled by the run as it was, before every thread needs the programs.
    parted = [_separation(variations[0], base, first, others)]
    parted += case.threads.map(lambda each: _separation(each, base, first, others), variations[1:])
    floor = TRUSTED | dict(floors)
    driven = case.runs[base].setup.rig.carriage == "driven"
    advice = {}
    for count in sorted({len(others), 1}, reverse=True):
        proposals = []
        for variation, apart in zip(variations, parted, strict=True):
            proposals += _proposals(
                variation.words, apart[:count], comparable_channels(driven), floor
            )
        told = (first, *others[:count])
        advice = {"tells": ["+".join(reported_names(each.names) or ("none",)) for each in told]}
        advice |= _best_of(proposals, variations[0].words, set(case.channels))
        if advice["run"] or advice["channel"]:
            break
    return advice


def _proposals(
    words: str,
    apart: Sequence[Mapping[str, float]],
    compared: Sequence[str],
    floor: Mapping[str, float],
) -> list[NextRun]:
    """A run, by channel, with how far it parts the one of several that it parts least."""
    if not all(apart):
        return []
    found = []
    for channel in compared:
        difference = min(each[channel] for each in apart)
        unit, scale = SHOWN[channel]
        floors = difference / floor[channel]
        found.append(NextRun(words, channel, scale * difference, unit, floors))
    return found


def _best_of(proposals: Sequence[NextRun], as_it_was: str, recorded: set[str]) -> dict:
    """The run to make, and the channel to record on a run as made."""
    told = [p.floors for p in proposals if p.channel in recorded and p.run == as_it_was]
    new = [
        p
        for p in proposals
        # What parts them no better than a run that is there tells nothing new.
        if p.channel in recorded and p.run != as_it_was and p.floors > max(told, default=0.0)
    ]
    now = [p for p in proposals if p.channel not in recorded and p.run == as_it_was]
    return {"run": _best(new), "channel": _best(now)}


def _best(proposals: Sequence[NextRun]) -> dict | None:
    best = max(proposals, key=lambda each: each.floors, default=None)
    return best.document() if best is not None and best.floors >= TELLING else None


@dataclass(frozen=True, eq=False)
class Variation:
    """A run that could be made.

    Attributes:
        words: The run in words.
        trial: The run, padded.
        lasts: Time over which it is simulated [s].
    """

    words: str
    trial: Trial
    lasts: float


def _upto(variation: Variation, lasts: float = np.inf) -> Variation:
    """The same over so much time [s] at most, which the words say where it cuts the run short.

    Nor is it longer than the rows there are, which a shorter step makes shorter.
    """
    trial = variation.trial
    lasts = min(lasts, trial.rows * STEPS_A_ROW * float(trial.step))
    if lasts >= variation.lasts:
        return variation
    return Variation(f"{variation.words}, its first {lasts:.1f} s", trial, lasts)


def _scaled(trial: Trial, factor: float) -> Trial:
    """The same command at so many times the speed, the carriage's too."""
    return replace(trial, omega=trial.omega * factor, vx=trial.vx * factor)


def _goes(trial: Trial) -> float:
    """How far rim or, where the wheel never turns, carriage go [m], negative backward."""
    omega = np.asarray(trial.omega)
    speed = omega * float(trial.simulator.wheel.radius) if omega.any() else np.asarray(trial.vx)
    return float(np.trapezoid(speed, np.asarray(trial.time)))


def _ways(trial: Trial) -> np.ndarray:
    """The longer way of rim and carriage up to each knot [m], either way round."""
    time, radius = np.asarray(trial.time), float(trial.simulator.wheel.radius)
    speed = np.maximum(radius * np.abs(np.asarray(trial.omega)), np.abs(np.asarray(trial.vx)))
    return np.append(0.0, np.cumsum(np.diff(time) * (speed[1:] + speed[:-1]) / 2))


def _typical(case: RigDataset) -> int:
    """The run of middling top speed."""
    tops = [float(np.abs(np.asarray(c.trial.omega)).max()) for c in case.runs]
    return int(np.argsort(tops)[len(tops) // 2])


def _variations(case: RigDataset, base: int) -> list[Variation]:
    candidate = case.runs[base]
    trial, lasted = case.trials[base], _end(candidate.trial)
    found = [Variation(f"{candidate.name} as it was", trial, lasted)]
    top = float(np.abs(np.asarray(trial.omega)).max())
    made = [each.trial for each in case.runs]
    farthest = max(float(_ways(each)[-1]) for each in made)
    for factor in SPEEDS:
        if 0 < top * factor <= FASTEST:
            faster = _steady(_scaled(trial, factor))
            lasts = float(np.interp(farthest, _ways(faster), np.asarray(faster.time)))
            words = f"{candidate.name} at {np.rad2deg(top * factor):.0f} deg/s"
            found.append(_upto(Variation(words, faster, lasted), lasts))
    # A run that goes the other way has been made where any has.
    if len({np.sign(_goes(each)) for each in made}) == 1:
        way = "backward" if _goes(candidate.trial) > 0 else "forward"
        found.append(Variation(f"{candidate.name} {way}", _scaled(trial, -1.0), lasted))
    if top > 0:
        words = f"{candidate.name} in stop and go, each time to {np.rad2deg(top):.0f} deg/s"
        starts_and_stops = _stop_and_go(trial, top)
        found.append(_upto(Variation(words, starts_and_stops, _end(starts_and_stops))))
    for factor in LOADS:
        mass = float(trial.simulator.rig.mass_z) * factor
        heavier = eqx.tree_at(
            lambda t: (t.simulator.rig.mass_z, t.start.position),
            trial,
            (
                as_real(mass),
                trial.start.position.at[1].multiply(factor),
            ),
        )
        found.append(Variation(f"{candidate.name} with {mass:.1f} kg", heavier, lasted))
    return found


def _stop_and_go(trial: Trial, top: float) -> Trial:
    """The same wheel started and stopped over and over, as sharply as the shortest step allows."""
    ramp = top / sharpest_ramp(float(trial.simulator.wheel.radius))
    held = np.cumsum(np.resize([HELD, ramp], len(trial.time) - 1))
    speeds = np.resize([0.0, 0.0, top, top], len(trial.time))
    # A driven carriage goes as it did beside the wheel at its fastest.
    fastest = int(np.argmax(np.abs(np.asarray(trial.omega))))
    vx = float(trial.vx[fastest] / trial.omega[fastest]) * speeds
    time = jnp.append(0.0, held)
    return _steady(replace(trial, time=time, omega=jnp.asarray(speeds), vx=jnp.asarray(vx)))


def _steady(trial: Trial) -> Trial:
    """The same at a step that its command allows."""
    radius = float(trial.simulator.wheel.radius)
    step = steady_step(radius, np.asarray(trial.time), np.asarray(trial.omega))
    return replace(trial, step=as_real(step))


@eqx.filter_jit
def _simulated(model: AugmentedModel, trial: Trial, coordinates, rows):
    return with_effects(trial, model.build(coordinates)).run_to(rows, CHANNELS)


def _separation(
    variation: Variation, base: int, first: Hypothesis, others: Sequence[Hypothesis]
) -> list[dict[str, float]]:
    """Root mean square of how each of the others' readings differ, by channel [m, N, N m].

    Its zeta is moved so that both sink alike on the mean: a new run has its own. Nothing is told of
    one that cannot be simulated.
    """
    trial = variation.trial
    rows = min(trial.rows, math.ceil(variation.lasts / (STEPS_A_ROW * float(trial.step))))

    def of(hypothesis: Hypothesis, more: float = 0.0) -> np.ndarray:
        scaled = with_zeta(trial, hypothesis.log_zeta[base] + more)
        at = jnp.asarray(hypothesis.coordinates, float)
        found = _simulated(hypothesis.model, scaled, at, jnp.asarray(rows))
        return np.asarray(jax.block_until_ready(found))[:, : rows + 1]

    z = CHANNELS.index("z")
    one = of(first)

    def apart(other: Hypothesis) -> dict[str, float]:
        two, moved = of(other), of(other, 0.01)
        slope = (moved[z].mean() - two[z].mean()) / 0.01
        if slope > 0:
            two = of(other, float(np.clip((one[z] - two[z]).mean() / slope, -0.2, 0.2)))
        power = np.mean((one - two) ** 2, axis=1)
        if not np.isfinite(power).all():
            return {}
        return dict(zip(CHANNELS, np.sqrt(power).tolist(), strict=True))

    return [apart(each) for each in others]


def _end(trial: Trial) -> float:
    """When the wheel is last asked to move [s]; the end of a command that ends in motion."""
    time, omega = np.asarray(trial.time), np.asarray(trial.omega)
    moving = np.flatnonzero(omega != 0)
    return float(time[min(moving[-1] + 1, len(time) - 1)]) if moving.size else float(time[-1])
