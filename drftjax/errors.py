"""The one exception that reaches a user."""


class InputError(ValueError):
    """Something given from outside (a file, a number, a name, a device) cannot be used.

    The message is one sentence that says what was given, what must hold and where. The
    command line prints it without a traceback and leaves with exit code 2.
    """
