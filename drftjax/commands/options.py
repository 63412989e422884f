"""Shared parts of commands: options, groups of commands, folders of results."""

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
        context: Of the command.
        names: Of its arguments that are of no use here.
        why: What they need, or what there is instead.

    Raises:
        InputError: names the options that were given all the same.
    """
    given = [each for each in names if _on_command_line(context, each)]
    if given:
        options = ", ".join(f"--{each.replace('_', '-')}" for each in given)
        raise InputError(f"{options} would be ignored: {why}")


def _on_command_line(context: typer.Context, name: str) -> bool:
    source = context.get_parameter_source(name)
    return source is not None and source.name == "COMMANDLINE"


# Longer than any sentence: the list wraps them.
WHOLE = 1000


class CommandGroup(TyperGroup):
    """A group whose list of commands cuts no summary short; for `typer.Typer(cls=...)`."""

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
    """The command, but a folder for its results that it made goes again if it stays empty."""

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


USUAL_OMEGA_MAX = 2.0  # [rad/s]
