"""Groups of subcommands that list them by their whole first sentence."""

from typing import Any

from typer.core import TyperGroup

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
