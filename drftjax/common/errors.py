"""The exceptions that reach a user."""


class InputError(ValueError):
    """Something given from outside (a file, a number, a name, a device) cannot be used.

    The message is one sentence that says what was given, what must hold and where. The
    command line prints it without a traceback and leaves with exit code 2.
    """


class RunError(InputError):
    """One run of several cannot be used; the others can go on without it.

    Args:
        run: Its name, with which the message begins.
        why: What is wrong with it.
    """

    def __init__(self, run: str, why: str) -> None:
        super().__init__(run, why)  # as it is made anew where a process sends it to another
        self.run, self.why = run, why

    def __str__(self) -> str:
        return ": ".join(self.args)
