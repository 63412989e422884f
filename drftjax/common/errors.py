"""Exceptions that reach the user."""


class InputError(ValueError):
    """An input from outside (a file, a number, a name, a device) cannot be used.

    The message is one sentence: what was given, what must hold and where. The command line
    prints it without a traceback and exits with code 2.
    """


class RunError(InputError):
    """One of several runs cannot be used; the others can.

    Args:
        run: Name of the run, with which the message begins.
        why: Reason why it cannot be used.
    """

    def __init__(self, run: str, why: str) -> None:
        super().__init__(run, why)  # these arguments rebuild it when it is unpickled
        self.run, self.why = run, why

    def __str__(self) -> str:
        return ": ".join(self.args)
