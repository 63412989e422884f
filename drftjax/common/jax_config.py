"""How a program sets JAX up. The library itself sets nothing."""

import os
from contextlib import suppress
from pathlib import Path
from typing import Literal

from drftjax.common.errors import InputError

# Compiling one simulator takes seconds; anything that compiles faster is not worth a file.
SHORTEST_CACHED_COMPILATION_S = 0.3


WHOLE_LOOPS = "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=1000000000"


def configure_jax(
    precision: Literal["float64", "float32"] = "float64", devices: int | None = None
) -> None:
    """Choose the precision, the number of CPU devices and where compiled programs are kept.

    Called by a subcommand before its first computation. A cache folder that is already chosen,
    as by JAX_COMPILATION_CACHE_DIR, stays.

    Args:
        precision: Default floating-point type of every array.
        devices: Number of devices to split the CPU into, so that as many simulations run side by
            side; None leaves it as it is. Without effect once JAX has computed something.
    """
    if precision not in ("float64", "float32"):
        raise InputError(f"precision must be float64 or float32, not {precision!r}")
    _compile_loops_whole()
    # Programs spread their work over threads themselves; NumPy's own would only wait for these.
    # Read when NumPy is first imported.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    import jax  # here, so that `drft --help` needs no JAX

    jax.config.update("jax_enable_x64", precision == "float64")
    if devices is not None:
        _split_cpu(devices)
    if not jax.config.values["jax_compilation_cache_dir"] and (folder := _cache_folder()):
        jax.config.update("jax_compilation_cache_dir", str(folder))
        jax.config.update(
            "jax_persistent_cache_min_compile_time_secs", SHORTEST_CACHED_COMPILATION_S
        )


def _compile_loops_whole() -> None:
    """Let XLA make one kernel of a run's whole loop, which halves its time: docs/speed.md.

    XLA reads its flags once, when JAX first computes; flags of the user's own stay.
    """
    given = os.environ.get("XLA_FLAGS", "")
    if "xla_backend_extra_options" not in given:
        os.environ["XLA_FLAGS"] = f"{given} {WHOLE_LOOPS}".strip()


def _split_cpu(devices: int) -> None:
    import jax

    if devices < 1:
        raise InputError(f"the number of CPU devices must be at least 1, not {devices}")
    with suppress(RuntimeError):  # JAX has computed already and keeps the devices it has
        jax.config.update("jax_num_cpu_devices", devices)


def _cache_folder() -> Path | None:
    """The user's cache folder for compiled programs, or None where none can be written."""
    try:
        base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
        folder = Path(base) / "drftjax" / "jax"
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError):  # read-only, full, or no home at all
        return None
    return folder if os.access(folder, os.W_OK | os.X_OK) else None
