"""What a fit's numbers mean, in sentences: what these runs can tell, and what they cannot."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np

from drftjax.common.errors import InputError
from drftjax.recorded.observation import SHOWN
from identify.parameters.parameter import Parameter
from identify.results.noise_floor import fast_scatter, noise_floor
from identify.results.outliers import moving_start_sentences, outlier_sentences
from identify.results.values import RunFit, Value
from identify.solver.problem import coordinates_of
from identify.uncertainty.random_effects import paule_mandel

# Two parameters closer than this move the runs alike.
ALIKE = 0.999


# Of a parameter's unit length: so much of it unseen is more than rounding, and so much of two that
# is unseen together links them.
LOST, LINKED = 1e-6, 0.1


NO_SCATTER: Mapping[str, float] = MappingProxyType({})


def findings(
    parameters: Sequence[Parameter],
    shared: dict[str, Value],
    runs: Sequence[RunFit],
    spread: np.ndarray,
    unseen: np.ndarray,
    scatter: Mapping[str, float] = NO_SCATTER,
) -> list[str]:
    """Sentences on identifiability, bounds, scatter between runs and the noise floor.

    Args:
        parameters: What was fitted, shared ones first.
        shared: Their values.
        runs: Fitted runs.
        spread: Covariance of all coordinates: shared, then each run's own.
        unseen: Directions that the runs do not see, in columns, of the same coordinates.
        scatter: Standard deviation from run to run of a shared value, by its name.
    """
    told = unidentified(shared, runs)
    told += at_bounds(shared, runs)
    told += _impossible(runs)
    told += _collinear(parameters, len(shared), runs, spread)
    told += _confused(parameters, len(runs), unseen)
    told += [
        f"{shared[name].label} of each run alone would scatter by "
        f"{100 * each / abs(shared[name].value):.2g} %, which the error of the shared one counts in"
        for name, each in scatter.items()
        if each > 0
    ]
    return [*told, *between_run_sentences(runs)]


def unidentified(shared: Mapping[str, Value], runs: Sequence[RunFit]) -> list[str]:
    """Sentences on values that their runs tell no more of than the order of size."""
    told = [
        f"{value.label} cannot be identified from these runs: {value}"
        for value in shared.values()
        if not value.identified
    ]
    told += [
        f"{run.name}: {value.label} cannot be identified from this run: {value}"
        for run in runs
        for value in run.values.values()
        if not value.identified
    ]
    return told


def at_bounds(shared: Mapping[str, Value], runs: Sequence[RunFit]) -> list[str]:
    """Sentences on values that ended at a bound."""
    of_runs = [value for run in runs if run.status != "diverged" for value in run.values.values()]
    labels = {each.label: None for each in (*shared.values(), *of_runs) if each.at_bound}
    return [f"{label} has run into its bound" for label in labels]


def _impossible(runs: Sequence[RunFit]) -> list[str]:
    """Sentences on values that a set-up refuses: what may be zero is fitted on both sides of it."""
    told: dict[str, None] = {}
    for run in runs:
        if run.status == "diverged":
            continue
        for part in (run.setup.wheel, run.setup.terrain, run.setup.rig):
            try:
                part.build()
            except InputError as problem:
                why = f"as fitted, {problem}: no simulation takes it; give bounds, or leave it"
                told[why] = None
    return [*told]


def between_run_sentences(runs: Sequence[RunFit]) -> list[str]:
    """Sentences on odd readings, and on what runs differ by: by own values, and repeats beyond.

    Runs that could not be simulated to the end are left out.
    """
    runs = [run for run in runs if run.status != "diverged"]
    told = [*moving_start_sentences(runs), *outlier_sentences(runs), *_scatter(runs)]
    if not runs:
        return told
    floor = noise_floor(runs)
    scatter = floor or fast_scatter(runs)
    each = ", ".join(
        f"{channel} {value * SHOWN[channel][1]:.3g} {SHOWN[channel][0]}"
        for channel, value in scatter.items()
    )
    if not scatter:
        told.append("no run was repeated, and none has samples enough to tell its noise")
    elif not floor:
        told.append(
            f"no run was repeated; what is left scatters by {each} from sample to sample: the "
            "noise floor as far as one run can tell it"
        )
    elif all(run.has_own_zeta for run in runs):
        told.append(f"repeated runs differ by {each} beyond their own values: the noise floor")
    else:
        told.append(f"repeated runs differ by {each}, what their sands differ by included")
    return told


def _collinear(
    parameters: Sequence[Parameter], shared: int, runs: Sequence[RunFit], spread: np.ndarray
) -> list[str]:
    """Pairs of parameters that runs cannot tell apart: shared ones, or with a run's own."""
    ordered = [p.quantity.label for p in parameters if p.shared]
    ordered += [p.quantity.label for p in parameters if not p.shared]
    blind: dict[tuple[str, str], list[str]] = {}
    counted = [(number, run) for number, run in enumerate(runs) if run.status != "diverged"]
    for number, run in counted:
        seen = coordinates_of(number, len(ordered), shared)
        error = np.sqrt(np.diag(spread)[seen])
        alike = np.abs(spread[np.ix_(seen, seen)] / np.outer(error, error))
        for i, j in np.argwhere(np.tril(alike, -1) > ALIKE):
            blind.setdefault((ordered[i], ordered[j]), []).append(run.name)
    told = []
    for (one, other), names in blind.items():
        who = "these runs" if len(names) == len(counted) else ", ".join(names)
        told.append(
            f"{one} and {other} cannot be told apart by {who}: they see only a combination of the "
            "two"
        )
    return told


def _confused(parameters: Sequence[Parameter], runs: int, unseen: np.ndarray) -> list[str]:
    """Three parameters or more of which these runs see less combinations than numbers."""
    labels = [p.quantity.label for p in parameters if p.shared]
    labels += runs * [p.quantity.label for p in parameters if not p.shared]
    share = unseen @ unseen.T
    lost = np.flatnonzero(np.diag(share) > LOST)
    size = np.sqrt(np.diag(share)[lost])
    linked = np.abs(share[np.ix_(lost, lost)]) > LINKED * np.outer(size, size)
    groups: list[tuple[str, ...]] = []
    left = set(range(len(lost)))
    while left:
        group = new = {min(left)}
        while new:
            new = {i for i in left - group if linked[i, list(group)].any()}
            group = group | new
        left -= group
        names = tuple(dict.fromkeys(labels[lost[i]] for i in sorted(group)))
        if len(names) > 2 and names not in groups:
            groups.append(names)
    return [
        f"these runs cannot tell {', '.join(names[:-1])} and {names[-1]} apart" for names in groups
    ]


def _scatter(runs: Sequence[RunFit]) -> list[str]:
    """Spread of each run's own values beyond their errors: a random effect between runs.

    Of values that their runs tell, and only where chance would hardly make it.
    """
    told = []
    for name in runs[0].values if runs else ():
        values_of_runs = [run.values[name] for run in runs]
        known = [each for each in values_of_runs if each.identified and not each.at_bound]
        values = np.array([each.value for each in known])
        found = paule_mandel(values, np.array([each.error for each in known]))
        if found.identified and found.mean != 0:
            share = 100 * np.sqrt(found.variance) / abs(found.mean)
            told.append(
                f"{known[0].label} is {found.mean:.4g} on average and scatters by {share:.2g} % "
                "from run to run beyond its errors"
            )
    return told
