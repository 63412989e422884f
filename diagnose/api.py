"""`drftjax.diagnose` and `drftjax.evaluate`: from runs to a diagnosis or evaluation in one call."""

import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TypeVar, overload

import jax
import numpy as np

from diagnose.change.comparison import DEFAULT_CHANGE_SETTINGS, ChangeSettings, compare_runs
from diagnose.change.differences.conditions import require_one_rig_on_both_sides
from diagnose.change.result import ChangeDiagnosis
from diagnose.dataset import RigDataset
from diagnose.drive_error import drive_error, driven_by_measured_speed
from diagnose.evaluation.evaluate import evaluate_model
from diagnose.evaluation.model_reader import read_model_file
from diagnose.evaluation.result import Evaluation
from diagnose.hypotheses.screening import Report
from diagnose.model.augmented_model import AugmentedModel
from diagnose.pipeline import diagnose as diagnose_dataset
from diagnose.result import Diagnosis
from diagnose.rig_runs import gather_runs, require_one_rig, usable_runs
from diagnose.settings import DEFAULT_SETTINGS, DiagnosisSettings
from drftjax.common.errors import InputError, RunError
from drftjax.effects.base import AbstractEffect
from drftjax.effects.catalogue import OURS, catalogue, effect_class
from drftjax.recorded.gather import GatheredRuns
from drftjax.recorded.prepared_run import PreparedRun, Run, as_prepared, named_runs
from drftjax.results.provenance import library_provenance

Kind = TypeVar("Kind")

# An effect with strengths of zero changes a run by no more than this [m, N, N m]: the roundings of
# another program.
NULL_EFFECT_TOLERANCE = 1e-6


Runs = Run | Sequence[Run] | Mapping[str, Run]


@overload
def diagnose(
    runs: Runs,
    effects: Sequence[str | type[AbstractEffect]] | None = None,
    *,
    against: None = None,
    progress: Report | None = None,
    settings: DiagnosisSettings = DEFAULT_SETTINGS,
) -> Diagnosis: ...


@overload
def diagnose(
    runs: Runs,
    effects: Sequence[str | type[AbstractEffect]] | None = None,
    *,
    against: Runs,
    progress: Report | None = None,
    settings: ChangeSettings = DEFAULT_CHANGE_SETTINGS,
) -> ChangeDiagnosis: ...


def diagnose(
    runs: Runs,
    effects: Sequence[str | type[AbstractEffect]] | None = None,
    *,
    against: Runs | None = None,
    progress: Report | None = None,
    settings: DiagnosisSettings | ChangeSettings | None = None,
) -> Diagnosis | ChangeDiagnosis:
    """Find which effect makes runs of one rig differ from the model, as `drft diagnose` does.

        found = drftjax.diagnose("data/blind/demo")
        print(found.summary())

    With `against`, find what changed since runs of the same rig and commands were made, whatever
    both share.

    Computes in double precision whatever the program around it uses.

    Args:
        runs: Files and folders of run logs, or run logs, one, several, or several by name. A run
            that cannot be used is left out, and the result's notes say why.
        effects: Names or classes: only these are considered; the whole catalogue otherwise.
        against: Runs of the same rig before, given as `runs` are.
        progress: Called with what is done next.
        settings: Numbers by which the diagnosis decides; of the kind that goes with `against`.

    Raises:
        InputError: where no run can be used, or an effect is not known; with `against`, where the
            rigs differ or no command was run on both sides.
    """
    chosen = effects_among(effects)
    report = progress or (lambda stage: None)
    with jax.enable_x64(True):
        if against is not None:
            return _diagnose_change(runs, against, chosen, report, settings)
        settings = _settings_of(DiagnosisSettings, settings, DEFAULT_SETTINGS)
        gathered = gather_inputs(runs)
        made = library_provenance(runs, settings.localization.seed)
        found = diagnose_gathered(gathered, chosen, report, settings=settings)
        return dataclasses.replace(found, provenance=made)


def _diagnose_change(
    runs: Runs,
    against: Runs,
    effects: Sequence[type[AbstractEffect]],
    report: Report,
    settings: DiagnosisSettings | ChangeSettings | None,
) -> ChangeDiagnosis:
    settings = _settings_of(ChangeSettings, settings, DEFAULT_CHANGE_SETTINGS)
    before = gather_inputs(against)
    now = gather_inputs(runs, before.runs[0].setup.start.origin)
    found = compare_gathered(before, now, effects, report, settings=settings)
    made = library_provenance(runs, settings.relabelling.seed)
    return dataclasses.replace(found, provenance=made)


def _settings_of(kind: type[Kind], given: object, default: Kind) -> Kind:
    """The settings given, or the default.

    Raises:
        InputError: where they are of another kind.
    """
    if given is None:
        return default
    if not isinstance(given, kind):
        raise InputError(
            f"settings is a {type(given).__name__}; it must be a {kind.__name__} "
            f"{'with' if kind is ChangeSettings else 'without'} against"
        )
    return given


def evaluate(
    runs: Runs,
    model: Diagnosis | str | Path | Sequence[AbstractEffect],
) -> Evaluation:
    """Compare a model with effects with runs that it was not fitted to, as `drft evaluate` does.

    Args:
        runs: As for `diagnose`.
        model: A diagnosis, for the effects of its model.toml; a set-up file; or effects with their
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
            effects = _in_double_precision(model)
        gathered = gather_inputs(runs, origin)
        caveats = [] if added is None else added.caveats(gathered.runs)
        driven, kinds = driven_by_measured_speed(gathered.runs, [type(each) for each in effects])
        kept = tuple(each for each in effects if type(each) in kinds)
        if len(kept) < len(effects):
            caveats.append(
                "The model is driven by the measured speed of the wheel, without its effects of "
                "the drive."
            )
        return evaluate_model(RigDataset.of(driven), kept, gathered.skipped, caveats)


def _in_double_precision(given: object) -> tuple[AbstractEffect, ...]:
    """Effects with their numbers in double precision.

    Raises:
        InputError: where something else is given.
    """
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

    A name stands for its other forms, too; that of a form, and a class, for itself.

    Raises:
        InputError: for a name that is not known, with the nearest ones that are; for no effect.
    """
    if wanted is None:
        return tuple(each for each in catalogue().values() if each.about.hypothesis)
    if isinstance(wanted, str):
        wanted = [wanted]
    if not wanted:
        raise InputError("no effect is named; `drft effects` lists them")
    classes = [
        one
        for each in wanted
        for one in (with_its_forms(effect_class(each)) if isinstance(each, str) else [each])
    ]
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


def with_its_forms(effect: type[AbstractEffect]) -> list[type[AbstractEffect]]:
    """An effect, and its other forms that a diagnosis looks for."""
    name, every = effect.about.name, catalogue().values()
    return [effect, *(e for e in every if e.about.form_of == name and e.about.hypothesis)]


def gather_inputs(runs: Runs, origin: float | None = None) -> GatheredRuns:
    """Runs of one wheel, from files, folders or run logs.

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
    prepared, left_out = [], {}
    for name, run in named_runs(runs).items():
        try:
            prepared.append(as_prepared(name, run, carriage_forces=True))
        except RunError as problem:
            left_out[name] = str(problem)
    if left_out and not prepared:
        raise InputError("; ".join(left_out.values()))
    usable = usable_runs(prepared)
    kept = require_one_rig(usable.runs, origin)
    return GatheredRuns(kept.runs, {**left_out, **usable.skipped, **kept.skipped})


def _require_null(runs: Sequence[PreparedRun], effects: Sequence[type[AbstractEffect]]) -> None:
    """Refuse effects of other packages that act where their strengths are zero.

    Raises:
        InputError: names the effect.
    """
    for effect in effects:
        if effect in OURS:
            continue
        dataset, model = RigDataset.of(runs[:1]), AugmentedModel((effect,))
        without = dataset.prediction(AugmentedModel(), 0, 0.0, np.zeros(0))
        change = np.abs(dataset.prediction(model, 0, 0.0, model.null()) - without).max()
        if np.isfinite(without).all() and not change <= NULL_EFFECT_TOLERANCE:
            raise InputError(
                f"the effect {effect.about.name!r} of {effect.__module__} acts where all its "
                f"strengths are zero (by {change:.2g} m or N in {runs[0].name}); it must be "
                "null there"
            )


def possible_effects(
    runs: Sequence[PreparedRun], effects: Sequence[type[AbstractEffect]]
) -> tuple[type[AbstractEffect], ...]:
    """Effects that the rig can have and the compared channels can show.

    A smooth wheel has no grousers to be shorter, and a torque that nobody read is not read wrongly.

    Raises:
        InputError: where none is left.
    """
    bare = runs[0].trial.simulator
    compared = tuple(dict.fromkeys(name for each in runs for name in each.observation.channels))

    def refusal(effect: type[AbstractEffect]) -> str:
        try:
            effect.about.require_shown(compared)
            dataclasses.replace(bare, effects=(effect(),)).check()
        except InputError as problem:
            return str(problem)
        return ""

    refusals = [refusal(each) for each in effects]
    if all(refusals):
        raise InputError(f"these runs can show none of the effects: {refusals[0]}")
    return tuple(each for each, why in zip(effects, refusals, strict=True) if not why)


def diagnose_gathered(
    gathered: GatheredRuns,
    effects: Sequence[type[AbstractEffect]],
    report: Report,
    tell: Callable[[str], None] = lambda _: None,
    settings: DiagnosisSettings = DEFAULT_SETTINGS,
) -> Diagnosis:
    """Diagnose the runs that the reference model can follow; leave out the others.

    Args:
        gathered: Runs of one wheel, and why others are not among them.
        effects: Effects to choose from; those that the wheel, the law or the carriage cannot have
            and those that no compared channel can show are left out.
        report: Called with what is done next.
        tell: Called with a sentence for every run that is left out here.
        settings: Numbers by which the diagnosis decides.

    Raises:
        InputError: where no run can be followed, or the rig can have none of the effects.
    """
    kept, notes = gathered.runs, list(gathered.skipped.values())
    effects = possible_effects(kept, effects)
    _require_null(kept, effects)
    possible = effects
    kept, effects = driven_by_measured_speed(kept, possible)
    while True:
        try:
            dataset = RigDataset.of(kept, settings.dataset)
            found = diagnose_dataset(dataset, effects, report, settings)
            break
        except RunError as problem:
            kept = [each for each in kept if each.name != problem.run]
            if not kept:
                raise
            notes.append(str(problem))
            tell(f"left out: {problem}")
    return dataclasses.replace(
        found,
        notes=[*found.notes, *(f"Left out: {why}" for why in notes)],
        drive=drive_error(kept, possible),
    )


def compare_gathered(
    before: GatheredRuns,
    now: GatheredRuns,
    effects: Sequence[type[AbstractEffect]],
    report: Report,
    tell: Callable[[str], None] = lambda _: None,
    settings: ChangeSettings = DEFAULT_CHANGE_SETTINGS,
) -> ChangeDiagnosis:
    """Find what changed between runs that the reference model can follow; leave out the others.

    Args:
        before, now: Runs of one rig, and why others are not among them.
        effects: Effects to choose from, as for `diagnose_gathered`.
        report: Called with what is done next.
        tell: Called with a sentence for every run that is left out here.
        settings: Numbers by which it decides.

    Raises:
        InputError: where the rigs differ, no command was run on both sides, or the rig can have
            none of the effects.
    """
    earlier, later = require_one_rig_on_both_sides(before.runs, now.runs)
    notes = [*before.skipped.values(), *now.skipped.values()]
    possible = possible_effects([*earlier, *later], effects)
    _require_null(later, possible)
    sides = {"before": drive_error(earlier, possible), "now": drive_error(later, possible)}
    drive = [
        f"Wheel speed {side}: {sentence}"
        for side, error in sides.items()
        if error is not None
        for sentence in error.sentences()
    ]
    driven, others = driven_by_measured_speed([*earlier, *later], possible)
    earlier, later = driven[: len(earlier)], driven[len(earlier) :]
    while True:
        tried = len(earlier), len(later)
        try:
            found = compare_runs(earlier, later, others, report, settings)
            break
        except RunError as problem:
            earlier, later = (
                [each for each in side if each.name != problem.run] for side in (earlier, later)
            )
            if not (earlier and later) or tried == (len(earlier), len(later)):
                raise
            notes.append(str(problem))
            tell(f"left out: {problem}")
    left_out = [f"Left out: {why}" for why in notes]
    return dataclasses.replace(found, notes=[*found.notes, *drive, *left_out])
