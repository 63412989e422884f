"""Set-up of a process that works for a cluster."""

import os
from functools import lru_cache

from drftjax import __version__
from drftjax.common.errors import InputError

ONE_THREAD = "--xla_cpu_multi_thread_eigen=false"


def set_up_worker(software: str) -> None:
    """Configure JAX for one device and one thread: as many workers as cores fill a machine.

    Args:
        software: Version of this package that sends the work.

    Raises:
        InputError: where this is another version.
    """
    if software != __version__:
        raise InputError(f"a worker has drftjax {__version__}, must have {software}, as it is here")
    _configure()


@lru_cache
def _configure() -> None:
    flags = os.environ.get("XLA_FLAGS", "")
    if "xla_cpu_multi_thread_eigen" not in flags:
        os.environ["XLA_FLAGS"] = f"{flags} {ONE_THREAD}".strip()
    os.environ.setdefault("JAX_PLATFORMS", "cpu")
    from drftjax.common.jax_config import configure_jax

    configure_jax(devices=1)
