"""Angular velocity from which a parameter could be identified, where the fitted runs cannot.

The same set-up is simulated under the same command, several times as fast, with the believed value
instead of the unidentified one. Its standard error is that of a fit to this run, with the noise and
the model error that the present fit found.
"""

import copy
import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from drftjax.common.errors import InputError
from drftjax.recorded.batch import device_mesh, make_batch
from drftjax.setups.chosen_step import choose_setup_step
from drftjax.setups.setup import SetUp
from drftjax.simulation.trial import Trial, pad_trial, shared_size
from identify.parameters.phase_zeta import PhaseZeta
from identify.results.result import FitResult
from identify.results.values import IDENTIFIABILITY
from identify.solver.problem import Problem, linearize
from identify.solver.whitening import Whitening
from identify.uncertainty.covariance import covariance
from identify.uncertainty.estimate import Estimate

# Factors on the speed that are tried, one after the other [-].
SPEED_FACTORS = (2.0, 4.0, 8.0, 16.0)


def add_required_speeds(result: FitResult) -> FitResult:
    """Return the result with a finding for every shared value that the runs do not identify."""
    estimate = result.estimate
    if estimate is None:
        return result
    setups = [run.setup for run in result.runs]
    sentences = []
    for name, value in result.shared.items():
        if value.identified:
            continue
        # A prediction for other runs that cannot be made is no reason to lose this result.
        with suppress(InputError):
            sentences.append(required_speed(estimate, setups, name))
    return replace(result, findings=[*result.findings, *(each for each in sentences if each)])


def required_speed(estimate: Estimate, setups: Sequence[SetUp], name: str) -> str | None:
    """Return a sentence on the speed from which a shared parameter could be identified.

    Args:
        estimate: Of the fit.
        setups: Each run's set-up with the fitted values put in.
        name: The parameter's full name.

    Returns:
        None where no run moves, or its set-up has no size to compare an error with.
    """
    fastest = max(
        range(len(setups)),
        key=lambda run: estimate.solution.active[run] * _top(setups[run]),
    )
    parameter = next(p for p in estimate.problem.shared if p.quantity.name == name)
    believed = float(parameter.quantity.read(estimate.runs[fastest].trial))
    speed = _top(setups[fastest])
    if speed == 0 or believed == 0:
        return None
    setup = copy.deepcopy(setups[fastest])
    parameter.quantity.record(setup, believed)
    label = parameter.quantity.label
    last, tried = None, 0.0
    for factor in (1.0, *SPEED_FACTORS):
        error = _error(estimate, fastest, setup, name, factor)
        if error is None:
            break
        share = error / abs(believed)
        if share <= IDENTIFIABILITY.identified_error:
            wanted = factor if last is None else _between(last, (factor, share))
            percent = 100 * IDENTIFIABILITY.identified_error
            return (
                f"{label} could be identified from about {wanted * speed:.2g} rad/s on: at "
                f"{wanted:.2g} times this speed its standard error falls to {percent:.0f} % "
                f"of the believed {believed:.4g}"
            )
        last, tried = (factor, share), factor
    if last is None:
        return None
    return (
        f"{label} could not be identified by the same run {tried:g} times as fast either, at "
        f"{tried * speed:.2g} rad/s: its standard error would be {last[1] * abs(believed):.2g}"
    )


def _top(setup: SetUp) -> float:
    """Return the largest commanded angular velocity [rad/s]."""
    return float(np.abs(setup.command.build().omega).max())


def _between(last: tuple[float, float], now: tuple[float, float]) -> float:
    """Return the factor at which the error crosses the wanted share, linear in logarithms."""
    (a, above), (b, under) = last, now
    share = np.log(above / IDENTIFIABILITY.identified_error) / np.log(above / under)
    return float(a * (b / a) ** share)


def _by_phase(trial: Trial, estimate: Estimate, run: int, name: str) -> Trial:
    """Return the trial with the fit's zeta by phase, if fitted; the named one's as believed."""
    given, (shared, own) = estimate.runs[run].trial, estimate.solution.coordinates
    zeta = estimate.problem.trial_at(given, shared, own[run]).simulator.terrain.zeta
    if not isinstance(zeta, PhaseZeta):
        return trial
    trial = eqx.tree_at(lambda t: t.simulator.terrain.zeta, trial, zeta)
    quantity = next(p.quantity for p in estimate.problem.parameters if p.quantity.name == name)
    return quantity.write(trial, quantity.read(given))


def _error(estimate: Estimate, run: int, setup: SetUp, name: str, factor: float) -> float | None:
    """Return the parameter's standard error by one run this factor faster; None if impossible."""
    setup = copy.deepcopy(setup)
    setup.command.omega = [factor * value for value in setup.command.omega]
    if setup.command.vx is not None:
        setup.command.vx = [factor * value for value in setup.command.vx]
    try:
        setup.integrator.step = None
        choose_setup_step(setup)
        trial = _by_phase(setup.trial(interval=0), estimate, run, name)
    except InputError:
        return None
    observation = estimate.runs[run].observation
    # Room that all speeds share, or their steps would be compiled one by one.
    trial = pad_trial(trial, shared_size(trial.rows), len(trial.time))
    batch = make_batch([trial], [observation], jax.device_count())
    # At the values that the set-up holds, wherever the fit was told to start.
    parameters = tuple(
        replace(each, start=math.nan) for each in estimate.problem.shared + estimate.problem.own
    )
    problem = Problem(batch, parameters, estimate.problem.noise, device_mesh())
    kept = [estimate.problem.batch.channels.index(c) for c in batch.channels]
    length = batch.observed.weight.shape[-1]
    weight = np.zeros(batch.observed.weight.shape)
    common = min(length, estimate.problem.batch.observed.weight.shape[-1])
    known = np.asarray(estimate.problem.batch.observed.weight)[run][kept]
    weight[0, :, :common] = known[:, :common]
    problem = eqx.tree_at(lambda p: p.batch.observed.weight, problem, jnp.asarray(weight))
    # Arrays of a noise model have one number a channel.
    noise = jax.tree.map(lambda leaf: leaf[jnp.asarray(kept)], estimate.problem.noise)
    problem = replace(problem, noise=noise)
    _, blocks = linearize(problem, problem.start())
    if not np.isfinite(blocks).all():
        return None

    def resized(values: np.ndarray) -> np.ndarray:
        wide = np.zeros((1, *weight.shape[1:]))
        wide[0, :, :common] = values[run][kept][:, :common]
        return wide

    whitening = estimate.whitening
    phase = np.zeros((1, length), int)
    phase[0, :common] = whitening.phase[run, :common]
    alone = Whitening(resized(whitening.scale), resized(whitening.unit), phase)
    spread = covariance(blocks[:1], alone, estimate.shared)
    number = [p.quantity.name for p in parameters].index(name)
    at = problem.start()[0][number]
    slope = float(parameters[number].bijector.slope(at))
    return slope * float(np.sqrt(spread[number, number]))
