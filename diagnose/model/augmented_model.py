"""What a model with some effects gives for every run, and how that changes with its numbers.

One compiled program for each choice of effects serves every step of a fit and every set of runs of
about the same size. Programs of different effects run side by side in threads.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diagnose.model.shared_programs import Held, program_of
from drftjax.effects.base import AbstractEffect
from drftjax.effects.catalogue import field_metadata, shapes, strengths
from drftjax.recorded.batch import PaddedObservations, between_rows
from drftjax.simulation.trial import Trial

# Past this share of the sinkage that a wheel's plates are carried for a model gives no numbers, as
# its own surface or radius may bring other plates into the sand.
COVERED = 0.85


@dataclass(frozen=True)
class FreeField:
    """A number of an effect that is fitted.

    Attributes:
        index: Place of the effect among those added.
        field: The number's name.
        scale: A strength's typical size, one unit of its coordinate; None for a shape, whose
            coordinate is its logarithm.
    """

    index: int
    field: str
    scale: float | None

    def value(self, coordinate):
        """The number, from its coordinate."""
        return jnp.exp(coordinate) if self.scale is None else self.scale * coordinate

    def coordinate(self, value: float) -> float:
        """The coordinate of a number."""
        return float(np.log(value) if self.scale is None else value / self.scale)


@dataclass(frozen=True)
class AugmentedModel:
    """Effects added to the reference model, and which of their numbers are free.

    Attributes:
        effects: Classes of the effects.
        shaped: Whether their shapes are free, or stay at what they are given.
    """

    effects: tuple[type[AbstractEffect], ...] = ()
    shapes_are_free: bool = True

    @property
    def names(self) -> tuple[str, ...]:
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
        """Coordinates at which no effect acts, shapes at their defaults."""
        return np.array(
            [0.0 if f.scale is not None else f.coordinate(self._default(f)) for f in self.free]
        )

    @cached_property
    def program(self) -> tuple["AugmentedModel", tuple[Held, ...], np.ndarray]:
        """What is compiled: a model, its numbers that no fit changes, its coordinates by these."""
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
        """The effects with these coordinates; `held` gives numbers that are not free."""
        values: list[dict] = [dict(each) for each in held] or [{} for _ in self.effects]
        for free, coordinate in zip(self.free, coordinates, strict=True):
            values[free.index][free.field] = free.value(coordinate)
        return tuple(effect(**given) for effect, given in zip(self.effects, values, strict=True))


def with_effects(trial: Trial, effects: tuple[AbstractEffect, ...]) -> Trial:
    """The trial with effects added to what it has."""
    simulator = replace(trial.simulator, effects=trial.simulator.effects + effects)
    return replace(trial, simulator=simulator)


def _predicted(
    model: AugmentedModel,
    held: Sequence[Held],
    channels: tuple[str, ...],
    trial: Trial,
    observed: PaddedObservations,
    log_zeta: Array,
    at: Array,
) -> Array:
    zeta = trial.simulator.terrain.zeta.value * jnp.exp(log_zeta)  # pyright: ignore
    trial = eqx.tree_at(lambda t: t.simulator.terrain.zeta.value, trial, zeta)
    trial = with_effects(trial, model.build(at, held))
    table = trial.run_to(observed.compared_rows, channels)
    return between_rows(_covered(table, channels, trial), observed)


def _covered(table: Array, channels: tuple[str, ...], trial: Trial) -> Array:
    """The channels of a run, or no numbers where its wheel sinks past the plates it carries."""
    if "z" not in channels:
        return table
    cut = trial.simulator.wheel.cut()
    limit = jnp.where(cut.sinkage_limit < cut.radius, COVERED * cut.sinkage_limit, jnp.inf)
    return jnp.where(jnp.max(-table[channels.index("z")]) > limit, jnp.nan, table)


_predict = eqx.filter_jit(_predicted)


def predict(
    model: AugmentedModel,
    channels: tuple[str, ...],
    trial: Trial,
    observed: PaddedObservations,
    log_zeta: Float[Array, ""],
    coordinates: np.ndarray,
) -> Float[Array, "channels samples"]:
    """One run's channels at its recorded times, with effects.

    Args:
        model: Effects added (static).
        channels: Which channels (static).
        trial, observed: The run, padded like the others of its set.
        log_zeta: Logarithm of its zeta over its set-up's.
        coordinates: Free numbers of the effects, shape (free,).

    Returns:
        Simulated channels [m, N, N m].
    """
    program, held, mix = model.program
    at = jnp.asarray(mix @ coordinates, float)
    return _predict(program, held, channels, trial, observed, log_zeta, at)


def predict_with_jacobian(
    model: AugmentedModel,
    channels: tuple[str, ...],
    trial: Trial,
    observed: PaddedObservations,
    log_zeta: Float[Array, ""],
    coordinates: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """As `predict`, with the exact derivative by log zeta and the coordinates, last."""
    program, held, mix = model.program
    at = jnp.asarray(mix @ coordinates, float)
    value, slope = _predict_with_jacobian(program, held, channels, trial, observed, log_zeta, at)
    by_zeta, by_rest = np.split(np.asarray(slope), [1], axis=-1)
    return np.asarray(value), np.concatenate([by_zeta, by_rest @ mix], axis=-1)


@eqx.filter_jit
def _predict_with_jacobian(
    model: AugmentedModel,
    held: Sequence[Held],
    channels: tuple[str, ...],
    trial: Trial,
    observed: PaddedObservations,
    log_zeta: Float[Array, ""],
    coordinates: Float[Array, " free"],
) -> tuple[Float[Array, "channels samples"], Float[Array, "channels samples all"]]:
    def values(both: Array) -> tuple[Array, Array]:
        found = _predicted(model, held, channels, trial, observed, both[0], both[1:])
        return found, found

    both = jnp.concatenate([log_zeta[None], coordinates])
    slope, value = jax.jacfwd(values, has_aux=True)(both)
    return value, slope
