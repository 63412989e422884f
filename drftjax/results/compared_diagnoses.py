"""Diagnoses side by side: their verdicts, weights and numbers, and the runs that they ask for."""

from collections.abc import Sequence

import msgspec

from drftjax.common.structured_files import to_structure
from drftjax.results.advice import NextRunAdvice, worded
from drftjax.results.compared_files import (
    SIDE_BY_SIDE_SETTINGS,
    ComparedResults,
    FileValue,
    ReportedValue,
    ResultInput,
    SideBySideSettings,
    compared_quantities,
    input_sentences,
)


class DiagnosisEntry(msgspec.Struct):
    """A diagnosis's file."""

    verdict: list[str]
    weights: dict[str, float | None]
    parameters: dict[str, dict[str, ReportedValue]]
    groups: list[list[str]] = []
    next_run: NextRunAdvice = NextRunAdvice()


def compare_diagnoses(
    files: Sequence[ResultInput], settings: SideBySideSettings = SIDE_BY_SIDE_SETTINGS
) -> ComparedResults:
    """Compare the verdicts of diagnoses, the weights of effects and the effects' numbers.

    Args:
        files: Results of diagnoses, two or more.
        settings: Numbers of the sentences.

    Raises:
        InputError: names a file that is no diagnosis, and the entry.
    """
    diagnoses = [to_structure(each.plain, DiagnosisEntry, each.path) for each in files]
    names = [each.name for each in files]
    found: dict[str, tuple[str, str, list[FileValue | None]]] = {}
    for at, each in enumerate(diagnoses):
        for effect, numbers in each.parameters.items():
            for key, number in numbers.items():
                if number.value is None:
                    continue
                name = f"{effect}.{key}"
                row = found.setdefault(name, (name, number.unit, [None] * len(files)))
                row[2][at] = FileValue(number.value, number.error)
    quantities = compared_quantities(found, settings)
    sentences = [
        *input_sentences(files),
        *_verdict_sentences(diagnoses, names),
        *(each.sentence(names) for each in quantities if each.disagrees),
    ]
    if agreeing := [q.label for q in quantities if q.agreement is not None and not q.disagrees]:
        agree = "agrees within its" if len(agreeing) == 1 else "agree within their"
        sentences.append(f"{', '.join(agreeing)} {agree} errors.")
    effects = dict.fromkeys(name for each in diagnoses for name in each.weights)
    weights = {name: [each.weights.get(name) for each in diagnoses] for name in effects}
    largest = {name: max(each or 0.0 for each in row) for name, row in weights.items()}
    ranked = sorted(effects, key=lambda name: -largest[name])
    weights = {name: weights[name] for name in ranked if largest[name] >= settings.shown_weight}
    steps = _next_steps(diagnoses, names)
    return ComparedResults(files[0].schema, files, quantities, sentences, steps, weights)


def _verdict_sentences(diagnoses: Sequence[DiagnosisEntry], names: Sequence[str]) -> list[str]:
    """Sentences on verdicts that are the same, that differ, and that do not rule each other out."""
    verdicts = [" with ".join(map(worded, each.verdict)) for each in diagnoses]
    if len({frozenset(each.verdict) for each in diagnoses}) == 1:
        return [f"All name {verdicts[0]}."]
    each_names = (f"{name} names {verdict}" for name, verdict in zip(names, verdicts, strict=True))
    sentences = [f"{'; '.join(each_names)}."]
    for one, each in zip(names, diagnoses, strict=True):
        alike = {name for group in each.groups for name in group} - {*each.verdict}
        for other, rival in zip(names, diagnoses, strict=True):
            shared = [name for name in rival.verdict if name in alike]
            if shared and other != one:
                sentences.append(
                    f"The runs of {one} cannot tell {' and '.join(map(worded, shared))} from what "
                    f"it names: it does not speak against {other}."
                )
    return sentences


def _next_steps(diagnoses: Sequence[DiagnosisEntry], names: Sequence[str]) -> list[str]:
    """Sentences on the runs that diagnoses ask for, and on a diagnosis of all runs together."""
    steps = [
        f"{name}: {sentence}"
        for name, each in zip(names, diagnoses, strict=True)
        for sentence in each.next_run.sentences()
    ]
    if len({frozenset(each.verdict) for each in diagnoses}) > 1:
        steps.append(
            "Where the runs are of one rig, `drft diagnose` on all of them weighs these verdicts "
            "against each other."
        )
    return steps
