"""Frames of a film: the wheel in the sand, and its sinkage over time."""

from collections.abc import Iterator

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from drftjax.animation.wheel_motion import PlateForces, Reals, WheelMotion, turned, wheel_outline
from drftjax.common.figures import (
    COMMANDED,
    REAL,
    SIMULATED,
    STYLE,
    boxes_for_letters,
    label_channel,
    project_style,
    title_above,
)
from drftjax.runlog.record import RunLog

HEIGHT = 4.2
"""Of the picture [inches]."""

SAND, WHEEL = "#E8D9B5", "#D9D9D9"

LOADED = 0.01
"""Share of the largest force from which a plate is drawn [-]: others touch no sand."""

MARGIN = 1.35
"""Half the width of the view, in wheel radii with grousers [-]."""


class WheelFilm:
    """A figure that shows one frame at a time.

    Attributes:
        figure: The figure, of the frame shown last.
    """

    def __init__(self, run: RunLog, motion: WheelMotion, forces: PlateForces | None):
        """Draw what stays.

        Args:
            run: The run.
            motion: The wheel's place in each frame.
            forces: On its plates; None to draw them without.

        Raises:
            InputError: where the wheel's radius is not known.
        """
        self._motion, self._forces = motion, forces
        self._outline = wheel_outline(run.setup)
        (self._radius,) = run.setup.require("wheel_radius")
        self._reach = MARGIN * float(np.abs(self._outline).max())
        strongest = 0.0 if forces is None else float(_sizes(forces.force).max())
        self._scale = ScalarMappable(Normalize(0.0, strongest or 1.0), "viridis")
        self.figure = _panels(run, None if forces is None else self._scale)
        self._view, course = self.figure.axes[:2]
        self._sand = Polygon([(0, 0)], color=SAND, zorder=0)
        self._wheel = Polygon([(0, 0)], fc=WHEEL, ec="0.3", lw=0.8)
        self._plates = LineCollection([], linewidths=3.5, zorder=4)
        for each in (self._sand, self._wheel):
            self._view.add_patch(each)
        self._view.add_collection(self._plates)
        (self._mark,) = self._view.plot([], [], color="0.3", lw=1.2)
        self._view.axhline(0, color=COMMANDED.colour, lw=1, ls=":", zorder=1)
        self._view.set_aspect("equal")
        self._now = course.axvline(motion.time[0], color=COMMANDED.colour, lw=1)
        self.show(0)
        with boxes_for_letters():
            self.figure.draw_without_rendering()
        # Laid out once: labels must not jump from frame to frame.
        self.figure.set_layout_engine("none")

    def __len__(self) -> int:
        return len(self._motion.time)

    def show(self, frame: int) -> None:
        """Draw a frame."""
        motion = self._motion
        x, z = motion.x[frame], motion.z[frame]
        axle = np.array([x, z + self._radius])
        angle = float(motion.angle[frame])
        self._sand.set_xy(self._ground(frame))
        self._wheel.set_xy(axle + turned(self._outline, angle))
        self._mark.set_data(*(axle + turned(np.array([[0, 0], [0, self._radius]]), angle)).T)
        if self._forces is not None:
            force = _sizes(self._forces.force[frame])
            loaded = force > LOADED * self._scale.norm.vmax  # pyright: ignore
            self._plates.set_segments([*(axle + self._forces.ends[frame][loaded])])
            self._plates.set_color(self._scale.to_rgba(force[loaded]))  # pyright: ignore
        self._view.set_xlim(x - self._reach, x + self._reach)
        self._view.set_ylim(*self._heights)
        self._now.set_xdata([motion.time[frame]] * 2)
        self._view.set_title(f"{motion.time[frame]:.1f} s")

    @property
    def _heights(self) -> tuple[float, float]:
        """Lowest and highest height of the view [m]."""
        middle = self._radius + float(np.median(self._motion.z))
        return middle - self._reach, middle + self._reach

    def _ground(self, frame: int) -> Reals:
        """Outline of the sand: flat ahead, pressed down under the rim, a rut behind.

        The rut is the path of the rim's lowest point; no sensor has seen it.
        """
        motion, radius = self._motion, self._radius
        x, first = motion.x[frame], motion.x[0]
        at = np.linspace(x - self._reach, x + self._reach, 241)
        travelled = np.maximum.accumulate(motion.x[: frame + 1])
        rut = np.interp(at, travelled, motion.z[: frame + 1])
        aside = np.maximum(at - travelled[-1], first - at)
        # Beside the rut, the rim that stands at its nearer end.
        rim = rut + radius - np.sqrt(np.maximum(radius**2 - np.maximum(aside, 0) ** 2, 0))
        surface = np.minimum(rim, 0.0)
        low = self._heights[0]
        return np.array([(at[0], low), *zip(at, surface, strict=True), (at[-1], low)])

    def frames(self, dots_per_inch: int) -> Iterator[np.ndarray]:
        """Pictures of all frames, RGB bytes of shape (height, width, 3)."""
        from matplotlib.backends.backend_agg import FigureCanvasAgg

        self.figure.set_dpi(dots_per_inch)
        canvas = FigureCanvasAgg(self.figure)
        for frame in range(len(self)):
            self.show(frame)
            with boxes_for_letters():
                canvas.draw()
            yield np.asarray(canvas.buffer_rgba())[..., :3]


def _sizes(forces: Reals) -> Reals:
    """Sizes of vectors along the last axis."""
    return np.hypot(forces[..., 0], forces[..., 1])


@project_style
def _panels(run: RunLog, scale: ScalarMappable | None) -> Figure:
    """The view of the wheel, and the sinkage over time."""
    figure = Figure(figsize=(STYLE.width, HEIGHT), layout="constrained")
    view, course = figure.subplots(1, 2, width_ratios=(1.35, 1))
    view.set_xlabel("travel [m]")
    view.set_ylabel("height [m]")
    view.set_title(" ")
    view.grid(visible=False)
    factor, online, z = label_channel(course, "z"), run.online, run.measured.z
    assert z is not None
    course.plot(run.measured.time, factor * z, **REAL.line, label="recorded")
    if online is not None:
        course.plot(online.time, factor * online.z_sim, **SIMULATED.line, label="simulated online")
        course.legend()
    course.set_xlabel("time [s]")
    if scale is not None:
        bar = figure.colorbar(scale, ax=view, location="bottom", shrink=0.8)
        bar.set_label("force on a plate, by the model [N]")
    title_above(figure, run.title)
    return figure
