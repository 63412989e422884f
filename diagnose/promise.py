"""What a diagnosis promised, measured on runs that it never saw."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from diagnose.added import as_model
from diagnose.case import Case
from diagnose.diagnosis import Diagnosis
from diagnose.mean_sinkage import followed
from diagnose.response import Model
from diagnose.runs import from_one_start
from diagnose.shrinkage import Gap, gaps
from identify.candidate import candidates_of


def measured_on(diagnosis: Diagnosis, paths: Sequence[Path]) -> dict[str, Gap]:
    """The gap before and after on other runs of the same rig, by channel.

    Args:
        diagnosis: Whose effects or correction are added, with their numbers as they are.
        paths: The other runs.
    """
    case = Case.of(from_one_start(candidates_of(list(paths)), diagnosis.origin))
    before = followed(case, Model(), np.zeros(0))
    after = followed(case, *as_model(diagnosis.added.effects))
    return gaps(
        case,
        [each.residual for each in before],
        [each.residual for each in after],
        diagnosis.floors,
    )
