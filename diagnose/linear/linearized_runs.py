"""All runs of a dataset, linearised along the reference model at one zeta each."""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

from diagnose.dataset import RigDataset, pitch, with_zeta
from diagnose.model.linearized_run import (
    DEFAULT_LINEARIZATION,
    LinearizationSettings,
    LinearizedRun,
    linearize,
    steps_per_node,
    with_ripple,
    without_growth,
)
from diagnose.run_pool import RunPool
from drftjax.recorded.batch import padded_size

# Nodes are padded to this at least; padding costs next to nothing.
MIN_PADDED_NODES = 2304


@dataclass(frozen=True, eq=False)
class LinearizedRuns:
    """The reference model's runs at given zetas, and their linearisations.

    Attributes:
        log_zeta: Log zeta of each run over its set-up's [-], shape (runs,).
        runs: By run.
    """

    log_zeta: np.ndarray
    runs: tuple[LinearizedRun, ...]


def linearize_runs(
    dataset: RigDataset,
    log_zeta: np.ndarray,
    pool: RunPool,
    settings: LinearizationSettings = DEFAULT_LINEARIZATION,
) -> LinearizedRuns:
    """Linearise every run of a dataset at its zeta.

    Args:
        dataset: The runs.
        log_zeta: Log zeta of each run over its set-up's [-], shape (runs,).
        pool: Threads.
        settings: Numbers of the linearisation.
    """

    def of(run: int) -> LinearizedRun:
        return linearize_run(dataset, run, float(log_zeta[run]), settings)

    # The first alone, or every thread would compile the one program that all share.
    first = of(0)
    return LinearizedRuns(np.asarray(log_zeta), (first, *pool.map(of, dataset.run_numbers[1:])))


def linearize_run(
    dataset: RigDataset,
    run: int,
    log_zeta: float,
    settings: LinearizationSettings = DEFAULT_LINEARIZATION,
) -> LinearizedRun:
    """Linearise one run of a dataset, padded like the others.

    Args:
        dataset: The runs.
        run: Number of the run.
        log_zeta: Its log zeta over its set-up's [-].
        settings: Numbers of the linearisation.
    """
    trial = with_zeta(dataset.trials[run], log_zeta)
    steps = [steps_per_node(each, settings.node_time) for each in dataset.trials]
    rows = np.asarray(dataset.batch.observed.compared_rows)
    nodes = [int(r) * t.every // s for r, t, s in zip(rows, dataset.trials, steps, strict=False)]
    size = max(MIN_PADDED_NODES, padded_size(max(nodes)))
    found = linearize(trial, jnp.asarray(steps[run]), jnp.asarray(nodes[run]), size)
    return with_ripple(without_growth(found, settings), pitch(trial), settings)
