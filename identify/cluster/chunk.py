"""A few runs of a fit of all together, as a worker simulates and differentiates them.

A chunk is bytes: recordings, set-ups and the noise model. What comes of it depends on these, on the
options and on the coordinates alone, so any worker may compute it, and compute it again.
"""

import pickle
from collections.abc import Sequence
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from drftjax.cluster.worker_process import set_up_worker
from identify.cluster.fit_options import FitOptions, fit_parameters

if TYPE_CHECKING:
    from identify.solver.problem import Problem


def encode_chunk(problem: "Problem", runs: Sequence[int]) -> bytes:
    """Return some runs of a problem as bytes.

    Args:
        problem: All runs.
        runs: Places of the chunk's; one that comes again fills the chunk up and is not simulated.
    """
    import equinox as eqx
    import jax

    places = np.asarray(runs)
    batch = jax.tree.map(
        lambda leaf: np.asarray(leaf)[places], (problem.batch.trials, problem.batch.observed)
    )
    again = np.r_[False, places[1:] == places[:-1]]
    trials, observed = eqx.tree_at(
        lambda b: (b[1].compared_rows, b[1].all_rows),
        batch,
        replace_fn=lambda rows: np.where(again, 0, rows),
    )
    noise = jax.tree.map(np.asarray, problem.noise)
    return pickle.dumps(((trials, observed, noise), problem.batch.channels))


def pass_on(chunk: bytes) -> bytes:
    """Return the chunk: as a task of its own it is sent once, and restored where it is lost."""
    return chunk


def evaluate_chunk(
    settings: bytes, chunk: bytes, what: str, shared: np.ndarray, own: np.ndarray
) -> tuple[np.ndarray, ...]:
    """Simulate, and differentiate, the runs of a chunk.

    Args:
        settings: Encoded `FitOptions`.
        chunk: By `encode_chunk`.
        what: Method of the problem: "prediction", "residual" or "blocks".
        shared, own: Coordinates, of shapes (shared,) and (runs, own).

    Returns:
        Its arrays, runs leading.
    """
    how = msgspec.msgpack.decode(settings, type=FitOptions)
    set_up_worker(how.software)
    import jax
    from jax import numpy as jnp

    from drftjax.recorded.batch import Batch, device_mesh
    from identify.solver.problem import Problem

    arrays, channels = pickle.loads(chunk)
    trials, observed, noise = jax.tree.map(jnp.asarray, arrays)
    runs = jnp.asarray(len(own))
    batch = Batch(trials, observed, channels, runs, jnp.arange(len(own)))
    problem = Problem(batch, tuple(fit_parameters(settings)), noise, device_mesh())
    at = problem.on_all_devices((jnp.asarray(shared), jnp.asarray(own)))
    found = getattr(problem, what)(*at)
    return tuple(map(np.asarray, found if isinstance(found, tuple) else (found,)))


def condensed_rows(found: tuple[np.ndarray, ...]) -> tuple[np.ndarray, np.ndarray]:
    r"""Return as many rows of each run as coordinates and one more, with its normal equations.

    With the triangle $R$ of a QR decomposition, $[J\ r] = Q R$, the columns of $R$ have the scalar
    products of those of $[J\ r]$: $J^T J$, $J^T r$ and $r^T r$ without the loss of figures that
    these have.

    Args:
        found: A run's residuals r and derivatives J, shapes (runs, channels, samples) and
            (runs, channels, samples, all).

    Returns:
        Residuals and derivatives of shapes (runs, 1, all + 1) and (runs, 1, all + 1, all). Not
        finite where those of the run are not.
    """
    residual, blocks = found
    runs, size = len(residual), blocks.shape[-1] + 1
    rows = np.concatenate([blocks, residual[..., None]], axis=-1).reshape(runs, -1, size)
    rows = np.pad(rows, ((0, 0), (0, max(0, size - rows.shape[1])), (0, 0)))
    bad = ~np.asarray(np.isfinite(rows).all(axis=(1, 2)))
    _, triangle = np.linalg.qr(np.where(bad[:, None, None], 0.0, rows))
    triangle[bad] = np.nan
    # Residuals alone may be finite: such a run can be simulated.
    lengths = np.sqrt((residual[bad] ** 2).sum(axis=(1, 2)))
    triangle[bad, :, -1] = lengths[:, None] * np.eye(1, size)
    return triangle[:, None, :, -1], triangle[:, None, :, :-1]
