"""zeta(t) of recorded runs, and numbers beside it, as the result of a fit."""

from collections.abc import Sequence
from functools import partial

import equinox as eqx
import numpy as np

from drftjax.recorded.compatible import retry_without_failures
from drftjax.recorded.prepared_run import PreparedRun
from drftjax.simulation.trial import Trial
from identify.fit_path_jointly import Progress, fit_jointly
from identify.parameters.parameter import Parameter
from identify.results.findings import at_bounds, unidentified
from identify.results.result import FitResult
from identify.results.values import RunFit, Value
from identify.zeta_path.path import ZetaPath
from identify.zeta_path.smoother import KNOT_SPACING


def fit_paths(
    prepared: Sequence[PreparedRun],
    knot_spacing: float = KNOT_SPACING,
    parameters: Sequence[Parameter] = (),
    progress: Progress | None = None,
) -> FitResult:
    """zeta(t) of each run, its smoothness chosen by the evidence; all else as believed, or fitted.

    Args:
        prepared: Runs; one that has no sinkage, is too short, cannot be simulated or is of
            another kind of wheel, law or carriage than most is left out.
        knot_spacing: Time from knot to knot [s].
        parameters: What is fitted beside the paths; see `identify.fit_path_jointly`.
        progress: Called with the stage and the step.

    Raises:
        InputError: where no run is left, or a parameter is one of the path itself.
    """
    make = partial(fit_jointly, parameters=parameters, knot_spacing=knot_spacing, progress=progress)
    kept, beside, left_out = retry_without_failures(list(prepared), make)
    paths = [each.path() for each in beside.solvers]
    shared, own = beside.values
    runs = [_run(*each) for each in zip(kept, paths, own, strict=True)]
    findings = [
        f"{path.name}: zeta goes from {inside.min():.4g} to {inside.max():.4g} over the "
        f"{int(path.identified.sum())} of {len(path.identified)} knots that the run tells"
        for path in paths
        if len(inside := path.value[path.identified])
    ]
    findings += [said for path in paths if (said := path.contradiction())]
    findings += unidentified(shared, runs)
    findings += at_bounds(shared, runs)
    return FitResult(
        shared=shared,
        runs=runs,
        status="converged"
        if beside.converged
        else "stalled"
        if beside.iterations
        else "out of steps",
        steps=beside.iterations + max(path.steps for path in paths),
        failures=left_out,
        findings=findings,
        labels=beside.labels,
        covariance=beside.covariance_of_values,
    )


def _run(each: PreparedRun, path: ZetaPath, values: dict[str, Value]) -> RunFit:
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
        before=_at(each.trial, each),
        after=_at(path.trial, each),
        status=status,
        path=path,
        believed=(each.setup.wheel, each.setup.rig),
    )


@eqx.filter_jit
def _simulated(trial: Trial):
    return trial.run()


def _at(trial: Trial, each: PreparedRun) -> np.ndarray:
    """Simulated channels at the recorded times, shape (channels, samples)."""
    output = _simulated(trial)
    time = np.asarray(output.time)
    return np.stack(
        [
            np.interp(each.observation.time, time, np.asarray(getattr(output, channel)))
            for channel in each.observation.channels
        ]
    )
