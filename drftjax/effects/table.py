"""The catalogue in print: as a table, as Markdown, and one effect in full."""

from itertools import groupby

from rich.table import Table

from drftjax.effects.catalogue import catalogue, numbers, strengths
from drftjax.effects.entry import entry_of, typical
from drftjax.effects.stage import AbstractEffect

STAGES = ("drive", "wheel", "terrain", "rig", "sensor")


def by_stage() -> list[tuple[str, list[type[AbstractEffect]]]]:
    """The catalogue's classes stage by stage, in the order that they act in a step."""

    def stage(effect: type[AbstractEffect]) -> int:
        return STAGES.index(effect.about.stage) if effect.about.stage in STAGES else len(STAGES)

    ordered = sorted(catalogue().values(), key=stage)
    return [(name, list(each)) for name, each in groupby(ordered, lambda e: e.about.stage)]


def sizes(effect: type[AbstractEffect]) -> str:
    """An effect's numbers with the sizes that a rig may well show."""
    shown = entry_of(typical(effect))
    return ", ".join(
        f"{name} {shown[name]:g}" + ("" if about["unit"] == "-" else f" {about['unit']}")
        for name, about in numbers(effect).items()
    )


def listing() -> Table:
    """All effects, for a terminal."""
    table = Table(box=None, pad_edge=False, header_style="bold")
    for column in ("effect", "formula", "typical numbers", "what happens"):
        table.add_column(column, overflow="fold")
    for stage, effects in by_stage():
        table.add_row(f"\n[bold cyan]{stage}[/]")
        for each in effects:
            about = each.about
            table.add_row(f"  {about.name}", about.formula, sizes(each), about.meaning)
    return table


def markdown() -> str:
    """All effects, for docs/effects.md."""
    lines = [
        "| stage | effect | formula | typical numbers | what happens |",
        "|---|---|---|---|---|",
    ]
    for stage, effects in by_stage():
        for each in effects:
            about = each.about
            formula = about.formula.replace("|", "\\|")
            lines.append(
                f"| {stage} | `{about.name}` | {formula} | {sizes(each)} | {about.meaning} |"
            )
    return "\n".join(lines)


def details(effect: type[AbstractEffect]) -> str:
    """One effect in full, with the lines that put it into a set-up file."""
    about = effect.about
    shown = entry_of(typical(effect))
    lines = [f"{about.name} ({about.stage}): {about.meaning}", "", f"    {about.formula}", ""]
    for name, each in numbers(effect).items():
        if name in strengths(effect):
            size = f"0 where absent, typically {each['typical']:g}"
        else:
            starts = each["starts"]
            size = f"{shown[name]:g} unless said, fits try {min(starts):g} to {max(starts):g}"
        lines.append(f"  {name} [{each['unit']}]  {each['meaning']}; {size}")
    lines += ["", "In a set-up file:", "", "[[effect]]", f'name = "{about.name}"']
    lines += [f"{name} = {shown[name]!r}" for name in numbers(effect)]
    return "\n".join(lines)
