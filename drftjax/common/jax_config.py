"""JAX settings of a program. The library itself changes none."""

import os
from contextlib import suppress
from pathlib import Path
from typing import Literal

from drftjax.common.errors import InputError

# Of cyclic garbage. Imports and traces make objects by the hundred thousand, and almost all live
# on: to look through them after each 700 takes a sixth of a short command's time.
ALLOCATIONS_BETWEEN_COLLECTIONS = 100_000

XLA_OPTIONS = {
    # A loop is compiled as one kernel, whatever its size.
    "xla_backend_extra_options": "xla_cpu_small_while_loop_byte_threshold=1000000000",
    # Plates side by side in vectors as wide as the processor has; halves of them otherwise.
    "xla_cpu_prefer_vector_width": "512",
    # Half of a compilation's time goes without these. Runs, derivatives and ensembles take as long;
    # programs of forty effects take up to 5 % longer.
    "xla_cpu_use_fusion_emitters": "false",
    "xla_backend_optimization_level": "1",
    "xla_llvm_disable_expensive_passes": "true",
    "xla_cpu_parallel_codegen_split_count": "1",
}
"""Options with which XLA compiles the loop of a run in half the time, to run in a fifth of it."""


def with_options(given: str) -> str:
    """XLA flags with `XLA_OPTIONS` added; those that are given are kept."""
    missing = (f"--{name}={value}" for name, value in XLA_OPTIONS.items() if name not in given)
    return " ".join((given, *missing)).strip()


def configure_jax(
    precision: Literal["float64", "float32"] = "float64", devices: int | None = None
) -> None:
    """Set the precision, the number of CPU devices and the cache of compiled programs.

    Called by a command before its first computation. A cache folder that is already set, as by
    JAX_COMPILATION_CACHE_DIR, is kept.

    Args:
        precision: Default floating-point type of every array.
        devices: Number of devices to split the CPU into, on which as many simulations run in
            parallel; None for no change. Without effect once JAX has computed something.

    Raises:
        InputError: for another precision, or fewer than one device.
    """
    if precision not in ("float64", "float32"):
        raise InputError(f"precision must be float64 or float32, not {precision!r}")
    # XLA reads its flags once, when JAX first computes.
    os.environ["XLA_FLAGS"] = with_options(os.environ.get("XLA_FLAGS", ""))
    # Programs run threads of their own, which those of NumPy's BLAS would only slow down.
    # Read when NumPy is first imported.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # XLA logs alarms of its own (a slow compilation, a thread that waits), for its developers. Only
    # what ends the program is told. Read when JAX is first imported.
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    import jax  # here, so that `drft --help` needs no JAX

    jax.config.update("jax_enable_x64", precision == "float64")
    if devices is not None:
        _split_cpu(devices)
    if not jax.config.values["jax_compilation_cache_dir"] and (folder := _cache_folder()):
        jax.config.update("jax_compilation_cache_dir", str(folder))
        # The least of them, too: a command has some fifty small ones, of 16 ms each.
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)


def _split_cpu(devices: int) -> None:
    """Make JAX see the CPU as several devices."""
    import jax

    if devices < 1:
        raise InputError(f"the number of CPU devices must be at least 1, not {devices}")
    with suppress(RuntimeError):  # JAX has already computed and keeps its devices
        jax.config.update("jax_num_cpu_devices", devices)


def _cache_folder() -> Path | None:
    """User's cache folder for compiled programs; None where it cannot be written."""
    try:
        base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
        folder = Path(base) / "drftjax" / "jax"
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError):  # read-only, full, or no home at all
        return None
    return folder if os.access(folder, os.W_OK | os.X_OK) else None
