"""Text that is safe to print."""


def printable(text: str) -> str:
    """A file's words without what would steer a terminal or break a line."""
    return "".join(each if each.isprintable() else "\ufffd" for each in text)
