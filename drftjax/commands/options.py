"""Options, groups of commands and result folders that commands share."""

from collections.abc import Callable
from contextlib import suppress
from functools import wraps
from pathlib import Path
from typing import Any

import typer
from typer.core import TyperGroup

from drftjax.common.errors import InputError


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


WHOLE = 1000
"""Characters of a summary: more than any has, as the list wraps it."""


class CommandGroup(TyperGroup):
    """Group whose list of commands shows whole summaries; for `typer.Typer(cls=...)`."""

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
