"""zeta(t) of recorded runs, by `identify.zeta_smoother`, as the result of a fit."""

import equinox as eqx
import numpy as np

from drftjax.trial import Trial
from identify.candidate import Candidate
from identify.kinds import of_usable
from identify.result import FitResult, RunFit
from identify.zeta_path import ZetaPath
from identify.zeta_smoother import KNOT_SPACING, zeta_paths


def fit_paths(candidates: list[Candidate], knot_spacing: float = KNOT_SPACING) -> FitResult:
    """zeta(t) of each run, its smoothness chosen by the evidence; all else as believed.

    Args:
        candidates: Runs; one that has no sinkage, is too short, cannot be simulated or is of
            another kind of wheel, law or carriage than most is left out.
        knot_spacing: Time from knot to knot [s].

    Raises:
        InputError: where no run is left.
    """
    kept, paths, left_out = of_usable(candidates, lambda each: zeta_paths(each, knot_spacing))
    runs = [_run(each, path) for each, path in zip(kept, paths, strict=True)]
    settled = all(path.converged for path in paths)
    findings = [
        f"{path.name}: zeta goes from {inside.min():.4g} to {inside.max():.4g} over the "
        f"{int(path.told.sum())} of {len(path.told)} knots that the run tells"
        for path in paths
        if len(inside := path.value[path.told])
    ]
    findings += [said for path in paths if (said := path.contradiction())]
    return FitResult(
        shared={},
        runs=runs,
        status="converged" if settled else "out of steps",
        steps=max(path.steps for path in paths),
        failures=left_out,
        findings=findings,
    )


def _run(each: Candidate, path: ZetaPath) -> RunFit:
    observation = each.observation
    return RunFit(
        name=each.name,
        setup=path.setup,
        values={},
        time=observation.time,
        counts=observation.counts,
        channels=observation.channels,
        recorded=observation.values,
        before=_at(each.trial, each),
        after=_at(path.trial, each),
        status="converged" if path.converged else "stalled",
        path=path,
    )


@eqx.filter_jit
def _simulated(trial: Trial):
    return trial.run()


def _at(trial: Trial, each: Candidate) -> np.ndarray:
    """Simulated channels at the recorded times, shape (channels, samples)."""
    output = _simulated(trial)
    time = np.asarray(output.time)
    return np.stack(
        [
            np.interp(each.observation.time, time, np.asarray(getattr(output, channel)))
            for channel in each.observation.channels
        ]
    )
