"""Model file of a diagnosis: a set-up file with the effects that were found."""

import copy
from collections.abc import Mapping

import numpy as np

from diagnose.gap.gap import Gap
from diagnose.result import Diagnosis, ParameterEstimate
from diagnose.selection.model_weights import NONE, UNKNOWN
from drftjax.common.text import replace_unprintable, value_with_error
from drftjax.effects.base import AbstractEffect
from drftjax.effects.catalogue import reported_name
from drftjax.effects.correction import VARIABLES
from drftjax.effects.serialization import entry_of, name_of
from drftjax.recorded.repeats import group_by_condition
from drftjax.setups.command_knots import decimate_command
from drftjax.setups.setup_toml import setup_toml

MODEL_FILE_MARK = "From a diagnosis of"
"""Beginning of the first comment of every model file."""


def model_toml(found: Diagnosis) -> str:
    """Text of the set-up file with the effects that were found.

    Wheel, rig, start and command are those of the first run; zeta is the mean over the runs.
    Standard errors of the effects' numbers stand in comments.
    """
    runs = found.dataset.runs
    setup = copy.deepcopy(runs[0].setup)
    zeta = np.array([float(each.setup.terrain.zeta) for each in runs])  # pyright: ignore
    zeta = zeta * np.exp(found.selected.log_zeta)
    setup.title = f"{replace_unprintable(setup.title)}, with what a diagnosis found"
    setup.command = decimate_command(setup.command)
    setup.terrain.zeta = float(zeta.mean())
    setup.effects = [entry_of(effect) for effect in found.selected.effects]
    comments = {("terrain", "zeta"): _scatter(zeta)}
    for number, effect in enumerate(found.selected.effects, start=1):
        comments |= {
            (f"effect {number}", key): each for key, each in _comments(found, effect).items()
        }
    return setup_toml(setup, _head(found), comments)


def _comments(found: Diagnosis, effect: AbstractEffect) -> dict[str, str]:
    """Comments beside an effect's numbers, by field."""
    offered = found.correction
    if offered is None:
        numbers = found.parameters[reported_name(effect.about.name)]
        return {key: estimate_in_words(each) for key, each in numbers.items()}
    units = {"knots": VARIABLES[offered.effect.variable], "values": offered.unit}
    return {key: unit for key, unit in units.items() if unit != "-"}


def estimate_in_words(number: ParameterEstimate) -> str:
    """A number with its standard error and unit, in words of one line."""
    unit = "" if number.unit == "-" else f" {number.unit}"
    return f"{value_with_error(number.value, number.error)}{unit}"


def _head(found: Diagnosis) -> list[str]:
    """Comment lines at the top of the file."""
    names = ", ".join(replace_unprintable(each.name) for each in found.dataset.runs)
    lines = [f"{MODEL_FILE_MARK} {names}."]
    if found.verdict == (NONE,):
        lines.append("No effect was found: this is the reference model.")
    elif found.correction is not None:
        on = (
            "held-out runs"
            if len(group_by_condition(found.dataset.runs)) > 1
            else "these very runs"
        )
        explains = (
            "No effect that is known explains these runs."
            if found.verdict == (UNKNOWN,)
            else f"These runs show {found.verdict[0]}, in another form than the list's."
        )
        lines += [
            f"{explains} A curve fitted to them changes the gap",
            f"on {on}, in noise floors: {_in_floors(found.gap)}.",
        ]
    elif found.selected.effects and found.verdict == (UNKNOWN,):
        lines.append("No effect explains these runs; the likeliest one that is known stands below.")
    elif found.verdict == (UNKNOWN,):
        lines.append("No effect shrinks the gap of these runs: this is the reference model.")
    if own := found.dataset.runs[0].setup.effects:
        names = ", ".join(str(name_of(each)) for each in own)
        lines.append(f"The set-up that was given had effects, which are not in this file: {names}.")
    lines += [
        "Wheel, rig, start and command are those of the first run; the effects go with any:",
        "  drft simulate model.toml -o run.h5",
        "  drft evaluate --model model.toml OTHER_RUNS",
    ]
    return lines


def _in_floors(gaps: Mapping[str, Gap]) -> str:
    """Gaps before and after, in noise floors."""
    return ", ".join(
        f"{channel} from {gap.before / gap.floor:.1f} to {gap.after / gap.floor:.1f}"
        for channel, gap in gaps.items()
    )


def _scatter(zeta: np.ndarray) -> str:
    """Comment on the zetas of the runs, shape (runs,)."""
    if len(zeta) == 1:
        return "of the one run"
    return f"mean of {len(zeta)} runs, which scatter by {zeta.std(ddof=1) / zeta.mean():.2%}"
