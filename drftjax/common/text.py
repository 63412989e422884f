"""Control characters in text from files."""


def replace_unprintable(text: str) -> str:
    """Replace control characters, which could steer a terminal or break a line, by U+FFFD."""
    return "".join(each if each.isprintable() else "\ufffd" for each in text)
