"""Command of the rig, over one step and over a whole run."""

import itertools
from collections.abc import Iterator

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float


class Command(eqx.Module):
    """The command for one step; with a leading time axis, for a run.

    Attributes:
        omega: Angular velocity at the end of the step, positive driving forward [rad/s].
        vx: Carriage speed at the end of the step [m/s]; used where the carriage is driven.
        zeta: Scaling factor over the step [-]; used where the terrain takes it step by step.
    """

    omega: Float[Array, "*time"]
    vx: Float[Array, "*time"]
    zeta: Float[Array, "*time"]


def command_at(
    time: Float[Array, " steps"],
    command_time: Float[Array, " knots"],
    omega: Float[Array, " knots"],
    vx: Float[Array, " knots"] | None = None,
    zeta: Float[Array, " knots"] | None = None,
) -> Command:
    """A recorded command at other times, linear between its knots and constant beyond them.

    Args:
        time: Times [s], shape (steps,).
        command_time: Knots [s], increasing, shape (knots,).
        omega: Angular velocity at the knots [rad/s], shape (knots,).
        vx: Carriage speed there [m/s]; zero where none is given.
        zeta: Scaling factor there [-]; zero where none is given.

    Returns:
        Commands of shape (steps,).
    """

    def at(values: Float[Array, " knots"] | None) -> Float[Array, " steps"]:
        if values is None:
            return jnp.zeros_like(time)
        return jnp.interp(time, command_time, values)

    return Command(omega=at(omega), vx=at(vx), zeta=at(zeta))


def with_zero_crossings(time: np.ndarray, *channels: np.ndarray) -> tuple[np.ndarray, ...]:
    """A profile with a knot wherever a channel passes through zero.

    The absolute value of each channel is then linear between knots, too.

    Args:
        time: Knots [s], increasing.
        channels: Their values there, linear in between.

    Returns:
        The knots and the channels; those given where none passes through zero.
    """
    zeros = [_zeros(time, values) for values in channels]
    every = np.union1d(time, np.concatenate(zeros))
    if len(every) == len(time):
        return time, *channels
    between = [np.interp(every, time, values) for values in channels]
    for values, at in zip(between, zeros, strict=True):
        values[np.isin(every, at)] = 0.0
    return every, *between


def _zeros(time: np.ndarray, values: np.ndarray) -> np.ndarray:
    before = np.flatnonzero(values[:-1] * values[1:] < 0)
    share = values[before] / (values[before] - values[before + 1])
    return time[before] + share * (time[before + 1] - time[before])


def split_at_reversals(senses: np.ndarray) -> Iterator[tuple[slice, int]]:
    """Stretches between the reversals of a wheel or a drive, and the sense of rotation in each.

    Args:
        senses: Sense of rotation on each sample: 1, -1, or 0 where it stands, shape (samples,).

    Returns:
        Slices of the samples, and 1 or -1; one that stands throughout counts as forward.
    """
    turning = np.flatnonzero(senses)
    backs = turning[1:][np.diff(senses[turning]) != 0]
    for begin, end in itertools.pairwise([0, *backs.tolist(), len(senses)]):
        yield slice(begin, end), -1 if (senses[begin:end] < 0).any() else 1
