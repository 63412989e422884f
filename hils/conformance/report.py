"""Table of judgements, as text: one line a rule, and the wire's sentence where it is broken."""

import textwrap
from collections import Counter
from collections.abc import Sequence

from hils.conformance.judging import Judgement
from hils.conformance.rule import RuleVerdict

VERDICT_WIDTH, NAME_WIDTH, TEXT_WIDTH = 12, 33, 100


def line(judgement: Judgement) -> str:
    """The judgement on a rule: verdict, name and what was seen."""
    rule, (verdict, seen) = judgement
    text = f"{verdict.value:<{VERDICT_WIDTH}}{rule.name:<{NAME_WIDTH}}{seen}"
    if verdict is not RuleVerdict.BREAKS:
        return text
    quoted = textwrap.wrap(f'"{rule.sentence}"', TEXT_WIDTH - VERDICT_WIDTH)
    return "\n".join([text, *(" " * VERDICT_WIDTH + each for each in quoted)])


def summary(judgements: Sequence[Judgement]) -> str:
    """Count of the verdicts, with the names of broken rules."""
    counts = Counter(each.finding.verdict for each in judgements)
    broken = [each.rule.name for each in judgements if each.finding.verdict is RuleVerdict.BREAKS]
    named = f" ({', '.join(broken)})" if broken else ""
    return (
        f"{len(judgements)} rules: {counts[RuleVerdict.KEEPS]} kept, {len(broken)} broken{named}, "
        f"{counts[RuleVerdict.NOT_JUDGED]} not judged."
    )
