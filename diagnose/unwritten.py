"""What an effect that nobody has written looks like, and a correction that stands for it.

Where no effect of the list explains the runs, the simplest unknown signal is held against every
state variable. Where it follows one, the curve is fitted as a correction: all its runs simulated
freely, then those left out by condition, as any effect's.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from diagnose.added import Added, effects_of
from diagnose.bench import Bench
from diagnose.case import Case
from diagnose.evidence import WORTH
from diagnose.follows import Fitted, fitted, simplest
from diagnose.hypothesis import STRENGTH_BELIEF, Hypothesis, proposed, settled
from diagnose.left_out import at_mean_sinkage, predicted_unseen
from diagnose.response import Model, predict
from diagnose.shrinkage import gaps
from diagnose.stages import Stage
from diagnose.weights import SCALE
from drftjax.effects.correction import (
    STAGES,
    Curve,
    entry_of,
    in_modes,
    known_to,
    with_values,
)

# A signal follows a variable that explains this share of it; curves over so many of these are
# simulated, as straight lines tell little of how a curve goes on in runs left out.
FOLLOWS = 0.5
LIKELY = 3
# Simulations that its curve is fitted by.
TURNS = 6
# What an effect of the list means, whatever its form: sand that depends on the place, and a surface
# that is not flat.
MEANT = {("zeta", "travel"): "terrain_variation", ("height", "travel"): "surface_profile"}
# A curve of that meaning explains the runs where no more of the gap is left over all channels than
# `unknown` is taken to leave, or so many noise floors in each channel.
AT_FLOOR = 1.2
# It goes up and down along the bed, the lesser by this share of the larger: what only falls or
# rises with the way may as well be a matter of wear, of turning or of time.
BOTH_WAYS = 0.2
# A curve of that meaning stands before one over another variable that leaves hardly less: the way
# and the wheel's turning are nearly one where slip is.
HARDLY = 1.25
# Ways for a curve to bend are left out where they are believed to be this much smaller than the
# largest.
SMALLEST_MODE = 0.003


@dataclass(frozen=True, eq=False)
class Correction:
    """A curve that stands for an effect that nobody has written.

    Attributes:
        effect: With its values.
        explained: Share of the signal that such a curve explains on runs left out [-].
        added: What it leaves of the gap.
    """

    effect: Curve
    explained: float
    added: Added

    @property
    def means(self) -> str | None:
        """The effect of the list that it is a form of, where it explains the runs; else None."""
        least = max(SCALE.reached * self.added.before, AT_FLOOR * math.sqrt(len(self.added.gap)))
        steps = np.diff(np.asarray(self.effect.values()))
        rises, falls = steps.clip(0).sum(), (-steps).clip(0).sum()
        explains = self.added.helps and self.added.left <= least
        if not explains or min(rises, falls) < BOTH_WAYS * max(rises, falls):
            return None
        return MEANT.get((self.effect.stage, self.effect.variable))

    @property
    def unit(self) -> str:
        """Of its values; "-" for none."""
        return STAGES[self.effect.stage][1]

    def document(self) -> dict[str, Any]:
        """Plain values, in the layout of diagnosis.json."""
        entry = entry_of(self.effect)
        return {
            "stage": entry["stage"],
            "variable": entry["variable"],
            "unit": self.unit,
            "knots": entry["knots"],
            "values": entry["values"],
            "explained": self.explained,
            "gap": {channel: gap.document() for channel, gap in self.added.gap.items()},
        }


@dataclass(frozen=True, eq=False)
class Unwritten:
    """The simplest unknown signal.

    Attributes:
        stage: Where it would act.
        follows: Variables with the share of it that a curve over each explains: first that of
            `tried`, then the others, best first.
        tried: Of the corrections that were simulated, the one that leaves least; None where the
            signal follows nothing that its stage can know.
    """

    stage: Stage
    follows: Sequence[tuple[str, float]]
    tried: Correction | None

    def sentences(self, offered: bool) -> list[str]:
        """What it looks like, and why no correction is offered where none is."""
        said = f"The simplest unknown signal is one of {self.stage.name} ({self.stage.meaning})"
        if not self.follows or self.follows[0][1] < FOLLOWS:
            return [f"{said}; it follows none of the variables known."]
        name, share = self.follows[0]
        found = [f"{said}; it follows {name}, which explains {share:.0%} of it on runs left out."]
        if self.tried is None:
            found.append(f"Nothing that {self.stage.name} can know stands for it: no correction.")
        elif offered and self.tried.means is not None:
            found.append(
                f"That is what {self.tried.means} means, in another form than the list's: "
                "model.toml holds the curve, which has no numbers to name."
            )
        elif not offered:
            added = self.tried.added
            found.append(
                f"A correction by a curve of it over {self.tried.effect.variable} was tried and is "
                f"not offered: {added.left:.1f} of {added.before:.1f} noise floors are left."
            )
        return found


def unwritten(
    case: Case,
    found: Sequence[Stage],
    none: Hypothesis,
    before: Sequence[np.ndarray],
    floors: Mapping[str, float],
) -> Unwritten:
    """The simplest unknown signal of a case, and a correction where it follows something.

    Args:
        case: The runs.
        found: By `stages`, best first; not empty.
        none: The reference model, settled.
        before: What it leaves of each run, shape (channels, samples) [m, N, N m].
        floors: Noise floor of each channel.
    """
    stage, variables = simplest(case, found)
    known = [each for each in variables if each[0] in known_to(stage.name)]
    likely = [(name, share) for name, share in known if share >= FOLLOWS][:LIKELY]
    curves = [(curve, share) for name, share in likely for curve in fitted(case, stage, name)]

    def of(one: tuple[Fitted, float]) -> Correction | None:
        return corrected(case, *one, none, before, floors)

    tried = [each for each in case.side_by_side(of, curves) if each is not None]
    if not tried:
        return Unwritten(stage, variables, None)

    def left(one: Correction) -> tuple[bool, float]:
        return not one.added.helps, one.added.left

    best = min(tried, key=left)
    listed = min((each for each in tried if each.means is not None), key=left, default=best)
    if listed.added.left <= HARDLY * best.added.left:
        best = listed
    variables.sort(key=lambda each: each[0] != best.effect.variable)
    return Unwritten(stage, variables, best)


def corrected(
    case: Case,
    curve: Fitted,
    explained: float,
    none: Hypothesis,
    before: Sequence[np.ndarray],
    floors: Mapping[str, float],
) -> Correction | None:
    """A curve fitted by free-running simulation; None where it cannot be simulated."""
    modes = _modes(curve)
    kind = in_modes(curve.kind, modes, 1 / STRENGTH_BELIEF)
    case.warm(predict, [Model((kind,))])
    bench = Bench.of(case, none.log_zeta, [kind])
    best = settled(bench, proposed(bench, bench.variants), TURNS)
    if not best.simulated:
        return None
    after = at_mean_sinkage(bench, predicted_unseen(bench, best))
    (effect,) = effects_of(best)
    assert isinstance(effect, Curve)
    plain = with_values(curve.kind, np.asarray(effect.values()).tolist())
    added = Added((plain,), best.log_zeta, after, gaps(case, before, after, floors))
    return Correction(plain, explained, added)


def _modes(curve: Fitted) -> np.ndarray:
    """Curves whose amplitudes are believed to be one each, and independent, before any run."""
    # A fit by simulation takes a half second for less than the straight lines here do.
    precision = WORTH["slow"] * curve.precision
    size, way = np.linalg.eigh(precision)
    spread = 1 / np.sqrt(size)
    kept = spread > SMALLEST_MODE * spread.max()
    return way[:, kept] * spread[kept]
