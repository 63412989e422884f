"""First weights of a fit: by what a model may be wrong, not by what instruments scatter.

An instrument's white noise would give the finest channel, travel, almost all weight. Where the
model is wrong, that channel is then fitted by bending zeta, and weights from what is left confirm
it. So a fit starts from weights by which each channel counts as a share of its own size. What is
left then gives the weights of the next solve, and where the model is right it is the noise.
"""

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from drftjax.recorded.observation import Observation

# Shares of a channel's size [-]. Sinkage is what zeta is for; travel and forces sum up whatever
# else hinders a wheel.
MODEL_SHARES: Mapping[str, float] = MappingProxyType(
    {"z": 0.01, "x": 0.03, "fx": 0.03, "fz": 0.03, "torque": 0.03}
)


def with_model_shares(
    observation: Observation, shares: Mapping[str, float] = MODEL_SHARES
) -> Observation:
    """The observation whose noise holds a share of each channel's size.

    The size of x is the range of travel, that of others is their root mean square.

    Args:
        observation: Of a run.
        shares: By channel [-]; none where a channel is missing.
    """
    counted = observation.values[:, observation.counts]
    size = np.sqrt(np.mean(counted**2, axis=1))
    size = np.where([c == "x" for c in observation.channels], np.ptp(counted, axis=1), size)
    share = np.array([shares.get(channel, 0.0) for channel in observation.channels])
    return replace(observation, noise=np.hypot(observation.noise, share * size))
