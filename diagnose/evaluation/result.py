"""Evaluation: the gap of runs without and with the effects of a model."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import jax
import numpy as np
from rich.markup import escape

from diagnose.dataset import RigDataset
from diagnose.gap.gap import Gap
from diagnose.gap.zeta_matching import REFERENCE_NAME, WITH_EFFECTS_NAME, MatchedRun, unmatched
from drftjax.common.rich_text import WholeWordTable, summary_html, summary_text
from drftjax.effects.base import AbstractEffect
from drftjax.recorded.observation import SHOWN
from drftjax.tuning.step_tuner import StepTuner

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from diagnose.evaluation.tuner_activity import TunerActivity


@dataclass(frozen=True, eq=False, repr=False)
class Evaluation:
    """Gap of runs that a model was not fitted to, without and with its effects.

    Attributes:
        dataset: The runs.
        effects: Added by the model to the reference model.
        before, after: Each run by the reference model, and with the effects.
        gap: Over all runs, by channel.
        floors: Noise floor of each channel [m, N, N m].
        floor_source: A sentence on how the floors were found.
        caveats: Reasons that weaken the comparison, in sentences.
        skipped: Reasons why other runs are not among them, by name.
    """

    dataset: RigDataset
    effects: tuple[AbstractEffect, ...]
    before: list[MatchedRun]
    after: list[MatchedRun]
    gap: Mapping[str, Gap]
    floors: Mapping[str, float]
    floor_source: str
    caveats: Sequence[str] = ()
    skipped: Mapping[str, str] = field(default_factory=dict)

    @property
    def notes(self) -> list[str]:
        """All remarks, in sentences."""
        with_them = unmatched(self.dataset, self.after, WITH_EFFECTS_NAME) if self.effects else []
        return [
            self.floor_source,
            *self.caveats,
            *unmatched(self.dataset, self.before, REFERENCE_NAME),
            *with_them,
            *(f"Left out: {why}" for why in self.skipped.values()),
        ]

    def summary(self, width: int = 110) -> str:
        """Table and notes as text, `width` columns wide."""
        return summary_text([gap_table(self), *sentences(self)], width)

    def __repr__(self) -> str:
        names = ", ".join(each.about.name for each in self.effects) or "no effect"
        return f"<Evaluation of {len(self.dataset.runs)} runs: {names}>"

    def _repr_html_(self) -> str:
        return summary_html([gap_table(self), *sentences(self)])

    def tuned(
        self, tick: float = 0.01, zeta_step: float = 1e-3, tolerance: float = 1e-4
    ) -> "list[tuple[TunerActivity, TunerActivity]]":
        """Activity of the online tuner of Fuke et al. 2024, eq. 7, in each run, before and after.

        Args:
            tick: Its control period [s].
            zeta_step: Change of zeta on one tick [-].
            tolerance: Error of the sinkage that it does not correct [m].

        Raises:
            InputError: where a number is out of range, a replay diverges, or no tick falls where a
                wheel moves.
        """
        from diagnose.evaluation.tuner_activity import tuner_activity

        with jax.enable_x64(True):
            return tuner_activity(
                self.dataset, self.effects, self.zeta, StepTuner(tick, zeta_step, tolerance)
            )

    def plot(self) -> "Figure":
        """Recorded and simulated channels of each run, above their residuals."""
        from diagnose.evaluation.figure import evaluation_figure

        return evaluation_figure(self)

    def rmse(self, run: int) -> dict[str, tuple[float, float]]:
        """One run's RMS residual before and after, by recorded channel [m, N, N m]."""
        pairs = zip(
            self.dataset.channels, self.before[run].residual, self.after[run].residual, strict=True
        )
        return {
            channel: (_rms(before), _rms(after))
            for channel, before, after in pairs
            if np.isfinite(before).all()
        }

    def zeta(self, run: int) -> tuple[float, float]:
        """Matched zeta of one run by the reference model, and with the effects [-]."""
        own = float(self.dataset.runs[run].setup.terrain.zeta)  # pyright: ignore
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
                for run, each in enumerate(self.dataset.runs)
            ],
            "notes": self.notes,
        }


def _named(channel: str, **values: float) -> dict[str, float | str]:
    """Numbers of a channel in the unit of reports, and that unit."""
    unit, scale = SHOWN[channel]
    return {**{name: value * scale for name, value in values.items()}, "unit": unit}


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def sentences(found: Evaluation) -> list[str]:
    """Model, assumptions and remarks, in sentences."""
    names = ", ".join(each.about.name for each in found.effects)
    if not names:
        return ["The model has no effect: it is the reference model.", *found.notes]
    return [
        f"before: the reference model; after: with {names}. zeta is each run's own, and all else "
        "what its log believes.",
        *found.notes,
    ]


def gap_table(found: Evaluation) -> WholeWordTable:
    """Table of the gap of every run and of all, before and after."""
    table = WholeWordTable()
    table.add_column("run")
    table.add_column("zeta", justify="right")
    channels = found.dataset.channels
    for channel in channels:
        table.add_column(escape(f"{channel} [{SHOWN[channel][0]}]"), justify="right")
    for run, each in enumerate(found.dataset.runs):
        cells = found.rmse(run)
        first, last = found.zeta(run)
        table.add_row(
            escape(each.name),
            f"{first:.4f} → {last:.4f}",
            *(_pair(channel, *cells[channel]) if channel in cells else "-" for channel in channels),
        )
    table.add_section()
    gaps = [found.gap[channel] for channel in channels]
    pairs = zip(channels, gaps, strict=True)
    table.add_row("all runs", "", *(_pair(c, gap.before, gap.after) for c, gap in pairs))
    scaled = [f"{SHOWN[c][1] * found.floors[c]:.3f}" for c in channels]
    table.add_row("noise floor", "", *scaled)
    floors = [f"{gap.before / gap.floor:.1f} → {gap.after / gap.floor:.1f}" for gap in gaps]
    table.add_row("in floors", "", *floors)
    return table


def _pair(channel: str, before: float, after: float) -> str:
    scale = SHOWN[channel][1]
    return f"{scale * before:.3f} → {scale * after:.3f}"
