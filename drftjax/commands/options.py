"""Options, groups of commands and result folders of commands, and names that a shell completes.

A key press must not wait for JAX, which the modules of effects and tuners import. Their names are
therefore read from the sources; those that other packages add, from their entry points.
"""

import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from functools import wraps
from importlib.metadata import entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer
from typer.core import TyperGroup

from drftjax.commands.printing import say
from drftjax.common.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PlotFile = Annotated[
    Path | None, typer.Option("--plot", help="Write a figure here (PNG, PDF, SVG).")
]
"""Option of a command that can draw its result; `require_picture` checks it."""


def require_picture(picture: Path | None, inputs: Iterable[Path]) -> None:
    """Refuse a figure that cannot be written, before the computation whose result it shows.

    Args:
        picture: File that --plot names; None for none.
        inputs: Files that are read, which it may not replace.

    Raises:
        InputError: names the file, and what must hold.
    """
    if picture is None:
        return
    from drftjax.common.figures import check_figure_name
    from drftjax.common.output_files import require_places

    check_figure_name(picture)
    require_places([picture], inputs)


def draw_picture(figure: "Figure", picture: Path) -> None:
    """Write the figure of --plot, and say where it is.

    Raises:
        InputError: where it cannot be written.
    """
    from drftjax.common.figures import save_figure

    save_figure(figure, picture)
    say(f"figure written to {picture}")


def refuse_options(context: typer.Context, names: tuple[str, ...], why: str) -> None:
    """Refuse options that would be ignored.

    Args:
        context: Context of the command.
        names: Names of its parameters that have no effect here.
        why: Condition under which they have, or an alternative.

    Raises:
        InputError: names those that were given.
    """
    given = [each for each in names if is_on_command_line(context, each)]
    if given:
        options = ", ".join(f"--{each.replace('_', '-')}" for each in given)
        raise InputError(f"{options} would be ignored: {why}")


def is_on_command_line(context: typer.Context, name: str) -> bool:
    """True where a parameter was given on the command line."""
    source = context.get_parameter_source(name)
    return source is not None and source.name == "COMMANDLINE"


_WORDS = "drftjax.words"  # entry of a context's notes: the words that its command is given


# Typer's reason for a value that cannot be; it does not name the value.
_OF_TYPER = re.compile(r"Input should be ([^,]*)")


WHOLE = 1000
"""Characters of a summary: more than any has, as the list wraps it."""


class CommandGroup(TyperGroup):
    """Group that lists whole summaries; its refusals name all that is missing, and what was given.

    For `typer.Typer(cls=...)`.
    """

    def resolve_command(self, ctx: Any, args: list[str]) -> tuple[str | None, Any, list[str]]:
        """Find a command as every group does, and keep the words that it is given."""
        name, command, words = super().resolve_command(ctx, args)
        ctx.meta[_WORDS] = list(words)
        return name, command, words

    def invoke(self, ctx: Any) -> Any:
        """Run a command, and complete the refusal of what it was given."""
        try:
            return super().invoke(ctx)
        except typer.BadParameter as error:
            _complete(error)
            raise

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write every shown command with its first sentence."""
        commands = [(name, self.get_command(ctx, name)) for name in self.list_commands(ctx)]
        rows = [
            (name, command.get_short_help_str(WHOLE))
            for name, command in commands
            if command is not None and not command.hidden
        ]
        if rows:
            with formatter.section("Commands"):
                formatter.write_dl(rows)


def _complete(error: Any) -> None:
    """Have a refusal name every missing parameter, or the value that was given."""
    context, refused = error.ctx, error.param
    if context is None or refused is None:
        return
    words = list(context.meta.get(_WORDS, ()))
    given, *_ = context.command.make_parser(context).parse_args(words)
    lacking = [
        each
        for each in context.command.get_params(context)
        if getattr(each, "required", False) and given.get(each.name) in (None, (), [])
    ]
    if refused in lacking:
        error.param_type, error.param_hint = _listed(lacking), ""
    elif (match := _OF_TYPER.match(error.message)) is not None:
        error.message = f"{given.get(refused.name)!r} must be {match[1]}"
    else:
        error.message = error.message.removeprefix("Value error, ")


def _listed(parameters: list[Any]) -> str:
    """Parameters in words: "argument 'FILE' and option '--output' / '-o'"."""
    named = [f"{each.param_type_name} {each.get_error_hint()}" for each in parameters]
    *first, last = named
    return f"{', '.join(first)} and {last}" if first else last


def remove_empty_folders(command: Callable[..., None]) -> Callable[..., None]:
    """Decorate a command to remove result folders that it created and left empty."""

    @wraps(command)
    def tidy(*given: object, **named: object) -> None:
        places = [each for each in (*given, *named.values()) if isinstance(each, Path)]
        new = {folder for each in places for folder in (each, *each.parents) if not folder.exists()}
        try:
            command(*given, **named)
        finally:
            for folder in sorted(new, reverse=True):  # those inside others first
                with suppress(OSError):
                    folder.rmdir()

    return tidy


USUAL_OMEGA_MAX = 2.0
"""Largest wheel speed that commands assume for a rig [rad/s]."""


# Completion ---------------------------------------------------------------------------------------

_PACKAGE: Final = Path(__file__).resolve().parents[1]
_EFFECT: Final = re.compile(r'EffectInfo\(\s*"(\w+)"')
CHANNEL_NAMES: Final = ("x", "z", "fx", "fz", "torque")
_TUNER: Final = re.compile(r'^    "(\w+)": \w+Tuner,$', re.MULTILINE)


def complete_effect(incomplete: str) -> list[str]:
    """Names of effects that begin so."""
    return _beginning(incomplete, effect_names())


def complete_effects(incomplete: str) -> list[str]:
    """Lists of effects with commas between, the last name completed."""
    earlier, comma, last = incomplete.rpartition(",")
    return [f"{earlier}{comma}{each}" for each in _beginning(last, effect_names())]


def complete_tuner(incomplete: str) -> list[str]:
    """Names of tuners that begin so."""
    return _beginning(incomplete, tuner_names())


def complete_channel(incomplete: str) -> list[str]:
    """Names of the channels of a run that begin so."""
    return _beginning(incomplete, CHANNEL_NAMES)


def effect_names() -> Iterator[str]:
    """Names of all effects, by their modules and by entry points."""
    for module in sorted((_PACKAGE / "effects").glob("*.py")):
        yield from _EFFECT.findall(module.read_text(encoding="utf-8"))
    yield from (each.name for each in entry_points(group="drft.effects"))


def tuner_names() -> Iterator[str]:
    """Names of all tuners, by their registry and by entry points."""
    yield from _TUNER.findall((_PACKAGE / "tuning" / "registry.py").read_text(encoding="utf-8"))
    yield from (each.name for each in entry_points(group="drft.tuners"))


def _beginning(start: str, names: Iterable[str]) -> list[str]:
    return [each for each in names if each.startswith(start)]
