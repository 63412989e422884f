"""The catalogue in print: as a table, as Markdown, and one effect in full."""

from itertools import groupby

from drftjax.common.rich_text import WholeWordTable
from drftjax.effects import correction
from drftjax.effects.base import AbstractEffect
from drftjax.effects.catalogue import catalogue, field_metadata, strengths
from drftjax.effects.serialization import entry_of, typical_effect

STAGES = ("drive", "wheel", "terrain", "rig", "sensor")


BESIDES = (
    "Besides there is `correction`, a curve of your own over a variable; "
    "`drft effects correction` explains it."
)


def by_stage() -> list[tuple[str, list[type[AbstractEffect]]]]:
    """The catalogue's classes stage by stage, in the order that they act in a step."""

    def stage(effect: type[AbstractEffect]) -> int:
        return STAGES.index(effect.about.stage) if effect.about.stage in STAGES else len(STAGES)

    ordered = sorted(catalogue().values(), key=stage)
    return [(name, list(each)) for name, each in groupby(ordered, lambda e: e.about.stage)]


def typical_sizes(effect: type[AbstractEffect]) -> str:
    """An effect's numbers with the sizes that a rig may well show."""
    shown = entry_of(typical_effect(effect))
    return ", ".join(
        f"{name} {shown[name]:g}" + ("" if about["unit"] == "-" else f" {about['unit']}")
        for name, about in field_metadata(effect).items()
    )


def effect_table() -> WholeWordTable:
    """All effects, for a terminal."""
    table = WholeWordTable(box=None, pad_edge=False, header_style="bold")
    table.add_column("effect")
    for column in ("formula", "typical numbers", "what happens"):
        table.add_column(column)
    for stage, effects in by_stage():
        table.add_row(f"\n[bold cyan]{stage}[/]")
        for each in effects:
            about = each.about
            table.add_row(f"  {about.name}", about.formula, typical_sizes(each), about.meaning)
    return table


def effect_markdown() -> str:
    """All effects, for docs/theory/effects.md."""
    lines = [
        "| stage | effect | formula | typical numbers | what happens |",
        "|---|---|---|---|---|",
    ]
    for stage, effects in by_stage():
        for each in effects:
            about = each.about
            formula = about.formula.replace("|", "\\|")
            cells = (stage, f"`{about.name}`", formula, typical_sizes(each), about.meaning)
            lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def effect_details(effect: type[AbstractEffect]) -> str:
    """One effect in full, with the lines that put it into a set-up file."""
    about = effect.about
    shown = entry_of(typical_effect(effect))
    lines = [f"{about.name} ({about.stage}): {about.meaning}", "", f"    {about.formula}", ""]
    if about.form_of:
        lines += [f"Another form of {about.form_of}, by whose name a diagnosis tells it.", ""]
    for name, each in field_metadata(effect).items():
        if name in strengths(effect):
            size = f"0 where absent, typically {each['typical']:g}"
        else:
            starts = each["starts"]
            size = f"{shown[name]:g} unless said, fits try {min(starts):g} to {max(starts):g}"
        lines.append(f"  {name} [{each['unit']}]  {each['meaning']}; {size}")
    lines += ["", "In a set-up file:", "", "[[effect]]", f'name = "{about.name}"']
    lines += [f"{name} = {shown[name]!r}" for name in field_metadata(effect)]
    return "\n".join(lines)


def correction_details() -> str:
    """The correction in full, with lines for a set-up file."""
    lines = ["correction: a curve over a variable, straight between its knots, level beyond", ""]
    for stage, (_, unit, _) in correction.STAGES.items():
        known = ", ".join(correction.correction_variables(stage))
        lines.append(f"  {stage} [{unit}]  may follow {known}")
    units = ", ".join(f"{name} [{unit}]" for name, unit in correction.VARIABLES.items())
    lines += [
        "",
        "zeta is scaled by the exponential of the curve; all else is added.",
        f"Variables: {units}.",
        "",
        "In a set-up file:",
        "",
        "[[effect]]",
        f'name = "{correction.NAME}"',
        'stage = "zeta"',
        'variable = "sinkage"',
        "knots = [0.01, 0.02, 0.04]",
        "values = [0.0, 0.05, 0.1]",
    ]
    return "\n".join(lines)
