"""The steps of a comparison: match conditions, linearise, screen, weigh, measure."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from diagnose.change.budget import difference_budget
from diagnose.change.differences.conditions import MatchedCondition, matched_conditions
from diagnose.change.differences.fit import information
from diagnose.change.differences.gram import Differences
from diagnose.change.differences.settings import DEFAULT_DIFFERENCE_FIT, DifferenceFitSettings
from diagnose.change.hypothesis import ZETA, ChangeHypothesis, ChangeProblem
from diagnose.change.relabelling import (
    DEFAULT_RELABELLING,
    RelabellingSettings,
    relabelling_test,
)
from diagnose.change.result import ChangeDiagnosis
from diagnose.change.screening import (
    DEFAULT_CHANGE_SCREENING,
    ChangeScreeningSettings,
    screen_change,
)
from diagnose.change.shared_law import (
    DEFAULT_SHARED_LAW,
    SharedLawSettings,
    follow_shared_law,
)
from diagnose.change.weights import (
    DEFAULT_CHANGE_WEIGHTS,
    ChangeWeightSettings,
    weigh_change,
)
from diagnose.dataset import (
    DEFAULT_DATASET,
    DEFAULT_INITIAL_ZETA,
    DatasetSettings,
    InitialZetaSettings,
    RigDataset,
    match_initial_zeta,
)
from diagnose.linear.linear_fit import worth_by_block
from diagnose.linear.linearized_runs import linearize_runs
from diagnose.linear.regressors import Regressors
from diagnose.model.augmented_model import shared_model
from diagnose.result import ParameterEstimate
from diagnose.run_pool import RunPool
from drftjax.common.errors import RunError
from drftjax.effects.base import AbstractEffect
from drftjax.effects.catalogue import field_metadata, reported_name, strengths
from drftjax.recorded.prepared_run import PreparedRun

Report = Callable[[str], None]


@dataclass(frozen=True)
class ChangeErrorSettings:
    """Numbers of the standard errors of a change's numbers.

    Attributes:
        slow_worth: Independent statements in one bin of a slow part [-].
        fast_worth: Independent statements in one sample of a fast part [-]. A level adds none: it
            is a sum of the bins, each of which counts here.
        law_share: Share of a strength, or of a change of zeta, that may be wrong as the sand
            follows another law [-].
    """

    slow_worth: float = 1.0
    fast_worth: float = 0.1
    law_share: float = 0.1


DEFAULT_CHANGE_ERROR = ChangeErrorSettings()


@dataclass(frozen=True)
class ChangeSettings:
    """Numbers by which a change is found, one part for each step.

    Attributes:
        dataset: Preparation of the recorded runs.
        law: Base that the responses are about.
        initial_zeta: Search for the zeta where each run is linearised.
        fit: Fits of differences.
        screening: Choice and refinement of explanations.
        weights: Weights and verdict.
        error: Standard errors.
        relabelling: Test without a model of noise.
        min_conditions: With fewer matched conditions a note says how little they tell.
        told_law_factor: A note tells that a change does this much more or less in a channel than it
            does in the base [-].
    """

    dataset: DatasetSettings = DEFAULT_DATASET
    law: SharedLawSettings = DEFAULT_SHARED_LAW
    initial_zeta: InitialZetaSettings = DEFAULT_INITIAL_ZETA
    fit: DifferenceFitSettings = DEFAULT_DIFFERENCE_FIT
    screening: ChangeScreeningSettings = DEFAULT_CHANGE_SCREENING
    weights: ChangeWeightSettings = DEFAULT_CHANGE_WEIGHTS
    error: ChangeErrorSettings = DEFAULT_CHANGE_ERROR
    relabelling: RelabellingSettings = DEFAULT_RELABELLING
    min_conditions: int = 3
    told_law_factor: float = 0.2


DEFAULT_CHANGE_SETTINGS = ChangeSettings()


def compare_runs(
    before: Sequence[PreparedRun],
    now: Sequence[PreparedRun],
    effects: Sequence[type[AbstractEffect]],
    report: Report = lambda stage: None,
    settings: ChangeSettings = DEFAULT_CHANGE_SETTINGS,
) -> ChangeDiagnosis:
    """Find what changed in a rig from its runs before and now.

    Args:
        before, now: Runs of one rig, from one origin.
        effects: Effects to choose from.
        report: Called with what is done next.
        settings: Numbers by which it decides.

    Raises:
        InputError: where no run of now has the command and load of one before, or no run a sinkage.
        RunError: where a run cannot be simulated.
    """
    conditions = matched_conditions(before, now)
    runs = [*before, *now]
    kept = sorted(run for each in conditions for run in each.runs)
    place = {run: number for number, run in enumerate(kept)}
    conditions = [
        MatchedCondition(
            tuple(place[run] for run in each.before), tuple(place[run] for run in each.now)
        )
        for each in conditions
    ]
    with RunPool() as pool:
        problem = _problem([runs[run] for run in kept], conditions, effects, pool, report, settings)
        report("what may have changed")
        found = screen_change(problem, pool, settings.screening)
        weighed = weigh_change(problem, found, settings.weights)
        chosen = weighed.chosen
        nothing = weighed.verdict == found.none.name
        return ChangeDiagnosis(
            verdict=(weighed.verdict,),
            weights=weighed.weights,
            groups=[weighed.group],
            parameters={} if nothing else _parameters(problem, chosen, pool, settings),
            budget=difference_budget(problem, chosen),
            relabelling=relabelling_test(
                problem.differences, problem.residual_without(None), settings.relabelling
            ),
            notes=[
                *_notes(runs, kept, len(conditions), chosen, settings),
                *base_notes(problem.law),
                *([] if nothing else law_notes(problem.law_factors(chosen), settings)),
            ],
            problem=problem,
            chosen=chosen,
        )


def _problem(
    runs: Sequence[PreparedRun],
    conditions: Sequence[MatchedCondition],
    effects: Sequence[type[AbstractEffect]],
    pool: RunPool,
    report: Report,
    settings: ChangeSettings,
) -> ChangeProblem:
    """The runs, linearised at a zeta each about a base that follows those before.

    Where a run cannot be simulated in that base, about the reference model as it is.
    """
    try:
        return _problem_about(settings.law, runs, conditions, effects, pool, report, settings)
    except RunError:
        plain = replace(settings.law, rounds=0)
        return _problem_about(plain, runs, conditions, effects, pool, report, settings)


def _problem_about(
    law_settings: SharedLawSettings,
    runs: Sequence[PreparedRun],
    conditions: Sequence[MatchedCondition],
    effects: Sequence[type[AbstractEffect]],
    pool: RunPool,
    report: Report,
    settings: ChangeSettings,
) -> ChangeProblem:
    report("the law that the runs before follow")
    before = sorted(run for each in conditions for run in each.before)
    whole = RigDataset.of(runs, settings.dataset)
    dataset, law = follow_shared_law(whole, before, pool, law_settings)
    log_zeta = match_initial_zeta(dataset, pool, settings.initial_zeta)
    dataset = replace(dataset.with_fewer_plates(), shared=shared_model(effects))
    report(f"linearising {len(runs)} runs, and {len(effects)} effects along them")
    linearized = linearize_runs(dataset, log_zeta, pool)
    regressors = Regressors.of(dataset, linearized, effects, pool)
    _require_derivatives(regressors)
    differences = Differences.of(dataset, conditions)
    return ChangeProblem.of(differences, regressors, law, pool, settings.fit)


def _require_derivatives(regressors: Regressors) -> None:
    """Refuse a run whose wheel falls at first: no linear response of it holds.

    Raises:
        RunError: names the run.
    """
    dataset = regressors.dataset
    z = dataset.channels.index("z")
    for run, columns in zip(dataset.runs, regressors.columns, strict=True):
        # A wheel cannot sink by its own radius for a small part of zeta.
        if not np.abs(columns[z, :, 0]).max(initial=0.0) < run.setup.wheel.radius:
            raise RunError(
                run.name,
                "its wheel falls at the start of a simulation, so that no derivative holds; a "
                "run is to begin with a wheel that stands",
            )


def _parameters(
    problem: ChangeProblem, chosen: ChangeHypothesis, pool: RunPool, settings: ChangeSettings
) -> dict[str, dict[str, ParameterEstimate]]:
    """The change's numbers with standard errors, by effect and field."""
    prior, matrices = chosen.coordinate_prior(problem.settings), problem.gram(chosen, pool)
    error = settings.error
    worth = worth_by_block(matrices.blocks, error.slow_worth, error.fast_worth, 0.0)
    centring = problem.differences.centring
    precision = information(matrices, chosen.fit, centring, prior, worth, problem.settings)
    spread = np.sqrt(np.diag(np.linalg.inv(precision)))[: len(prior.width)]
    if chosen.zeta_changes:
        change = float(np.expm1(chosen.common_zeta))
        whole = float(np.hypot((1 + change) * spread[0], error.law_share * change))
        return {ZETA: {"change": ParameterEstimate(change, whole, "-")}}
    sign = 1.0 if chosen.side == "now" else -1.0
    found: dict[str, dict[str, ParameterEstimate]] = {}
    for free, at, width in zip(chosen.model.free, chosen.coordinates, spread, strict=True):
        effect = chosen.model.effects[free.index]
        value, unit = float(free.value(at)), field_metadata(effect)[free.field]["unit"]
        fields = found.setdefault(reported_name(effect.about.name), {})
        if free.scale is None:
            fields[free.field] = ParameterEstimate(value, value * float(width), unit)
            continue
        whole = float(np.hypot(free.scale * width, error.law_share * value))
        fields[free.field] = ParameterEstimate(sign * value, whole, unit)
    return found


def law_notes(
    factors: Mapping[str, float], settings: ChangeSettings = DEFAULT_CHANGE_SETTINGS
) -> list[str]:
    """Sentences on the channels in which another law shows.

    Args:
        factors: By channel, how much a change does over what it does in the base [-].
        settings: For the least difference that is told.
    """
    return [
        f"In {channel} the change does {factor:.2f} times what it would on sand of the law that "
        "was fitted to the runs before: the sand's own is another."
        for channel, factor in factors.items()
        if abs(factor - 1) > settings.told_law_factor
    ]


def base_notes(law: Sequence[AbstractEffect]) -> list[str]:
    """A sentence where no base was fitted, as runs cannot be simulated about it.

    Args:
        law: The base's effects; all of no strength where none was fitted.
    """
    numbers = [float(getattr(each, name)) for each in law for name in strengths(type(each))]
    if any(numbers) or not numbers:
        return []
    return [
        "No base could be fitted to the runs before about which all runs can be simulated: the "
        "reference model stands for it, and sizes may be further off."
    ]


def _notes(
    runs: Sequence[PreparedRun],
    kept: Sequence[int],
    conditions: int,
    chosen: ChangeHypothesis,
    settings: ChangeSettings,
) -> list[str]:
    """Caveats of the comparison, in sentences."""
    notes = []
    unmatched = [each.name for number, each in enumerate(runs) if number not in kept]
    if unmatched:
        notes.append(
            f"No run of the other side has the command and load of {', '.join(unmatched)}."
        )
    if conditions < settings.min_conditions:
        count = "one command" if conditions == 1 else f"{conditions} commands"
        notes.append(
            f"Only {count} can be compared: another zeta may pass for much of what an effect does. "
            "`drft protocol` writes nine that tell effects apart."
        )
    if len(kept) == 2 * conditions:
        notes.append(
            "No command was run twice on either side, so that the scatter of the sand from run to "
            "run is believed more than measured: two runs of one command on each side measure it."
        )
    if chosen.model.effects and not chosen.is_simulated:
        notes.append("The numbers are those of a linear response, which no simulation has checked.")
    return notes
