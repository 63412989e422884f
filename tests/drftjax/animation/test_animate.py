"""Films of a run: motion, forces on the plates, the sand that is drawn, and the files."""

import dataclasses
import math
import sys
from pathlib import Path

import jax
import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from drftjax.animation import film_file
from drftjax.animation.film import WheelFilm
from drftjax.animation.wheel_motion import (
    FilmSettings,
    plate_forces,
    turned,
    wheel_motion,
    wheel_outline,
)
from drftjax.commands.animate import app
from drftjax.common.errors import InputError
from drftjax.common.packages import data_file
from drftjax.runlog.hdf5.api import read_run, write_run
from drftjax.runlog.record import Measured, RecordedCommand, RunLog
from tests.helpers.run_logs import example_run

# The example run is of sand that its log does not know: it believes a zeta 8 % too strong.
CARRIED = 0.12
EXACT = 1e-9  # algebra in double precision
ROLLED = 1e-3  # of a triangle of speed that is interpolated at the frames
SETTINGS = FilmSettings()


def rolling(**changed) -> RunLog:
    """A wheel that speeds up to 1 rad/s in 2 s and on for 2 s, and rolls without slip."""
    time = np.linspace(0, 4, 401)
    turned = np.where(time < 2, time**2 / 4, time - 1)
    run = dataclasses.replace(
        example_run(),
        command=RecordedCommand(np.array([0.0, 2, 4]), np.array([0.0, 1, 1])),
        measured=Measured(time, x=0.15 * turned, z=-0.02 - 0.001 * time),
        online=None,
        events=None,
    )
    return dataclasses.replace(run, **changed)


# Motion -------------------------------------------------------------------------------------------


def test_angle_and_speed_are_those_of_the_commanded_turning():
    motion = wheel_motion(rolling(), 1.0)
    assert np.diff(motion.time) == pytest.approx(SETTINGS.frame_time)
    assert motion.angle[-1] == pytest.approx(motion.time[-1] - 1, abs=EXACT)
    assert motion.omega[-1] == pytest.approx(1.0)
    later = motion.time > 2.2
    assert motion.vx[later] == pytest.approx(0.15, rel=ROLLED)
    assert motion.vz == pytest.approx(-0.001, rel=ROLLED)
    assert motion.zeta == pytest.approx(0.7823)


def test_a_driven_carriage_goes_as_it_was_commanded_where_x_was_not_measured():
    command = RecordedCommand(np.array([0.0, 2, 4]), np.array([0.0, 1, 1]), np.array([0, 0.1, 0.1]))
    measured = dataclasses.replace(rolling().measured, x=None)
    motion = wheel_motion(rolling(command=command, measured=measured), 1.0)
    assert motion.x[-1] == pytest.approx(0.1 + 0.1 * (motion.time[-1] - 2), abs=ROLLED)
    with pytest.raises(InputError, match="x was not measured"):
        wheel_motion(rolling(measured=measured), 1.0)


def test_a_film_too_long_says_which_speed_makes_it_short_enough():
    few = FilmSettings(max_frames=11)
    with pytest.raises(InputError, match=r"51 frames .* at most 11: give --speed 5 or more"):
        wheel_motion(rolling(), 1.0, few)
    assert len(wheel_motion(rolling(), 5.0, few).time) == 11


def test_outline_has_the_area_of_rim_and_grousers():
    setup = rolling().setup
    x, z = wheel_outline(setup).T
    area = abs(x @ np.roll(z, 1) - z @ np.roll(x, 1)) / 2
    radius, height, thickness, count = 0.15, 0.018, 0.009, 12
    # Straight pieces cut 1 / 600 off the rim, and a grouser stands on a chord.
    assert area == pytest.approx(math.pi * radius**2 + count * height * thickness, rel=0.004)
    assert np.hypot(x, z).max() == pytest.approx(math.hypot(radius + height, thickness / 2))
    # Forward turns the lowest point backward.
    assert turned(np.array([[0.0, -1.0]]), 0.1)[0] == pytest.approx(
        [-math.sin(0.1), -math.cos(0.1)]
    )


# Forces -------------------------------------------------------------------------------------------


def test_plates_carry_the_weight_of_a_wheel_that_rolls_steadily():
    run = read_run(data_file("runs/medium.h5"))
    with jax.enable_x64(True):
        motion = wheel_motion(run, 1.0)
        forces = plate_forces(run, motion)
    steady = (motion.time > 4) & (motion.time < 10)
    mass, gravity = run.setup.require("mass_z", "gravity")
    carried = forces.force[steady][..., 1].sum(axis=1).mean()
    assert carried == pytest.approx(mass * gravity, rel=CARRIED)
    # What is above the sand carries nothing.
    middle = forces.ends.mean(axis=2)[..., 1] + motion.z[:, None] + 0.15
    assert not forces.force[middle > 0.01].any()


# Pictures -----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def film() -> WheelFilm:
    run = rolling()
    return WheelFilm(run, wheel_motion(run, 8.0), None)


def test_the_sand_is_flat_ahead_and_a_rut_as_deep_as_the_wheel_behind(film):
    last = len(film) - 1
    film.show(last)
    x, z = film._sand.get_xy().T
    ground = slice(1, -2)
    axle = film._motion.x[last]
    assert z[ground].max() == 0
    assert z[ground][x[ground] > axle + 0.1] == pytest.approx(0)
    behind = (x[ground] < axle) & (x[ground] > film._motion.x[0])
    expected = np.interp(x[ground][behind], film._motion.x, film._motion.z)
    assert z[ground][behind] == pytest.approx(expected, abs=EXACT)


def test_wheel_stands_with_its_rim_at_the_recorded_depth(film):
    film.show(3)
    corners = film._wheel.get_xy()
    centre = (film._motion.x[3], film._motion.z[3] + 0.15)
    assert np.hypot(*(corners - centre).T).min() == pytest.approx(0.15, rel=EXACT)


# Files --------------------------------------------------------------------------------------------

FRAMES = [np.full((20, 30, 3), shade, np.uint8) for shade in (0, 120, 240)]


def test_gif_has_the_frames_and_their_time(tmp_path):
    film_file.write_film(FRAMES, 0.08, tmp_path / "a.gif")
    with Image.open(tmp_path / "a.gif") as film:
        assert (film.n_frames, film.size) == (3, (30, 20))
        for number, frame in enumerate(FRAMES):
            film.seek(number)
            assert film.info["duration"] == 80
            assert np.asarray(film.convert("RGB")) == pytest.approx(frame)


def program(folder: Path, text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A program of the name ffmpeg, first in PATH."""
    ffmpeg = folder / "ffmpeg"
    ffmpeg.write_text(f"#!/bin/sh\n{text}\n")
    ffmpeg.chmod(0o755)
    monkeypatch.setenv("PATH", f"{folder}:/usr/bin:/bin")


def test_ffmpeg_is_given_every_pixel_of_every_frame(tmp_path, monkeypatch):
    program(
        tmp_path, 'echo "$@" > "${0%/*}/told"; for last; do :; done; cat > "$last"', monkeypatch
    )
    film_file.write_film(FRAMES, 0.08, tmp_path / "a.mp4")
    assert (tmp_path / "a.mp4").read_bytes() == b"".join(each.tobytes() for each in FRAMES)
    assert "-s 30x20 -r 12.5" in (tmp_path / "told").read_text()


def test_ffmpeg_that_fails_leaves_one_sentence_and_no_file(tmp_path, monkeypatch):
    program(tmp_path, "echo noise >&2; exit 1", monkeypatch)
    with pytest.raises(InputError, match=r"a\.mp4 cannot be written: ffmpeg refused"):
        film_file.write_film(FRAMES, 0.08, tmp_path / "a.mp4")
    assert not (tmp_path / "a.mp4").exists()


# The command --------------------------------------------------------------------------------------


def test_command_writes_a_film_without_forces_where_the_set_up_lacks_a_mass(tmp_path):
    log = tmp_path / "run.h5"
    write_run(log, rolling(setup=dataclasses.replace(rolling().setup, mass_z=None)))
    film = tmp_path / "new" / "wheel.gif"
    answer = CliRunner().invoke(app, [str(log), "-o", str(film), "--speed", "20"])
    assert answer.exit_code == 0, answer.output
    assert "the plates have no colour: the run's /setup lacks mass_z" in answer.output
    assert "film of 3 frames written to" in answer.output
    with Image.open(film) as made:
        assert (made.n_frames, made.width) == (3, 560)


def test_what_cannot_be_filmed_is_refused_in_one_sentence(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    log = tmp_path / "run.h5"
    write_run(log, rolling(setup=dataclasses.replace(rolling().setup, wheel_radius=None)))
    for arguments, sentence in (
        (["-o", "a.avi"], "a.avi: a film's name must end in .gif, .mp4"),
        (["-o", "a.mp4"], "a.mp4: MP4 needs the program ffmpeg, which is neither in PATH nor"),
        (["-o", "a.gif", "--speed", "0"], "--speed is 0, must be 0.01 to 1000"),
        (["-o", f"{tmp_path}/a.gif"], f"{log}: the set-up does not give wheel_radius"),
    ):
        refused = CliRunner().invoke(app, [str(log), *arguments])
        assert isinstance(refused.exception, InputError)
        assert str(refused.exception).startswith(sentence)
