"""A distribution that is not installed, but found: entry points and a module in a folder."""

from pathlib import Path


def write_package(folder: Path, group: str, points: dict[str, str], source: str) -> Path:
    """Write a distribution `extra` with one module of that name.

    Args:
        folder: Where it is to lie.
        group: Entry-point group.
        points: Name and object ("extra:Class") of each entry point.
        source: Text of the module.

    Returns:
        The folder to put on the path.
    """
    home = folder / "site"
    known = home / "extra-1.0.dist-info"
    known.mkdir(parents=True)
    (home / "extra.py").write_text(source)
    (known / "METADATA").write_text("Metadata-Version: 2.1\nName: extra\nVersion: 1.0\n")
    lines = [f"{name} = {place}" for name, place in points.items()]
    (known / "entry_points.txt").write_text("\n".join([f"[{group}]", *lines, ""]))
    return home
