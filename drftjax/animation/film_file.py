"""Files of films: GIF by Pillow, MP4 by ffmpeg."""

import io
import shutil
import subprocess
from collections.abc import Iterable
from importlib import import_module
from itertools import chain
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import numpy as np
from PIL import Image

from drftjax.common.errors import InputError
from drftjax.common.output_files import replace_file

KINDS: Final = (".gif", ".mp4")
"""Suffixes of the formats that a film can be written in."""

COLOURS: Final = 64
"""Of a GIF: as many as tell the plates' forces apart; the rest is flat."""


def check_film_name(path: Path) -> None:
    """Refuse a name that is no film's, and an MP4 where there is no ffmpeg.

    Called before the frames are drawn.

    Raises:
        InputError: names the file and what must hold.
    """
    if path.suffix.lower() not in KINDS:
        raise InputError(f"{path}: a film's name must end in {', '.join(KINDS)}")
    if path.suffix.lower() == ".mp4":
        find_ffmpeg(path)


def find_ffmpeg(path: Path) -> str:
    """The program ffmpeg, from PATH or from the package imageio-ffmpeg.

    Args:
        path: File that needs it.

    Raises:
        InputError: there is none.
    """
    found = shutil.which("ffmpeg")
    if found is None:
        try:
            found = import_module("imageio_ffmpeg").get_ffmpeg_exe()
        except (ImportError, RuntimeError):
            raise InputError(
                f"{path}: MP4 needs the program ffmpeg, which is neither in PATH nor in the "
                "package imageio-ffmpeg; install one of them, or name a .gif"
            ) from None
    return found


def write_film(frames: Iterable[np.ndarray], frame_time: float, path: Path) -> None:
    """Write a film atomically.

    Args:
        frames: RGB bytes of shape (height, width, 3), one picture after the other.
        frame_time: Time that each is shown [s].
        path: File, whose name `check_film_name` took.

    Raises:
        InputError: where it cannot be written.
    """
    encode = _as_gif if path.suffix.lower() == ".gif" else _as_mp4
    replace_file(path, encode(frames, frame_time, path))


def _as_gif(frames: Iterable[np.ndarray], frame_time: float, path: Path) -> bytes:
    del path
    # Few colours without dots: flat areas stay flat, and the file small.
    pictures = (
        Image.fromarray(each).quantize(COLOURS, dither=Image.Dither.NONE) for each in frames
    )
    first = next(pictures)
    film = io.BytesIO()
    first.save(
        film,
        format="GIF",
        save_all=True,
        append_images=pictures,
        duration=round(1000 * frame_time),
        loop=0,
    )
    return film.getvalue()


def _as_mp4(frames: Iterable[np.ndarray], frame_time: float, path: Path) -> bytes:
    pictures = iter(frames)
    first = next(pictures)
    height, width, _ = first.shape
    with TemporaryDirectory(prefix="drft-") as folder:
        film = Path(folder) / "film.mp4"
        arguments = [
            *(find_ffmpeg(path), "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24"),
            *("-s", f"{width}x{height}", "-r", f"{1 / frame_time:g}", "-i", "-"),
            # Every player shows this kind of colour; it needs an even number of pixels.
            *("-pix_fmt", "yuv420p", "-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2", str(film)),
        ]
        encoder = subprocess.Popen(
            arguments, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
        )
        assert encoder.stdin is not None
        try:
            with encoder.stdin as pipe:
                for each in chain([first], pictures):
                    pipe.write(np.ascontiguousarray(each).tobytes())
        except BrokenPipeError:
            pass  # its exit code says that it gave up
        finally:
            encoder.wait()
        if encoder.returncode != 0 or not film.exists():
            raise InputError(f"{path} cannot be written: ffmpeg refused to make an MP4 of it")
        return film.read_bytes()
