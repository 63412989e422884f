"""The result of a comparison: whether the rig changed, what, by how much, and how sure that is."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from diagnose.change.budget import DifferenceBudget
from diagnose.change.hypothesis import ZETA, ChangeHypothesis, ChangeProblem
from diagnose.change.relabelling import RelabellingTest
from diagnose.result import SCHEMA, SCHEMA_VERSION, ParameterEstimate
from diagnose.selection.model_weights import NONE
from drftjax.common.rich_text import summary_html, summary_text
from drftjax.effects.catalogue import effect_class
from drftjax.results.provenance import Provenance

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False, repr=False)
class ChangeDiagnosis:
    """The change of one rig between two sets of runs of the same commands.

    Attributes:
        verdict: The change's name: an effect, "zeta", "none" or "unknown". A tuple, as in a
            `Diagnosis`.
        weights: Weight of each explanation by name [-], heaviest first.
        groups: Names that these runs cannot tell from the verdict's, that one first.
        parameters: Numbers of the change by effect and field. A strength below zero that has no
            meaning below zero has grown weaker since `before`.
        budget: Parts of the difference, by channel.
        relabelling: Test of a change without a model of noise.
        notes: Reasons and caveats, in sentences.
        problem: The runs.
        chosen: The explanation behind the verdict; of "unknown", the likeliest that is known.
        provenance: Its inputs, its command line, and what it was made with.
    """

    verdict: tuple[str, ...]
    weights: Mapping[str, float]
    groups: Sequence[Sequence[str]]
    parameters: Mapping[str, Mapping[str, ParameterEstimate]]
    budget: Sequence[DifferenceBudget]
    relabelling: RelabellingTest
    notes: Sequence[str]
    problem: ChangeProblem
    chosen: ChangeHypothesis
    provenance: Provenance | None = None

    @property
    def is_changed(self) -> bool:
        """True where something changed."""
        return self.verdict != (NONE,)

    @property
    def conditions(self) -> list[tuple[list[str], list[str]]]:
        """For each matched condition, names of its runs before and now."""
        names = [each.name for each in self.problem.differences.dataset.runs]
        matched = (clock.condition for clock in self.problem.differences.clocks)
        return [([names[i] for i in c.before], [names[i] for i in c.now]) for c in matched]

    def meaning(self, name: str) -> str:
        """Meaning of a name of the verdict."""
        if name == ZETA:
            return "the sand's own strength changed"
        own = {each.about.name: each for each in self.chosen.model.effects}
        return (own.get(name) or effect_class(name)).about.meaning

    def summary(self, width: int = 110) -> str:
        """The change in words, as text of `width` columns."""
        from diagnose.change.report import in_words

        return summary_text(in_words(self), width)

    def __repr__(self) -> str:
        runs = self.problem.differences.is_now
        return f"<Change from {(~runs).sum()} runs to {runs.sum()}: {', '.join(self.verdict)}>"

    def _repr_html_(self) -> str:
        from diagnose.change.report import in_words

        return summary_html(in_words(self))

    def plot(self) -> "Figure":
        """The difference between now and before, condition by condition, and what explains it."""
        from diagnose.change.figures import difference_figure

        return difference_figure(self)

    def write(self, folder: str | Path) -> list[Path]:
        """Write diagnosis.json and report.html.

        Raises:
            InputError: where one cannot be written.
        """
        from diagnose.change.report import write

        return write(self, Path(folder))

    def document(self) -> dict:
        """The comparison as plain values, in the layout of diagnosis.json."""
        return {
            "schema": SCHEMA,
            "schema_version": SCHEMA_VERSION,
            "provenance": None if self.provenance is None else self.provenance.document(),
            "verdict": list(self.verdict),
            "weights": dict(self.weights),
            "groups": [list(group) for group in self.groups],
            "parameters": {
                name: {
                    number: {"value": n.value, "error": n.error, "unit": n.unit}
                    for number, n in fields.items()
                }
                for name, fields in self.parameters.items()
            },
            "against": {
                "changed": self.is_changed,
                "conditions": [{"before": before, "now": now} for before, now in self.conditions],
                "relabelling": {
                    "p": self.relabelling.p,
                    "orders": self.relabelling.orders,
                    "least_p": self.relabelling.least_p,
                },
                "zeta_scatter": self.chosen.fit.scatter,
                "law_factors": self.problem.law_factors(self.chosen),
                "difference": {
                    each.channel: {
                        "rms": each.rms,
                        "change": each.change,
                        "zeta_scatter": each.zeta_scatter,
                        "remainder": each.remainder,
                        "noise": each.noise,
                    }
                    for each in self.budget
                },
            },
            "notes": list(self.notes),
        }
