"""The reference model with effects added: its prediction of a run, and the Jacobian of that.

One compiled program for each choice of effects serves every step of a fit and every set of runs of
about the same size. Programs of different effects run side by side in threads.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diagnose.model.carriage_hold import SPEEDS, holding_forces
from diagnose.model.shared_programs import Held, program_of
from drftjax.effects.base import AbstractEffect
from drftjax.effects.catalogue import field_metadata, shapes, strengths
from drftjax.physics.wheel import GrouserWheel
from drftjax.recorded.batch import PaddedObservations, between_rows
from drftjax.runlog.record import CHANNELS
from drftjax.simulation.trial import Trial

# Past this share of the sinkage that a wheel's plates are carried for [-] a prediction is NaN, as a
# model's own surface or radius may bring other plates into the sand.
MAX_COVERED_SHARE = 0.85

# Each of these makes every simulation longer by a twentieth and more, at its null, too. All others
# together make it longer by a third: one program has them all, in place of one for each set.
COSTLY_EFFECTS = frozenset(
    (
        *("depth_power", "depth_hardening", "rate_hardening", "cohesion", "rigid_floor"),
        *("height_decrease_arc", "measurement_delay"),
        *("surface_incline", "surface_profile", "surface_bump"),
    )
)

# In these stages effects act one after another, each on what the last one left.
ORDERED_STAGES = ("drive", "sensor")

# Columns of the programs that differentiate. Each number of columns is a program of its own. With
# that of zeta, eight fill a vector.
COLUMN_COUNTS = (7, 15, 23)


@dataclass(frozen=True)
class FreeField:
    """A number of an effect that is fitted, by its coordinate.

    A strength is its coordinate times its typical size; a shape is the exponential of its
    coordinate.

    Attributes:
        index: Place of the effect among those added.
        field: The number's name.
        scale: A strength's typical size, in its unit; None for a shape.
    """

    index: int
    field: str
    scale: float | None

    def value(self, coordinate):
        """The number, in its unit, from its coordinate."""
        return jnp.exp(coordinate) if self.scale is None else self.scale * coordinate

    def coordinate(self, value: float) -> float:
        """The coordinate of a number given in its unit."""
        return float(np.log(value) if self.scale is None else value / self.scale)


@dataclass(frozen=True)
class AugmentedModel:
    """Effects added to the reference model, and which of their numbers are free.

    Attributes:
        effects: Classes of the effects.
        shapes_are_free: Shapes are fitted too, or stay at what they are given.
    """

    effects: tuple[type[AbstractEffect], ...] = ()
    shapes_are_free: bool = True

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects."""
        return tuple(each.about.name for each in self.effects)

    @cached_property
    def free(self) -> tuple[FreeField, ...]:
        """The free numbers, in the order of the coordinates."""
        found = []
        for index, effect in enumerate(self.effects):
            about = field_metadata(effect)
            found += [FreeField(index, name, about[name]["typical"]) for name in strengths(effect)]
            if self.shapes_are_free:
                found += [FreeField(index, name, None) for name in shapes(effect)]
        return tuple(found)

    def null(self) -> np.ndarray:
        """Coordinates at which no effect acts, shapes at their defaults, shape (free,)."""
        return self._null.copy()

    @cached_property
    def _null(self) -> np.ndarray:
        return np.array(
            [0.0 if f.scale is not None else f.coordinate(self._default(f)) for f in self.free]
        )

    @cached_property
    def program(self) -> tuple["AugmentedModel", tuple[Held, ...], np.ndarray]:
        """The model that is compiled in place of this one.

        Returns:
            That model, its numbers that no fit changes by effect, and its coordinates as a linear
            map of this model's, shape (its free numbers, free numbers).
        """
        programs = [program_of(each) for each in self.effects]
        general = AugmentedModel(tuple(each.effect for each in programs), self.shapes_are_free)
        mix = np.zeros((len(general.free), len(self.free)))
        for column, own in enumerate(self.free):
            names = strengths(self.effects[own.index])
            for row, free in enumerate(general.free):
                if free.index != own.index:
                    continue
                if own.scale is None:
                    mix[row, column] = free.field == own.field
                elif free.scale is not None:
                    part = programs[own.index].mix
                    place = strengths(programs[own.index].effect).index(free.field)
                    mix[row, column] = part[place, names.index(own.field)] * own.scale / free.scale
        return general, tuple(each.held for each in programs), mix

    def _default(self, free: FreeField) -> float:
        return float(getattr(self.effects[free.index](), free.field))

    def build(self, coordinates, held: Sequence[Held] = ()) -> tuple[AbstractEffect, ...]:
        """The effects with numbers.

        Args:
            coordinates: Free numbers, shape (free,).
            held: By effect, numbers that are not free.
        """
        numbers: list[dict] = [dict(each) for each in held] or [{} for _ in self.effects]
        for free, coordinate in zip(self.free, coordinates, strict=True):
            numbers[free.index][free.field] = free.value(coordinate)
        return tuple(effect(**given) for effect, given in zip(self.effects, numbers, strict=True))


REFERENCE = AugmentedModel()


@dataclass(frozen=True, eq=False)
class Program:
    """The model that is compiled to simulate another, and that one's coordinates within it.

    Attributes:
        model: The model that is compiled.
        held: Its numbers that no fit changes by effect.
        start: Its coordinates where no effect of the other acts, shape (its free numbers,).
        mix: Its coordinates over `start` as a linear map of the other's, shape (its free numbers,
            free numbers).
    """

    model: AugmentedModel
    held: tuple[Held, ...]
    start: np.ndarray
    mix: np.ndarray


def shared_model(effects: Sequence[type[AbstractEffect]]) -> AugmentedModel:
    """Model with those of some effects that cost little: its program simulates any set of them.

    Args:
        effects: All that a diagnosis chooses from.
    """
    return AugmentedModel(tuple(e for e in effects if e.about.name not in COSTLY_EFFECTS))


@cache
def program_within(model: AugmentedModel, shared: AugmentedModel) -> Program:
    """The program that simulates a model: that of a larger one, with what this lacks.

    A model has a program of its own where it is the reference model, where its shapes are held,
    where a curve is in it, or where its effects act in another order than the larger one's.

    Args:
        model: The model.
        shared: Model with many effects; those that the other lacks stay at their null.
    """
    alone, held, mix = model.program
    lacking = sorted({*model.effects} - {*shared.effects}, key=lambda e: e.about.name)
    whole = AugmentedModel((*shared.effects, *lacking))
    fits = model.effects and model.shapes_are_free and alone.effects == model.effects
    if not (shared.effects and fits and _in_one_order(model, whole)):
        return Program(alone, held, np.zeros(len(mix)), mix)
    start, rows = _within(model, whole)
    mix = np.zeros((len(start), len(rows)))
    mix[rows, np.arange(len(rows))] = 1
    return Program(whole, ({},) * len(whole.effects), start, mix)


def _in_one_order(model: AugmentedModel, whole: AugmentedModel) -> bool:
    """Tell whether effects of a stage that has an order act in the same one in a larger model."""

    def ordered(effects: Sequence[type[AbstractEffect]]) -> list[type[AbstractEffect]]:
        return [e for e in effects if e in model.effects and e.about.stage in ORDERED_STAGES]

    return ordered(model.effects) == ordered(whole.effects)


def _within(model: AugmentedModel, whole: AugmentedModel) -> tuple[np.ndarray, list[int]]:
    """Coordinates of a whole model where no effect of a part acts, and the places of the part's."""
    places = {(whole.effects[f.index], f.field): row for row, f in enumerate(whole.free)}
    rows = [places[model.effects[f.index], f.field] for f in model.free]
    start = whole.null()
    start[rows] = 0
    return start, rows


def with_effects(trial: Trial, effects: tuple[AbstractEffect, ...]) -> Trial:
    """The trial with effects added to what it has."""
    simulator = replace(trial.simulator, effects=trial.simulator.effects + effects)
    return replace(trial, simulator=simulator)


def _simulate(
    model: AugmentedModel,
    held: Sequence[Held],
    channels: tuple[str, ...],
    trial: Trial,
    observed: PaddedObservations,
    log_zeta: Array,
    coordinates: Array | np.ndarray,
) -> Array:
    zeta = trial.simulator.terrain.zeta.value * jnp.exp(log_zeta)  # pyright: ignore
    trial = eqx.tree_at(lambda t: t.simulator.terrain.zeta.value, trial, zeta)
    trial = with_effects(trial, model.build(coordinates, held))
    table = trial.run_to(observed.compared_rows, (*channels, *SPEEDS))
    table = holding_forces(table, channels, trial)
    return between_rows(_nan_past_coverage(table, channels, trial), observed)


# A run beyond this has run away, as with a damping below zero [m, N, N m]. Products of what goes
# much further pass the range of numbers.
RUN_AWAY = 1e12
# A rounding below no grousers is none [m].
SHORTEST = 1e-9


def _nan_past_coverage(table: Array, channels: tuple[str, ...], trial: Trial) -> Array:
    """The channels of a run, or no numbers where it runs away, or sinks past its plates.

    Nor are there any of a wheel whose grousers would be shorter than none.
    """
    # No number is below the bound either, and the largest of several is not always found as none.
    lost = ~jnp.all(jnp.abs(table) <= RUN_AWAY)
    wheel = trial.simulator.adjusted().wheel
    if isinstance(wheel, GrouserWheel):
        lost |= wheel.grouser_height < -SHORTEST
    if "z" in channels:
        cut = trial.simulator.wheel.cut()
        limit = jnp.where(
            cut.sinkage_limit < cut.radius, MAX_COVERED_SHARE * cut.sinkage_limit, jnp.inf
        )
        lost |= jnp.max(-table[channels.index("z")]) > limit
    return jnp.where(lost, jnp.nan, table)


_simulate_compiled = eqx.filter_jit(_simulate)


# One program simulates all channels, whichever were recorded: it serves the runs of every rig.
def _rows_of(channels: tuple[str, ...]) -> list[int]:
    """Places of some channels among all."""
    return [CHANNELS.index(each) for each in channels]


def _of_all_channels(observed: PaddedObservations, channels: tuple[str, ...]) -> PaddedObservations:
    """The recording with an error by the step for every channel, and without what was read."""
    error = np.zeros((len(CHANNELS), observed.step_error.shape[-1]), observed.step_error.dtype)
    error[_rows_of(channels)] = observed.step_error
    nothing = np.zeros(0, error.dtype)
    return replace(observed, values=nothing, weight=nothing, step_error=error)


def predict(
    model: AugmentedModel,
    channels: tuple[str, ...],
    trial: Trial,
    observed: PaddedObservations,
    log_zeta: Float[Array, ""],
    coordinates: np.ndarray,
    shared: AugmentedModel = REFERENCE,
) -> np.ndarray:
    """Simulate one run with effects, at its recorded times.

    Args:
        model: Effects added (static).
        channels: Which channels.
        trial, observed: The run, padded like the others of its dataset.
        log_zeta: Logarithm of its zeta over its set-up's [-].
        coordinates: Free numbers of the effects, shape (free,).
        shared: Model whose program simulates this one, if it may; see `program_within`.

    Returns:
        Simulated channels [m, N, N m], shape (channels, samples); NaN where the wheel sinks past
        the plates it carries, or runs away.
    """
    program = program_within(model, shared)
    at = program.start + program.mix @ coordinates
    seen = _of_all_channels(observed, channels)
    found = _simulate_compiled(program.model, program.held, CHANNELS, trial, seen, log_zeta, at)
    return np.asarray(found)[_rows_of(channels)]


@dataclass(frozen=True, eq=False)
class Directions:
    """The program that is compiled to differentiate a model, and the directions along which.

    Attributes:
        program: The model that is compiled.
        held: Its numbers that no fit changes by effect.
        start: Its coordinates where no effect acts, shape (its free numbers,).
        mix: Its coordinates as a linear map of the model's, shape (its free numbers, columns);
            columns past the model's free numbers are zero.
        free: Number of the model's free numbers.
    """

    program: AugmentedModel
    held: tuple[Held, ...]
    start: np.ndarray
    mix: np.ndarray
    free: int

    @property
    def key(self) -> tuple[AugmentedModel, int]:
        """Model and number of columns: they tell one compiled program from another."""
        return self.program, self.mix.shape[1]

    def at(self, coordinates: np.ndarray) -> np.ndarray:
        """The program's coordinates [-] at the model's, shape (free,)."""
        return self.start + self.mix[:, : self.free] @ coordinates


def directions_within(model: AugmentedModel, common: AugmentedModel) -> Directions:
    """Differentiate a model by the program of a larger one, if that has all of its effects.

    That program is compiled once for all of them.

    Args:
        model: The model.
        common: Model with many effects; those that the other lacks stay at their null.
    """
    if not (model.shapes_are_free and set(model.effects) <= set(common.effects)):
        program, held, mix = model.program
        return Directions(program, held, np.zeros(len(mix)), mix, len(model.free))
    start, rows = _within(model, common)
    columns = next(count for count in (*COLUMN_COUNTS, len(common.free)) if count >= len(rows))
    mix = np.zeros((len(common.free), columns))
    mix[rows, np.arange(len(rows))] = 1
    return Directions(common, ({},) * len(common.effects), start, mix, len(rows))


def predict_with_jacobian(
    directions: Directions,
    channels: tuple[str, ...],
    trial: Trial,
    observed: PaddedObservations,
    log_zeta: Float[Array, ""],
    coordinates: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Simulate one run with effects, and differentiate it in forward mode.

    Args:
        directions: Of the model.
        channels: Which channels.
        trial, observed: The run, padded like the others of its dataset.
        log_zeta: Logarithm of its zeta over its set-up's [-].
        coordinates: Free numbers of the model's effects, shape (free,).

    Returns:
        Simulated channels [m, N, N m] in whole steps of the trial, shape (channels, samples), and
        their derivatives by (log zeta, coordinates), shape (channels, samples, 1 + free).
    """
    mix, free, at = directions.mix, directions.free, directions.at(coordinates)
    along = np.zeros((1 + mix.shape[1], 1 + len(at)))
    along[0, 0] = 1
    along[1:, 1:] = mix.T
    seen = _of_all_channels(observed, channels)
    value, slope = _predict_with_jacobian(
        directions.program,
        directions.held,
        CHANNELS,
        trial,
        seen,
        log_zeta,
        jnp.asarray(at, float),
        jnp.asarray(along, float),
    )
    rows = _rows_of(channels)
    return np.asarray(value)[rows], np.asarray(slope)[rows][..., : 1 + free]


# Change of log zeta, and of numbers in their typical sizes, over which a secant is taken [-].
SECANT = 0.05


def slopes(
    directions: Directions,
    channels: tuple[str, ...],
    trial: Trial,
    observed: PaddedObservations,
    log_zeta: Float[Array, ""],
    coordinates: np.ndarray,
) -> np.ndarray:
    """Derivatives of one run, or its secants where it has no derivative that is of use.

    Where a wheel breaks loose a derivative may be a million times what any change that can be seen
    does to the run (`diagnose.model.linearized_run.without_growth`).

    Arguments as for `predict_with_jacobian`.

    Returns:
        By (log zeta, coordinates) [m, N, N m], shape (channels, samples, 1 + free); zero where
        nothing can be run.
    """
    run = channels, trial, observed
    _, found = predict_with_jacobian(directions, *run, log_zeta, coordinates)
    # The height changes by about the sinkage times a change of log zeta, and by less for all else.
    most = 2 * float(trial.simulator.wheel.radius)
    if "z" not in channels or np.abs(found[channels.index("z")]).max() <= most:
        return found
    seen, rows = _of_all_channels(observed, channels), _rows_of(channels)

    def simulated(step: np.ndarray) -> np.ndarray:
        """The run at a step of (log zeta, coordinates)."""
        model, at = (directions.program, directions.held), directions.at(coordinates + step[1:])
        zeta = log_zeta + step[0]
        return np.asarray(
            _simulate_compiled(*model, CHANNELS, trial, seen, zeta, jnp.asarray(at, float))
        )[rows]

    steps = SECANT * np.eye(1 + directions.free)
    here, found = simulated(np.zeros(len(steps))), np.zeros_like(found)
    for column, ahead in enumerate(steps):
        for step, sense in ((ahead, 1), (-ahead, -1)):
            change = simulated(step) - here
            # Behind, where ahead the wheel sinks past its plates; nothing, where it does here.
            if np.isfinite(change).all():
                found[..., column] = sense * change / SECANT
                break
    return found


@eqx.filter_jit
def _predict_with_jacobian(
    model: AugmentedModel,
    held: Sequence[Held],
    channels: tuple[str, ...],
    trial: Trial,
    observed: PaddedObservations,
    log_zeta: Float[Array, ""],
    coordinates: Float[Array, " free"],
    along: Float[Array, "columns all"],
) -> tuple[Float[Array, "channels samples"], Float[Array, "channels samples columns"]]:
    # A slope is as good in longer steps.
    trial = eqx.tree_at(lambda t: t.parts, trial, jnp.ones_like(trial.parts))

    def values(both: Array) -> Array:
        return _simulate(model, held, channels, trial, observed, both[0], both[1:])

    both = jnp.concatenate([log_zeta[None], coordinates])
    pushed = jax.vmap(lambda each: jax.jvp(values, (both,), (each,)), out_axes=(None, -1))
    return pushed(along)
