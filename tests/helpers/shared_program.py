"""Runs of any length, step and number of rows by one compiled program for each kind of rig."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from drftjax.physics.state import Output
from drftjax.simulation.trial import Trial, pad_to_shared_size

CHANNELS = tuple(field.name for field in dataclasses.fields(Output))


@eqx.filter_jit
def _made(trial: Trial, rows) -> Output:
    return Output(*trial.run_to(rows, CHANNELS))


def whole_run(trial: Trial) -> Output:
    """The run as `Trial.run` makes it, as arrays of NumPy, shape (1 + rows,)."""
    output = _made(pad_to_shared_size(trial), jnp.asarray(trial.rows))
    return jax.tree.map(lambda values: np.asarray(values)[: trial.rows + 1], output)
