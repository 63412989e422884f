"""The budget of the gap in words and as a table: which effect makes how much of it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from rich.markup import escape

from diagnose.gap.budget import ChannelBudget
from diagnose.linear.bed import FreeBed
from diagnose.report.remedies import remedy
from diagnose.report.user_terms import in_user_terms
from diagnose.result import Diagnosis
from diagnose.selection.model_weights import UNKNOWN, percent
from drftjax.common.rich_text import WholeWordTable
from drftjax.recorded.observation import SHOWN


@dataclass(frozen=True)
class BudgetTextSettings:
    """Thresholds of the sentences.

    Attributes:
        min_remainder_weight: A remainder is reported that is likelier than not [-].
        min_hidden_share: The gap with one zeta is reported where it is larger than that with each
            run's own, or its floor, by this share of it [-].
        made_up_share: These runs cannot show an effect of which another zeta makes up for so much
            [-]: what is left is less than its formula may be wrong by.
    """

    min_remainder_weight: float = 0.5
    min_hidden_share: float = 0.5
    made_up_share: float = 0.98


DEFAULT_BUDGET_TEXT = BudgetTextSettings()


def budget_columns(found: Diagnosis) -> tuple[str, ...]:
    """Headings: what makes the gap, and size and share by channel."""
    channels = (head for c in found.budget for head in (f"{c} [{SHOWN[c][0]}]", "share (90 %)"))
    return ("the gap comes from", *channels)


def budget_rows(found: Diagnosis) -> list[tuple[str, ...]]:
    """Rows: the gap, each effect of the verdict, the remainder, chance."""
    budgets = list(found.budget.items())
    rows = [("whole gap", *_cells(budgets, lambda b: (b.before, "")))]
    for name in dict.fromkeys(name for _, each in budgets for name in each.effects):
        rows.append(
            (" or ".join(found.group_of(name)), *_cells(budgets, lambda b, n=name: _effect(b, n)))
        )
    rows.append(("unexplained", *_cells(budgets, _remainder)))
    rows.append(("chance (noise floor)", *_cells(budgets, lambda b: (min(b.floor, b.before), ""))))
    return rows


def _cells(
    budgets: Sequence[tuple[str, ChannelBudget]],
    of: Callable[[ChannelBudget], tuple[float, str]],
) -> list[str]:
    """Size and share of one line, channel by channel."""
    cells: list[str] = []
    for channel, budget in budgets:
        size, share = of(budget)
        cells += [f"{size * SHOWN[channel][1]:.3f}", share]
    return cells


def _effect(budget: ChannelBudget, name: str) -> tuple[float, str]:
    each = budget.effects[name]
    if not budget.is_reducible:
        return each.size, "-"
    low, high = each.interval
    return each.size, f"{_percent(each.share)} ({_percent(low)} to {_percent(high)})"


def _remainder(budget: ChannelBudget) -> tuple[float, str]:
    size = budget.remainder * max(budget.before - budget.floor, 0)
    return size, _percent(budget.remainder) if budget.is_reducible else "-"


def _percent(share: float) -> str:
    return f"{round(100 * share) + 0:d}%"  # no minus before zero


def budget_table(found: Diagnosis) -> WholeWordTable:
    """Table of the budget."""
    table = WholeWordTable()
    for number, name in enumerate(budget_columns(found)):
        table.add_column(escape(name), justify="right" if number else "left")
    for row in budget_rows(found):
        table.add_row(*map(escape, row))
    return table


def effect_sentences(found: Diagnosis) -> list[str]:
    """One sentence for each effect of the verdict: how sure, its numbers, and a remedy."""
    sentences = []
    for name in found.verdict:
        numbers = found.parameters.get(name)
        if numbers is None:
            continue
        values = in_user_terms(name, numbers, found.dataset.runs[0].setup)
        sure = percent(found.weights.get(name, 0.0))
        sentences.append(
            f"{name}: {values} (takes part with a probability of {sure}). To do: {remedy(name)}."
        )
    return sentences


def remainder_sentence(found: Diagnosis, settings: BudgetTextSettings = DEFAULT_BUDGET_TEXT) -> str:
    """The part of the gap that the verdict's effects leave; empty where it is none or unlikely."""
    weight = found.weights.get(UNKNOWN, 0.0)
    if found.verdict == (UNKNOWN,) or weight < settings.min_remainder_weight:
        return ""
    parts = ", ".join(
        f"{budget.remainder:.0%} of the gap in {channel}"
        for channel, budget in found.budget.items()
        if budget.is_reducible
    )
    return (
        f"Something more acts that no listed effect explains (weight {percent(weight)}): "
        f"{parts} is left unexplained."
    )


def one_zeta_sentence(found: Diagnosis, settings: BudgetTextSettings = DEFAULT_BUDGET_TEXT) -> str:
    """The gap with one zeta for the bed, before and after, where it differs from that above."""
    parts = []
    for channel, gap in found.one_zeta_gap.items():
        own, (unit, scale) = found.gap[channel], SHOWN[channel]
        if gap.before - gap.floor > settings.min_hidden_share * max(own.before, own.floor):
            parts.append(
                f"{channel} {gap.before * scale:.2f} → {gap.after * scale:.2f} {unit} "
                f"(chance {gap.floor * scale:.2f})"
            )
    if not parts:
        return ""
    return (
        "With one zeta for the bed, each condition at the zeta that the others predict, the gap "
        f"is {', '.join(parts)}."
    )


def zeta_sentence(found: Diagnosis, settings: BudgetTextSettings = DEFAULT_BUDGET_TEXT) -> str:
    """Effects that another zeta would make up for, in one sentence; empty where there are none."""
    most = settings.made_up_share
    free = isinstance(found.bed, FreeBed)
    hidden = [name for name, each in found.zeta_shares.items() if each.own > most]
    shares = found.zeta_shares.items()
    lost = hidden if free else [name for name, each in shares if each.bed > most]
    sentences = []
    if lost:
        sentences.append(f"These runs cannot show {', '.join(lost)}: another zeta makes up for it.")
    shown = [name for name in hidden if name not in lost]
    if shown:
        sentences.append(
            f"Only that all runs have about one zeta (scatter {found.bed.scatter:.1%}) lets these "
            f"runs show {', '.join(shown)}; for a bed that nobody prepared, use --bed free."
        )
    return " ".join(sentences)
