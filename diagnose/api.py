"""`drftjax.diagnose` and `drftjax.evaluate`: runs in, and what they show out, in one call."""

import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

import jax
import numpy as np

from diagnose.dataset import RigDataset
from diagnose.evaluation.evaluate import evaluate_model
from diagnose.evaluation.model_reader import read_model_file
from diagnose.evaluation.result import Evaluation
from diagnose.hypotheses.screening import Report
from diagnose.model.augmented_model import AugmentedModel
from diagnose.pipeline import diagnose as diagnose_case
from diagnose.result import Diagnosis
from diagnose.rig_runs import gather_runs, require_one_rig, usable_runs
from drftjax.common.errors import InputError, RunError
from drftjax.effects.base import AbstractEffect
from drftjax.effects.catalogue import OURS, catalogue, effect_class
from drftjax.recorded.gather import GatheredRuns
from drftjax.recorded.prepared_run import PreparedRun, Run, as_prepared, named_runs

# An effect with strengths of zero leaves a run as it is but for the roundings of another program
# [m, N, N m].
SAME = 1e-6


def diagnose(
    runs: Run | Sequence[Run] | Mapping[str, Run],
    effects: Sequence[str | type[AbstractEffect]] | None = None,
    *,
    progress: Report | None = None,
) -> Diagnosis:
    """Find which effect makes runs of one rig differ from the model, as `drft diagnose` does.

        found = drftjax.diagnose("data/blind/demo")
        print(found.summary())

    Computes in double precision whatever the program around it uses.

    Args:
        runs: Files and folders of run logs, or run logs, one, several, or several by name. What
            cannot be used is left out, and the result's notes say why.
        effects: Names or classes: only these are considered; the whole catalogue otherwise.
        progress: Called with what is done next.

    Raises:
        InputError: where no run can be used, or an effect is not known.
    """
    chosen = effects_among(effects)
    with jax.enable_x64(True):
        return diagnose_gathered(gather_inputs(runs), chosen, progress or (lambda stage: None))


def evaluate(
    runs: Run | Sequence[Run] | Mapping[str, Run],
    model: Diagnosis | str | Path | Sequence[AbstractEffect],
) -> Evaluation:
    """Hold a model with effects against runs that it was not found on, as `drft evaluate` does.

    Args:
        runs: As for `diagnose`.
        model: A diagnosis, for what its model.toml holds; a set-up file; or effects with their
            numbers.

    Raises:
        InputError: where no run can be used, or the model cannot.
    """
    with jax.enable_x64(True):
        origin, added = None, None
        if isinstance(model, str | Path):
            added = read_model_file(Path(model))
            effects, origin = added.effects, added.origin
        elif isinstance(model, Diagnosis):
            effects, origin = model.selected.effects, model.origin
        else:
            effects = _numbered(model)
        gathered = gather_inputs(runs, origin)
        caveats = [] if added is None else added.caveats(gathered.runs)
        return evaluate_model(RigDataset.of(gathered.runs), effects, gathered.skipped, caveats)


def _numbered(given: object) -> tuple[AbstractEffect, ...]:
    """Effects in double precision, which they lack where the program around them does."""
    effects = tuple(given) if isinstance(given, Iterable) else (given,)
    for each in effects:
        if not isinstance(each, AbstractEffect):
            raise InputError(
                f"the model is given by {each!r}; it must be a diagnosis, a set-up file, or "
                "effects with their numbers, such as [SurfaceSlope(slope=0.01)]"
            )
    return jax.tree.map(lambda number: np.asarray(number, float), effects)


def effects_among(
    wanted: Sequence[str | type[AbstractEffect]] | None,
) -> tuple[type[AbstractEffect], ...]:
    """Effects by name or class, each once; the whole catalogue where none are given.

    Raises:
        InputError: for a name that is not known, with the nearest ones that are; for no effect.
    """
    if wanted is None:
        return tuple(catalogue().values())
    if isinstance(wanted, str):
        wanted = [wanted]
    if not wanted:
        raise InputError("no effect is named; `drft effects` lists them")
    classes = [effect_class(each) if isinstance(each, str) else each for each in wanted]
    for each in classes:
        if not (isinstance(each, type) and issubclass(each, AbstractEffect)):
            raise InputError(f"{each!r} is given as an effect; give names, or classes of effects")
    taken = dict(catalogue())
    for each in dict.fromkeys(classes):
        name = each.about.name
        if taken.setdefault(name, each) is not each:
            raise InputError(
                f"the effect {name!r} of {each.__module__} has the name of another; give it one "
                "of its own"
            )
    return tuple(dict.fromkeys(classes))


def gather_inputs(
    runs: Run | Sequence[Run] | Mapping[str, Run], origin: float | None = None
) -> GatheredRuns:
    """Runs of one wheel, however they are given.

    Args:
        runs: As for `diagnose`.
        origin: See `diagnose.rig_runs.with_common_origin`.

    Raises:
        InputError: where none can be used, or the runs are of several wheels and none prevails.
    """
    several = [runs] if isinstance(runs, str | Path) else runs
    if isinstance(several, Sequence):
        paths = [Path(each) for each in several if isinstance(each, str | Path)]
        if paths and len(paths) == len(several):
            return gather_runs(paths, origin=origin)
    candidates, left_out = [], {}
    for name, run in named_runs(runs).items():
        try:
            candidates.append(as_prepared(name, run))
        except RunError as problem:
            left_out[name] = str(problem)
    if left_out and not candidates:
        raise InputError("; ".join(left_out.values()))
    told = usable_runs(candidates)
    kept = require_one_rig(told.runs, origin)
    return GatheredRuns(kept.runs, {**left_out, **told.skipped, **kept.skipped})


def _require_null(
    candidates: Sequence[PreparedRun], effects: Sequence[type[AbstractEffect]]
) -> None:
    """Refuse effects of other packages that act where their strengths are zero.

    Raises:
        InputError: names the effect.
    """
    for effect in effects:
        if effect in OURS:
            continue
        case, model = RigDataset.of(candidates[:1]), AugmentedModel((effect,))
        without = case.prediction(AugmentedModel(), 0, 0.0, np.zeros(0))
        apart = np.abs(case.prediction(model, 0, 0.0, model.null()) - without).max()
        if np.isfinite(without).all() and not apart <= SAME:
            raise InputError(
                f"the effect {effect.about.name!r} of {effect.__module__} acts where all its "
                f"strengths are zero (by {apart:.2g} m or N in {candidates[0].name}); it must be "
                "null there"
            )


def diagnose_gathered(
    gathered: GatheredRuns,
    effects: Sequence[type[AbstractEffect]],
    report: Report,
    tell: Callable[[str], None] = lambda _: None,
) -> Diagnosis:
    """The diagnosis of the runs that the reference model can follow at all.

    Args:
        gathered: Runs of one wheel, and why others are not among them.
        effects: Effects to choose from.
        report: Called with what is done next.
        tell: Called with a sentence for every run that is left out here.

    Raises:
        InputError: where no run can be followed.
    """
    kept, notes = gathered.runs, list(gathered.skipped.values())
    _require_null(kept, effects)
    while True:
        try:
            found = diagnose_case(RigDataset.of(kept), effects, report)
            break
        except RunError as problem:
            kept = [each for each in kept if each.name != problem.run]
            if not kept:
                raise
            notes.append(str(problem))
            tell(f"left out: {problem}")
    return dataclasses.replace(found, notes=[*found.notes, *(f"Left out: {why}" for why in notes)])
