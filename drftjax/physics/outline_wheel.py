"""A wheel of any shape: a closed outline given as points."""

import csv
import math
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from drftjax.common.arrays import Real, as_real, require_between
from drftjax.common.errors import InputError, read_failure
from drftjax.physics.wheel import (
    DEFAULT_PLATE_SIZE,
    LARGEST_RADIUS,
    SMALLEST_RADIUS,
    UNIT_HINT,
    AbstractCut,
    AbstractWheel,
    Plates,
    TurningCut,
    fill_vectors,
    plate_count,
)

# Points closer than this are the same point [m]: a closing point repeated, not an edge.
SAME_POINT = 1e-9


class OutlineWheel(AbstractWheel):
    """A wheel whose cross-section is a closed polygon.

    Attributes:
        points: Corners (x, z) relative to the axle, counter-clockwise with x to the right and z
            up, the last joined to the first [m], shape (points, 2).
        radius: Rim radius: the sinkage is zero where a circle of it touches the sand [m].
        width: Wheel width [m].
        edge_plates: Number of plates on each edge.

    Raises:
        InputError: for an outline that is clockwise, crosses itself, does not hold the axle, has
            fewer than three corners or is not of a test-bed wheel's size in metres.
    """

    points: Float[Array, "points 2"]
    radius: Float[Array, ""]
    width: Float[Array, ""]
    edge_plates: tuple[int, ...] = eqx.field(static=True)

    def __init__(
        self,
        points: ArrayLike,
        radius: Real,
        width: Real = 0.120,
        *,
        plate_size: float = DEFAULT_PLATE_SIZE,
    ):
        corners = np.asarray(points, dtype=float)
        check_outline(corners)
        reach = float(np.hypot(*corners.T).max())
        require_between("wheel radius", radius, SMALLEST_RADIUS, LARGEST_RADIUS, UNIT_HINT)
        require_between(
            "wheel radius",
            radius,
            0.3 * reach,
            1.001 * reach,
            f", the reach of its outline being {reach:g} m",
        )
        require_between("wheel width", width, SMALLEST_RADIUS, LARGEST_RADIUS, UNIT_HINT)
        require_between("plate size", plate_size, 1e-5, float(radius), UNIT_HINT)
        lengths = np.hypot(*(np.roll(corners, -1, axis=0) - corners).T)
        self.points = as_real(points)
        self.radius = as_real(radius)
        self.width = as_real(width)
        # An edge that rounding took for no length still is one.
        self.edge_plates = tuple(max(1, plate_count(length, plate_size)) for length in lengths)

    @classmethod
    def from_csv(
        cls,
        path: str | Path,
        radius: Real,
        width: Real = 0.120,
        *,
        plate_size: float = DEFAULT_PLATE_SIZE,
    ) -> "OutlineWheel":
        """A wheel from a file of two columns, x and z in metres; a heading line may stand first.

        A last point that repeats the first closes the outline and is dropped.
        """
        return cls(read_outline(path), radius, width, plate_size=plate_size)

    def cut(self) -> AbstractCut:
        count = jnp.asarray(self.edge_plates)
        edge = np.repeat(np.arange(len(self.edge_plates)), self.edge_plates)
        place = np.concatenate([(np.arange(n) + 0.5) / n for n in self.edge_plates])
        start = self.points[edge]
        along = jnp.roll(self.points, -1, axis=0)[edge] - start
        length = jnp.hypot(along[:, 0], along[:, 1])
        centre = start + along * jnp.asarray(place, self.points.dtype)[:, None]
        outline = Plates(
            centre[:, 0],
            centre[:, 1],
            along[:, 1] / length,
            -along[:, 0] / length,
            self.width * length / count[edge].astype(self.points.dtype),
        )
        return TurningCut(self.radius, self.radius, fill_vectors(outline), 2 * math.pi)


def read_outline(path: str | Path) -> np.ndarray:
    """Corners (x, z) [m] of a CSV file, shape (points, 2); the closing point dropped.

    Raises:
        InputError: names the file, the line and what must hold.
    """
    if Path(path).is_char_device():  # some never end
        raise InputError(f"{path}: is a device; must be a CSV file, two numbers a line")
    try:
        # Some editors put a byte-order mark first.
        with Path(path).open(newline="", encoding="utf-8-sig") as file:
            rows = [row for row in csv.reader(file) if any(cell.strip() for cell in row)]
    except OSError as problem:
        raise InputError(f"{path}: {read_failure(Path(path), problem)}") from None
    except (UnicodeDecodeError, csv.Error):
        raise InputError(f"{path}: is not an outline; must be CSV, two numbers a line") from None
    except ValueError:
        raise InputError(f"{str(path)!r} cannot be the name of a file") from None
    corners: list[tuple[float, float]] = []
    for number, row in enumerate(rows, start=1):
        try:
            x, z = (float(cell) for cell in row)
        except ValueError:
            if number == 1:
                continue
            raise InputError(
                f"{path}, line {number}: {','.join(row)!r} must be two numbers, x and z in metres"
            ) from None
        corners.append((x, z))
    if len(corners) < 2 or np.hypot(*np.subtract(corners[0], corners[-1])) > SAME_POINT:
        raise InputError(
            f"{path}: the outline is open; its last point must repeat the first to close it"
        )
    try:
        check_outline(np.array(corners[:-1]))
    except InputError as problem:
        raise InputError(f"{path}: {problem}") from None
    return np.array(corners[:-1])


def check_outline(corners: np.ndarray) -> None:
    """Refuse corners (x, z), shape (points, 2), that are no wheel's outline.

    Raises:
        InputError: says which rule is broken, and where.
    """
    if corners.ndim != 2 or corners.shape[1] != 2 or len(corners) < 3:
        raise InputError(
            f"an outline needs three or more points (x, z), was given shape {corners.shape}"
        )
    if not np.all(np.isfinite(corners)):
        bad = int(np.argmin(np.isfinite(corners).all(axis=1)))
        raise InputError(f"point {bad + 1} of the outline is {corners[bad].tolist()}, not finite")
    edges = np.roll(corners, -1, axis=0) - corners
    lengths = np.hypot(*edges.T)
    if lengths.min() <= SAME_POINT:
        bad = int(lengths.argmin())
        raise InputError(
            f"points {bad + 1} and {(bad + 1) % len(corners) + 1} of the outline are the same"
        )
    reach = float(np.hypot(*corners.T).max())
    if not SMALLEST_RADIUS <= reach <= LARGEST_RADIUS:
        raise InputError(
            f"the outline reaches {reach:g} m from the axle, must lie between "
            f"{SMALLEST_RADIUS:g} and {LARGEST_RADIUS:g} m{UNIT_HINT}"
        )
    crossing = _first_crossing(corners, edges)
    if crossing is not None:
        first, second = crossing
        raise InputError(f"the outline crosses itself at its edges {first + 1} and {second + 1}")
    x, z = corners.T
    area = 0.5 * np.sum(x * np.roll(z, -1) - np.roll(x, -1) * z)
    if area < 0:
        raise InputError(
            "the outline runs clockwise; give its points counter-clockwise, x to the right and z up"
        )
    if not _holds_origin(corners):
        raise InputError(
            "the axle (0, 0) lies outside the outline; points are relative to the axle"
        )


def _first_crossing(corners: np.ndarray, edges: np.ndarray) -> tuple[int, int] | None:
    """The first pair of edges, not neighbours, that meet."""

    def side(a: np.ndarray, along: np.ndarray, p: np.ndarray) -> np.ndarray:
        return along[..., 0] * (p[..., 1] - a[..., 1]) - along[..., 1] * (p[..., 0] - a[..., 0])

    ends = np.roll(corners, -1, axis=0)
    for first in range(len(corners) - 2):
        others = np.arange(first + 2, len(corners) - (first == 0))
        if len(others) == 0:
            continue
        a, along = corners[first], edges[first]
        splits_here = side(a, along, corners[others]) * side(a, along, ends[others]) <= 0
        there = side(corners[others], edges[others], a) * side(
            corners[others], edges[others], ends[first]
        )
        meets = splits_here & (there <= 0)
        if meets.any():
            return first, int(others[np.argmax(meets)])
    return None


def _holds_origin(corners: np.ndarray) -> bool:
    angle = np.unwrap(np.arctan2(corners[:, 1], corners[:, 0]), period=2 * np.pi)
    closing = np.arctan2(corners[0, 1], corners[0, 0]) - np.arctan2(*corners[-1, ::-1])
    closing = (closing + np.pi) % (2 * np.pi) - np.pi
    return bool(abs(angle[-1] - angle[0] + closing) > np.pi)
