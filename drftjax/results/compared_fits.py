"""Fits side by side: their parameters, and the run that would tell the worst of them."""

import math
import shlex
from collections.abc import Sequence
from itertools import combinations
from typing import Final

import msgspec
import numpy as np

from drftjax.common.structured_files import to_structure
from drftjax.results.compared_files import (
    SIDE_BY_SIDE_SETTINGS,
    ComparedQuantity,
    ComparedResults,
    FileValue,
    ReportedValue,
    ResultInput,
    SideBySideSettings,
    compared_quantities,
    input_sentences,
)
from drftjax.results.random_effects import paule_mandel

# Sections of a set-up: a parameter of another one is a number of an effect.
SECTIONS: Final = ("terrain", "wheel", "rig", "start")

# Parameters that `drft design` counts as unknown by itself.
USUAL_NUISANCES: Final = {"zeta", "lambda"}


class FitRunEntry(msgspec.Struct):
    """One run of a fit's file."""

    name: str
    status: str
    values: dict[str, ReportedValue]
    zeta_path: dict | None = None


class FitEntry(msgspec.Struct):
    """A fit's file."""

    status: str
    shared: dict[str, ReportedValue]
    runs: list[FitRunEntry]


def compare_fits(
    files: Sequence[ResultInput], settings: SideBySideSettings = SIDE_BY_SIDE_SETTINGS
) -> ComparedResults:
    """Compare the values of fits, each with its error.

    Of each run's own values the mean is compared, with the scatter from run to run in its error.

    Args:
        files: Results of fits, two or more.
        settings: Numbers of the sentences.

    Raises:
        InputError: names a file that is no fit's result, and the entry.
    """
    fits = [to_structure(each.plain, FitEntry, each.path) for each in files]
    names = [each.name for each in files]
    found: dict[str, tuple[str, str, list[FileValue | None]]] = {}
    for at, fit in enumerate(fits):
        for name, (label, unit, value) in _values(fit).items():
            found.setdefault(name, (label, unit, [None] * len(fits)))[2][at] = value
    quantities = compared_quantities(found, settings)
    sentences = input_sentences(files)
    for name, fit in zip(names, fits, strict=True):
        if fit.status != "converged":
            sentences.append(
                f"{name} ended as {fit.status!r}: its values are less sure than reported."
            )
        if any(run.zeta_path is not None for run in fit.runs):
            sentences.append(f"{name} holds zeta(t) of its runs, which is not compared.")
    sentences += _agreement_sentences(quantities, names)
    return ComparedResults(
        files[0].schema, files, quantities, sentences, _next_steps(quantities, files)
    )


def _values(fit: FitEntry) -> dict[str, tuple[str, str, FileValue]]:
    """Label, unit and value of each parameter of a fit, by its name."""
    found = {
        name: (each.label or name, each.unit, _single(each))
        for name, each in fit.shared.items()
        if each.value is not None
    }
    own: dict[str, list[ReportedValue]] = {}
    for run in fit.runs:
        if run.status != "diverged":
            for name, each in run.values.items():
                own.setdefault(name, []).append(each)
    for name, values in own.items():
        if (mean := _mean(values)) is not None:
            found[name] = (values[0].label or name, values[0].unit, mean)
    return found


def _single(each: ReportedValue) -> FileValue:
    assert each.value is not None
    return FileValue(each.value, each.error, at_bound=each.at_bound)


def _mean(values: Sequence[ReportedValue]) -> FileValue | None:
    """Mean of the runs' own values by Paule and Mandel, of those that have an error to go by."""
    known = [each for each in values if each.value is not None]
    told = [each for each in known if _single(each).counts]
    if not told:
        mean = (
            float(np.mean(np.array([each.value for each in known], float))) if known else math.nan
        )
        at_bound = all(each.at_bound for each in known)
        return FileValue(mean, None, len(known), at_bound=at_bound) if known else None
    effect = paule_mandel(
        np.array([each.value for each in told], float),
        np.array([each.error for each in told], float),
    )
    scatter = math.sqrt(effect.variance)
    return FileValue(effect.mean, effect.error, len(told), scatter)


def _agreement_sentences(quantities: Sequence[ComparedQuantity], names: Sequence[str]) -> list[str]:
    """Sentences on parameters that disagree, that agree, and that some fits lack."""
    sentences = [each.sentence(names) for each in quantities if each.disagrees]
    agreeing = [each for each in quantities if each.agreement is not None and not each.disagrees]
    if agreeing:
        labels = ", ".join(each.label for each in agreeing)
        agree = "agrees within its" if len(agreeing) == 1 else "agree within their"
        sentences.append(f"{labels} {agree} errors.")
    for each in quantities:
        having = [name for name, v in zip(names, each.values, strict=True) if v is not None]
        if len(having) < len(names):
            verb = "fits" if len(having) == 1 else "fit"
            sentences.append(f"Only {', '.join(having)} {verb} {each.label}.")
    return sentences


def _next_steps(quantities: Sequence[ComparedQuantity], files: Sequence[ResultInput]) -> list[str]:
    """Sentences on what to record next: repeats of what disagrees, a run for the rest."""
    if not quantities:
        return []
    sentences = []
    disagreeing = sorted((each for each in quantities if each.disagrees), key=_scatter)
    logs = [each.run_logs.keys() for each in files]
    if disagreeing and not any(one & other for one, other in combinations(logs, 2)):
        sentences.append(
            f"Record one run twice, with the sand prepared again, since {disagreeing[-1].label} "
            "disagrees most: where the two differ as much, the sand does; where they do not, `drft "
            "diagnose` on all the runs looks for what the model lacks."
        )
    # What is each run's own may differ from run to run; a better run would not make it agree.
    common = [each for each in disagreeing if not _is_own(each)]
    worst = common[-1] if common else max(quantities, key=_share)
    share = _share(worst)
    told = f"known to {100 * share:.2g} % at best" if math.isfinite(share) else "not identified"
    reason = f"disagrees most, and is {told}" if common else f"is {told}, worse than the others"
    if len(quantities) == 1 and not common:
        reason = f"is {told}"
    command = _design_command(worst, quantities, files)
    return [*sentences, f"{worst.label} {reason}. The run that would identify it: {command}"]


def _scatter(quantity: ComparedQuantity) -> float:
    return quantity.agreement.ratio if quantity.agreement is not None else 0.0


def _is_own(quantity: ComparedQuantity) -> bool:
    """True where it is each run's own in every fit that has it."""
    return all(each is None or each.runs is not None for each in quantity.values)


def _share(quantity: ComparedQuantity) -> float:
    """Smallest standard error of any file as a share of the value; infinite without any."""
    shares = [
        each.error / abs(each.value)
        for each in quantity.values
        if each is not None and each.counts and each.value and each.error
    ]
    return min(shares, default=math.inf)


def _design_command(
    wanted: ComparedQuantity, quantities: Sequence[ComparedQuantity], files: Sequence[ResultInput]
) -> str:
    """`drft design` for the run that tells a parameter, as far as the files say from which run."""
    if wanted.name.partition(".")[0] in SECTIONS:
        logs = [log for each in files for log in each.run_logs.values()]
        source = f"--like {shlex.quote(logs[0]) if logs else 'RUN.h5'}"
    else:
        source = "MODEL.toml"  # a run log knows no effects; a set-up file does
    others = [each.name for each in quantities if each is not wanted]
    name, *nuisances = dict.fromkeys(map(_designed, [wanted.name, *others]))
    words = ["drft design", source, "--parameter", name]
    if not {*nuisances} <= USUAL_NUISANCES:
        words += [word for each in nuisances for word in ("--nuisance", each)]
    return " ".join(words)


def _designed(name: str) -> str:
    """Name by which `drft design` knows a parameter: it has one zeta for all phases."""
    if name.startswith("terrain.zeta"):
        return "zeta"
    return "lambda" if name == "terrain.inertial_coefficient" else name
