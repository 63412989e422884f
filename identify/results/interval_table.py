"""Table of each value's errors and intervals, method beside method."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from rich.markup import escape

from drftjax.common.rich_text import WholeWordTable
from drftjax.common.text import replace_unprintable
from identify.results.values import Value

if TYPE_CHECKING:
    from identify.uncertainty.bootstrap import Bootstrap
    from identify.uncertainty.posterior import ParameterPosterior
    from identify.uncertainty.profile_likelihood import ProfileLikelihood

Ends = Mapping[str, tuple[float, float, float]]


def interval_table(
    values: Mapping[str, Value],
    profiles: Sequence["ProfileLikelihood"] = (),
    bootstraps: Sequence["Bootstrap"] = (),
    posterior: "ParameterPosterior | None" = None,
) -> WholeWordTable:
    """Return a table of standard errors and intervals; a dash where a method was not asked for.

    Args:
        values: Fitted values by label.
        profiles: Profile likelihoods.
        bootstraps: Bootstraps; the first, over the noise, is shown.
        posterior: Draws of the posterior.
    """
    ends: dict[str, Ends] = {
        "profile": {each.label: (each.low, each.high, each.level) for each in profiles},
        "bootstrap": {
            name: (low, high, each.level)
            for each in bootstraps[:1]
            for name, low, high in zip(each.labels, each.low, each.high, strict=True)
        },
        "posterior": {}
        if posterior is None
        else {
            name: (low, high, posterior.settings.level)
            for name, low, high in zip(posterior.labels, posterior.low, posterior.high, strict=True)
        },
    }
    levels = {level for method in ends.values() for _, _, level in method.values()}
    alike = len(levels) == 1
    title = f"errors, and intervals of {100 * levels.pop():.0f} %" if alike else "errors, intervals"
    table = WholeWordTable(title=title)
    for heading in ("value", "fit ± standard error", *ends):
        table.add_column(heading, justify="left" if heading == "value" else "right")
    for label, value in values.items():
        unit = "" if value.unit == "-" else f" [{value.unit}]"
        cells = [_cell(method, label, alike) for method in ends.values()]
        table.add_row(escape(replace_unprintable(label + unit)), value.cell(), *cells)
    return table


def _cell(method: Ends, label: str, alike: bool) -> str:
    if label not in method:
        return "-"
    low, high, level = method[label]
    return f"{low:.5g} to {high:.5g}" + f" ({100 * level:.0f} %)" * (not alike)
