"""A model with effects against runs that it was not found on."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import jax
import numpy as np

from diagnose import odd_runs
from diagnose.added import as_model
from diagnose.case import Case
from diagnose.floor import noise_floors
from diagnose.mean_sinkage import REFERENCE, WITH, Followed, followed, not_met, residuals_of
from diagnose.plates import APART, own_errors
from diagnose.response import Model
from diagnose.shrinkage import Gap, gaps
from drftjax.effects.stage import AbstractEffect
from drftjax.errors import InputError
from drftjax.tuner import StepTuner
from identify.result import SHOWN
from identify.summary import summary_html, summary_text

if TYPE_CHECKING:
    from diagnose.tuned import Moves


@dataclass(frozen=True, eq=False, repr=False)
class Evaluation:
    """What a model leaves of the gap.

    Attributes:
        case: The runs.
        effects: What the model adds to the reference model.
        before, after: Each run by the reference model, and with the effects.
        gap: Pooled over the runs, by channel.
        floors: Noise floor of each channel [m, N, N m].
        how: On what the floors rest.
        doubts: What speaks against the comparison, in sentences.
        left_out: Why other runs are not among them, by name.
    """

    case: Case
    effects: tuple[AbstractEffect, ...]
    before: list[Followed]
    after: list[Followed]
    gap: Mapping[str, Gap]
    floors: Mapping[str, float]
    how: str
    doubts: Sequence[str] = ()
    left_out: Mapping[str, str] = field(default_factory=dict)

    @property
    def notes(self) -> list[str]:
        """What else must be known, in sentences."""
        with_them = not_met(self.case, self.after, WITH) if self.effects else []
        return [
            self.how,
            *self.doubts,
            *not_met(self.case, self.before, REFERENCE),
            *with_them,
            *(f"Left out: {why}" for why in self.left_out.values()),
        ]

    def summary(self, width: int = 110) -> str:
        """Table and notes as text, so many columns wide."""
        from diagnose.evaluation_table import gap_table, sentences

        return summary_text([gap_table(self), *sentences(self)], width)

    def __repr__(self) -> str:
        names = ", ".join(each.about.name for each in self.effects) or "no effect"
        return f"<Evaluation of {len(self.case.candidates)} runs: {names}>"

    def _repr_html_(self) -> str:
        from diagnose.evaluation_table import gap_table, sentences

        return summary_html([gap_table(self), *sentences(self)])

    def tuned(
        self, tick: float = 0.01, zeta_step: float = 1e-3, tolerance: float = 1e-4
    ) -> "list[tuple[Moves, Moves]]":
        """How the online tuner of eq. 7 moves zeta in each run, before and after.

        Args:
            tick: Its control period [s].
            zeta_step: Change of zeta on one tick [-].
            tolerance: Error of the sinkage that is left alone [m].

        Raises:
            InputError: where a number cannot be, a replay diverges, or no tick falls where a wheel
                moves.
        """
        from diagnose.tuned import moves

        with jax.enable_x64(True):
            return moves(self, StepTuner(tick, zeta_step, tolerance))

    def rmse(self, run: int) -> dict[str, tuple[float, float]]:
        """One run's gap before and after by channel [m, N, N m]; of channels recorded only."""
        pairs = zip(
            self.case.channels, self.before[run].residual, self.after[run].residual, strict=True
        )
        return {
            channel: (_rms(before), _rms(after))
            for channel, before, after in pairs
            if np.isfinite(before).all()
        }

    def zeta(self, run: int) -> tuple[float, float]:
        """zeta of one run by the reference model, and with the effects."""
        own = float(self.case.candidates[run].setup.terrain.zeta)  # pyright: ignore
        first, last = (float(np.exp(f[run].log_zeta)) for f in (self.before, self.after))
        return own * first, own * last

    def document(self) -> dict:
        """Plain values, in the layout of the JSON file."""
        return {
            "floor": {channel: _named(channel, floor=f) for channel, f in self.floors.items()},
            "gap": {
                channel: {
                    **_named(channel, before=gap.before, after=gap.after, floor=gap.floor),
                    "shrinkage": gap.shrinkage,
                    "shrinkage_interval": None if gap.interval is None else list(gap.interval),
                }
                for channel, gap in self.gap.items()
            },
            "runs": [
                {
                    "name": each.name,
                    "zeta": dict(zip(("before", "after"), self.zeta(run), strict=True)),
                    "gap": {
                        channel: _named(channel, before=before, after=after)
                        for channel, (before, after) in self.rmse(run).items()
                    },
                }
                for run, each in enumerate(self.case.candidates)
            ],
            "notes": self.notes,
        }


def _named(channel: str, **values: float) -> dict[str, float | str]:
    """Numbers of a channel in the unit that is given beside them."""
    unit, scale = SHOWN[channel]
    return {**{name: value * scale for name, value in values.items()}, "unit": unit}


def evaluated(
    case: Case,
    effects: Sequence[AbstractEffect],
    left_out: Mapping[str, str] | None = None,
    caveats: Sequence[str] = (),
) -> Evaluation:
    """The gap of runs without and with effects whose numbers stay as they are.

    Args:
        case: The runs.
        effects: Added to what each run's set-up says.
        left_out: Why other runs are not among them, by name.
        caveats: What is known to speak against the comparison, in sentences.

    A run whose wheel leaves what the model covers, with or without the effects, is left out.

    Raises:
        InputError: where no run is left.
    """
    model, coordinates = as_model(effects)
    before = followed(case, Model(), np.zeros(0))
    after = followed(case, model, coordinates) if effects else before
    if lost := _not_covered(case, after, WITH) | _not_covered(case, before, REFERENCE):
        kept = [each for run, each in enumerate(case.candidates) if run not in lost]
        if not kept:
            raise InputError(f"{lost[min(lost)]}; look at the numbers of the model")
        why = {case.candidates[run].name: each for run, each in lost.items()}
        return evaluated(Case.of(kept), effects, {**(left_out or {}), **why}, caveats)
    residuals = residuals_of(before), residuals_of(after)
    own = own_errors(case, np.array([each.log_zeta for each in before]))

    def by_zeta(run: int) -> np.ndarray:
        """Along a straight line over one per cent."""
        at, nothing = before[run].log_zeta, np.zeros(0)
        here, there = (case.predicted(Model(), run, each, nothing) for each in (at, at + APART))
        return (there - here) / APART

    floors, how = noise_floors(case, *residuals, own, by_zeta)
    gap = gaps(case, *residuals, floors)
    doubts = [*caveats, *odd_runs.of_repeats(case, residuals, own, by_zeta)]
    return Evaluation(case, tuple(effects), before, after, gap, floors, how, doubts, left_out or {})


def _not_covered(case: Case, runs: Sequence[Followed], model: str) -> dict[int, str]:
    """Runs whose wheel takes off, or sinks deeper than its plates cover, by number, and why."""
    z, found = case.channels.index("z"), {}
    for run, each in enumerate(runs):
        name = case.candidates[run].name
        limit = float(case.candidates[run].trial.simulator.wheel.cut().sinkage_limit)
        farthest = float(np.abs(each.residual[z] + case.recorded(run)[z]).max())
        if not np.isfinite(farthest):
            found[run] = f"{name}: its simulation by {model} diverges"
        elif not farthest < limit:
            found[run] = (
                f"{name}: by {model} its z reaches {1e3 * farthest:.4g} mm, must stay within "
                f"{1e3 * limit:.4g} mm, which the wheel's plates cover"
            )
    return found


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
