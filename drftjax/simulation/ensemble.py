"""Ensembles of runs: split over the devices, one after the other on each.

A run steps plates that fill the vector units of a core by themselves, so a core is best kept busy
with whole runs. The CPU counts as one device unless a program splits it before its first
computation, as by `jax.config.update("jax_num_cpu_devices", 4)`;
`docs/results/speed.md` has the flags
that make a step fast.
"""

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, PartitionSpec
from jaxtyping import PyTree

from drftjax.common.errors import InputError
from drftjax.physics.command import Command
from drftjax.physics.state import Output, State
from drftjax.simulation.rollout import simulate
from drftjax.simulation.simulator import Simulator


def stack(items: Sequence[PyTree]) -> PyTree:
    """Stack equal trees (simulators, states, ...) into one.

    Args:
        items: One tree for each run, of the same structure and shapes.

    Returns:
        The tree, each array with a leading axis of runs.

    Raises:
        InputError: the trees differ in more than their numbers.
    """
    arrays, rest = zip(*(eqx.partition(item, eqx.is_array) for item in items), strict=True)
    if any(not eqx.tree_equal(other, rest[0]) for other in rest[1:]):
        raise InputError(
            "the runs of an ensemble may differ in their numbers only, not in the number of"
            " plates, in grousers or in the kind of wheel, sand, rig or integrator"
        )
    return eqx.combine(jax.tree.map(lambda *leaves: jnp.stack(leaves), *arrays), rest[0])


def map_runs(
    function: Callable[..., PyTree],
    runs: PyTree,
    *shared: PyTree,
    devices: Sequence[Any] | None = None,
) -> PyTree:
    """`function(run, *shared)` for every run, in the memory of one run a device and of the results.

    Args:
        function: Of one run; traced once. A bound method needs wrapping in a function.
        runs: Tree whose arrays have a leading axis of runs; see `stack`.
        shared: Arguments that are the same for every run.
        devices: Where to compute; all of JAX's devices where none are given.

    Returns:
        The results, each array with a leading axis of runs.
    """
    arrays, kind = eqx.partition(runs, eqx.is_array)
    common, common_kind = eqx.partition(shared, eqx.is_array)
    lengths = {leaf.shape[:1] for leaf in jax.tree.leaves(arrays)}
    if len(lengths) != 1 or lengths <= {(), (0,)}:
        found = sorted(str(length) for length in lengths) or "no arrays"
        raise InputError(f"every array of an ensemble needs the same leading axis, found {found}")
    (count,) = lengths.pop()
    devices = jax.devices() if devices is None else devices
    # Each device takes the same number: the last run is repeated to fill up.
    width = min(len(devices), count)
    rows = jnp.minimum(jnp.arange(-(-count // width) * width), count - 1)
    filled = jax.tree.map(lambda leaf: leaf[rows], arrays)

    def on_one_device(arrays: PyTree, common: PyTree) -> Any:
        shared = eqx.combine(common, common_kind)
        return jax.lax.map(lambda run: function(eqx.combine(run, kind), *shared), arrays)

    split = PartitionSpec("runs")
    results = jax.shard_map(
        on_one_device,
        mesh=Mesh(np.asarray(devices[:width]), ("runs",)),
        in_specs=(split, PartitionSpec()),
        out_specs=split,
        check_vma=False,
    )(filled, common)
    return jax.tree.map(lambda leaf: leaf[:count], results)


@eqx.filter_jit
def simulate_ensemble(
    simulators: Simulator,
    states: State,
    commands: Command,
    dt: float,
    *,
    every: int = 1,
    devices: Sequence[Any] | None = None,
) -> tuple[State, Output]:
    """`simulate` for every run of an ensemble under the same commands.

    Differentiable forward and backward, as `simulate` is.

    Args:
        simulators: Simulators stacked by `stack`, or made under `eqx.filter_vmap`.
        states: Their states at the start, stacked likewise.
        commands: One command for each step, shape (steps,), the same for all runs.
        dt: Step [s].
        every: Rows kept: each `every`-th step. Rows take memory for every run, steps do not.
        devices: Where to compute; all of JAX's devices where none are given.

    Returns:
        The states at the end, shape (runs,), and the outputs, shape (runs, steps // every).
    """

    def one(run: tuple[Simulator, State], commands: Command) -> tuple[State, Output]:
        return simulate(*run, commands, dt, every=every)

    return map_runs(one, (simulators, states), commands, devices=devices)
