"""What `configure_jax` keeps from a user of `drft`."""

import os
import subprocess
import sys

import pytest

# XLA sums these windows of a constant while it compiles, for some seconds: an alarm after one.
SLOW_TO_COMPILE = """
import jax, jax.numpy as jnp, numpy as np
table = jnp.asarray(np.ones((200, 200), np.float32))
windows = lambda: jax.lax.reduce_window(table, 0.0, jax.lax.add, (10, 10), (1, 1), "SAME").sum()
jax.jit(windows).lower().compile()
"""
CONFIGURED = "from drftjax import configure_jax\nconfigure_jax()\n"


@pytest.mark.parametrize(("before", "told"), [("", True), (CONFIGURED, False)])
def test_alarms_of_the_compiler_do_not_reach_the_user(tmp_path, before, told):
    quiet = {k: v for k, v in os.environ.items() if k not in ("TF_CPP_MIN_LOG_LEVEL", "XLA_FLAGS")}
    # Not from the cache of compiled programs.
    quiet |= {"JAX_COMPILATION_CACHE_DIR": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-c", before + SLOW_TO_COMPILE],
        env=quiet, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert ("is taking > 1s" in done.stderr) == told
