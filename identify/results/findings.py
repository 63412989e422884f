"""Findings of a fit, in sentences: what its runs identify, and what they cannot."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from drftjax.common.errors import InputError
from drftjax.recorded.observation import SHOWN
from drftjax.recorded.prepared_run import PreparedRun
from drftjax.results.random_effects import paule_mandel
from identify.parameters.parameter import Parameter
from identify.results.noise_floor import fast_scatter, noise_floor
from identify.results.outliers import (
    OUTLIER_SETTINGS,
    OutlierSettings,
    moving_start_sentences,
    outlier_sentences,
)
from identify.results.values import RunFit, Value
from identify.solver.problem import coordinates_of


@dataclass(frozen=True)
class FindingSettings:
    """Numbers of the sentences on a result.

    Attributes:
        alike: Correlation of two parameters above which they move the runs alike [-].
        lost: Share of a parameter's unit length in undetermined directions that is more than
            rounding.
        linked: Correlation of two parameters' undetermined parts that links them [-].
        outliers: Numbers of the search for outliers.
    """

    alike: float = 0.999
    lost: float = 1e-6
    linked: float = 0.1
    outliers: OutlierSettings = OUTLIER_SETTINGS


FINDING_SETTINGS = FindingSettings()


NO_SCATTER: Mapping[str, float] = MappingProxyType({})


def step_doubts(runs: Sequence[PreparedRun]) -> list[str]:
    """Sentences on runs whose step is too long for the error wanted, or their derivatives unsure.

    Args:
        runs: Runs of the fit.
    """
    return [
        f"{run.name} is simulated, and its derivatives are, less closely than wanted: {choice}"
        for run in runs
        if (choice := run.step_choice) is not None and not choice.within
    ]


def findings(
    parameters: Sequence[Parameter],
    shared: dict[str, Value],
    runs: Sequence[RunFit],
    spread: np.ndarray,
    unseen: np.ndarray,
    scatter: Mapping[str, float] = NO_SCATTER,
    settings: FindingSettings = FINDING_SETTINGS,
) -> list[str]:
    """Return sentences on identifiability, bounds, scatter between runs and the noise floor.

    Args:
        parameters: Fitted parameters, shared ones first.
        shared: Values of the shared ones, by name.
        runs: Fitted runs.
        spread: Covariance of all coordinates: shared, then each run's own, shape (all, all).
        unseen: Directions that the runs do not determine, in columns, shape (all, directions).
        scatter: Standard deviation from run to run of a shared value, by its name.
        settings: Decision numbers.
    """
    sentences = unidentified(shared, runs)
    sentences += at_bounds(shared, runs)
    sentences += _impossible(runs)
    sentences += _collinear(parameters, len(shared), runs, spread, settings.alike)
    sentences += _confused(parameters, len(runs), unseen, settings)
    sentences += [
        f"{shared[name].label} of each run alone would scatter by "
        f"{100 * each / abs(shared[name].value):.2g} %, which the error of the shared one counts in"
        for name, each in scatter.items()
        if each > 0
    ]
    return [*sentences, *between_run_sentences(runs, settings.outliers)]


def unidentified(shared: Mapping[str, Value], runs: Sequence[RunFit]) -> list[str]:
    """Return sentences on values of which the runs determine no more than the order of size."""
    sentences = [
        f"{value.label} cannot be identified from these runs: {value}"
        for value in shared.values()
        if not value.identified
    ]
    sentences += [
        f"{run.name}: {value.label} cannot be identified from this run: {value}"
        for run in runs
        for value in run.values.values()
        if not value.identified
    ]
    return sentences


def at_bounds(shared: Mapping[str, Value], runs: Sequence[RunFit]) -> list[str]:
    """Return sentences on values that ended at a bound."""
    of_runs = [value for run in runs if run.status != "diverged" for value in run.values.values()]
    labels = {each.label: None for each in (*shared.values(), *of_runs) if each.at_bound}
    return [
        f"{label} has run into its bound: the errors of the other values hold for it there alone"
        for label in labels
    ]


def _impossible(runs: Sequence[RunFit]) -> list[str]:
    """Return sentences on values that no set-up takes: numbers that may be zero can be negative."""
    sentences: dict[str, None] = {}
    for run in runs:
        if run.status == "diverged":
            continue
        for part in (run.setup.wheel, run.setup.terrain, run.setup.rig):
            try:
                part.build()
            except InputError as problem:
                why = f"as fitted, {problem}: no simulation takes it; give bounds, or leave it"
                sentences[why] = None
    return [*sentences]


def between_run_sentences(
    runs: Sequence[RunFit], outliers: OutlierSettings = OUTLIER_SETTINGS
) -> list[str]:
    """Return sentences on outliers, on the scatter between runs and on the noise floor.

    Runs that could not be simulated to the end are left out.
    """
    runs = [run for run in runs if run.status != "diverged"]
    sentences = [*moving_start_sentences(runs), *outlier_sentences(runs, outliers), *_scatter(runs)]
    if not runs:
        return sentences
    floor = noise_floor(runs)
    scatter = floor or fast_scatter(runs)
    each = ", ".join(
        f"{channel} {value * SHOWN[channel][1]:.3g} {SHOWN[channel][0]}"
        for channel, value in scatter.items()
    )
    if not scatter:
        sentences.append("no run was repeated, and none has samples enough to tell its noise")
    elif not floor:
        sentences.append(
            f"no run was repeated; what is left scatters by {each} from sample to sample: the "
            "noise floor as far as one run can tell it"
        )
    elif all(run.has_own_zeta for run in runs):
        sentences.append(f"repeated runs differ by {each} beyond their own values: the noise floor")
    else:
        sentences.append(f"repeated runs differ by {each}, what their sands differ by included")
    return sentences


def _collinear(
    parameters: Sequence[Parameter],
    shared: int,
    runs: Sequence[RunFit],
    spread: np.ndarray,
    alike: float,
) -> list[str]:
    """Return sentences on pairs of parameters that move their runs alike."""
    ordered = [p.quantity.label for p in parameters if p.shared]
    ordered += [p.quantity.label for p in parameters if not p.shared]
    blind: dict[tuple[str, str], list[str]] = {}
    counted = [(number, run) for number, run in enumerate(runs) if run.status != "diverged"]
    for number, run in counted:
        seen = coordinates_of(number, len(ordered), shared)
        error = np.sqrt(np.diag(spread)[seen])
        correlation = np.abs(spread[np.ix_(seen, seen)] / np.outer(error, error))
        for i, j in np.argwhere(np.tril(correlation, -1) > alike):
            blind.setdefault((ordered[i], ordered[j]), []).append(run.name)
    sentences = []
    for (one, other), names in blind.items():
        who = "these runs" if len(names) == len(counted) else ", ".join(names)
        sentences.append(
            f"{one} and {other} cannot be told apart by {who}: they see only a combination of the "
            "two"
        )
    return sentences


def _confused(
    parameters: Sequence[Parameter], runs: int, unseen: np.ndarray, settings: FindingSettings
) -> list[str]:
    """Return sentences on three parameters or more that only together are undetermined."""
    labels = [p.quantity.label for p in parameters if p.shared]
    labels += runs * [p.quantity.label for p in parameters if not p.shared]
    share = unseen @ unseen.T
    lost = np.flatnonzero(np.diag(share) > settings.lost)
    size = np.sqrt(np.diag(share)[lost])
    linked = np.abs(share[np.ix_(lost, lost)]) > settings.linked * np.outer(size, size)
    groups: list[tuple[str, ...]] = []
    remaining = set(range(len(lost)))
    while remaining:
        group = new = {min(remaining)}
        while new:
            new = {i for i in remaining - group if linked[i, list(group)].any()}
            group = group | new
        remaining -= group
        names = tuple(dict.fromkeys(labels[lost[i]] for i in sorted(group)))
        if len(names) > 2 and names not in groups:
            groups.append(names)
    return [
        f"these runs cannot tell {', '.join(names[:-1])} and {names[-1]} apart" for names in groups
    ]


def _scatter(runs: Sequence[RunFit]) -> list[str]:
    """Return sentences on own values that scatter beyond their errors: a random effect.

    Of identified values, and only where chance would hardly make it.
    """
    sentences = []
    for name in runs[0].values if runs else ():
        values_of_runs = [run.values[name] for run in runs]
        known = [each for each in values_of_runs if each.identified and not each.at_bound]
        values = np.array([each.value for each in known])
        found = paule_mandel(values, np.array([each.error for each in known]))
        if found.identified and found.mean != 0:
            share = 100 * np.sqrt(found.variance) / abs(found.mean)
            sentences.append(
                f"{known[0].label} is {found.mean:.4g} on average and scatters by {share:.2g} % "
                "from run to run beyond its errors"
            )
    return sentences
