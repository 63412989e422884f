"""Fit of zeta(t), and of parameters jointly with it, as a fit's result."""

from collections.abc import Sequence
from functools import partial

import equinox as eqx
import numpy as np

from drftjax.recorded.prepared_run import PreparedRun
from drftjax.simulation.trial import Trial
from identify.compatible_runs import retry_without_failures
from identify.fit_path_jointly import (
    JOINT_FIT_SETTINGS,
    JointFitSettings,
    Progress,
    fit_jointly,
)
from identify.parameters.parameter import Parameter
from identify.results.findings import at_bounds, unidentified
from identify.results.misfit import channel_floors, judged, misfit_sentences, overall
from identify.results.result import FitResult
from identify.results.values import RunFit, Value
from identify.zeta_path.path import ZetaPath
from identify.zeta_path.smoother import KNOT_SPACING


def fit_paths(
    prepared: Sequence[PreparedRun],
    knot_spacing: float = KNOT_SPACING,
    parameters: Sequence[Parameter] = (),
    progress: Progress | None = None,
    settings: JointFitSettings = JOINT_FIT_SETTINGS,
) -> FitResult:
    """Fit zeta(t) of each run, its smoothness chosen by the evidence, and parameters with it.

    Args:
        prepared: Runs; one that has no sinkage, is too short, cannot be simulated or is of
            another kind of wheel, law or carriage than most is left out.
        knot_spacing: Time from knot to knot [s].
        parameters: Parameters fitted jointly with the paths; see `identify.fit_path_jointly`.
        progress: Called with the stage and the step.
        settings: Decision numbers.

    Raises:
        InputError: where no run is left, or a parameter is part of every path.
    """
    make = partial(
        fit_jointly,
        parameters=parameters,
        knot_spacing=knot_spacing,
        progress=progress,
        settings=settings,
    )
    kept, joint, left_out = retry_without_failures(list(prepared), make)
    paths = [each.path() for each in joint.solvers]
    shared, own = joint.values
    errors = [
        each.step_error_of(run.observation) for each, run in zip(joint.solvers, kept, strict=True)
    ]
    fits = [_run(*each) for each in zip(kept, paths, own, errors, strict=True)]
    floors = channel_floors(fits)
    fits = judged(fits, floors, settings.misfit)
    findings = misfit_sentences(fits, floors, settings.misfit)
    findings += [
        f"{path.name}: zeta goes from {inside.min():.4g} to {inside.max():.4g} over the "
        f"{int(path.identified.sum())} of {len(path.identified)} knots that the run tells"
        for path in paths
        if len(inside := path.value[path.identified])
    ]
    findings += [said for path in paths if (said := path.contradiction(settings.path))]
    findings += unidentified(shared, fits)
    findings += at_bounds(shared, fits)
    status = "stalled" if joint.iterations else "out of steps"
    return FitResult(
        shared=shared,
        runs=fits,
        status=overall("converged" if joint.converged else status, fits),
        steps=joint.iterations + max(path.steps for path in paths),
        failures=left_out,
        findings=findings,
        labels=joint.labels,
        covariance=joint.covariance_of_values,
        floors=floors,
    )


def _run(
    each: PreparedRun, path: ZetaPath, values: dict[str, Value], step_error: np.ndarray
) -> RunFit:
    observation = each.observation
    status = "converged" if path.converged else "stalled"
    if any(value.at_bound for value in values.values()):
        status = "at a bound"
    return RunFit(
        name=each.name,
        setup=path.setup,
        values=values,
        time=observation.time,
        counts=observation.counts,
        channels=observation.channels,
        recorded=observation.values,
        before=_at(each.trial, each) - step_error,
        after=_at(path.trial, each) - step_error,
        status=status,
        path=path,
        believed=(each.setup.wheel, each.setup.rig),
    )


@eqx.filter_jit
def _simulated(trial: Trial):
    return trial.run()


def _at(trial: Trial, each: PreparedRun) -> np.ndarray:
    """Return the simulated channels at the recorded times, shape (channels, samples)."""
    output = _simulated(trial)
    time = np.asarray(output.time)
    return np.stack(
        [
            np.interp(each.observation.time, time, np.asarray(getattr(output, channel)))
            for channel in each.observation.channels
        ]
    )
