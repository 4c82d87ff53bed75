"""`PolicyView`: the observation that a policy receives, one vector, or a dict if it has images.

`SingleEnv` and `NumpyVectorEnv` both use it, so that one environment and a batch agree.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from embodichain.lab.gym.envs.observation import entry_spaces, named_obs
from embodichain.lab.sim.types import EnvObs

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv

__all__ = ["PolicyView"]


class PolicyView:
    """The entries of the group ``policy`` in declared order; without that group, all entries.

    Args:
        env: The environment.

    Attributes:
        space: Space of one environment: an unbounded Box (K,) float32, or, if an entry is an
            image, a Dict of Boxes with the shape and type of each entry.
    """

    def __init__(self, env: BaseEnv) -> None:
        manager = env.observation_manager
        declared = "policy" in manager.groups
        self._manager = manager
        self._declared = declared
        paths = ["/".join(path) for path in env.observation_paths]
        names = manager.group_terms("policy") if declared else paths
        self._entries = entry_spaces(env.single_observation_space, names)
        self._paths = [tuple(name.split("/")) for name in names]
        shapes = [space.shape or () for space in self._entries.values()]
        self._flat = not (declared and manager.image_terms("policy"))
        width = sum(int(np.prod(shape, dtype=np.int64)) for shape in shapes)
        self.space: spaces.Box | spaces.Dict = self._entries
        if self._flat:
            self.space = spaces.Box(-np.inf, np.inf, (width,), np.float32)

    def __call__(self, obs: EnvObs) -> NDArray[np.float32] | dict[str, NDArray[Any]]:
        """Return the observation of the policy for N environments, as new arrays.

        Args:
            obs: An observation of the environment.

        Returns:
            (N, K) float32, or a dict of (N, ...).
        """
        if not self._flat:
            return named_obs(obs, self._entries)
        if self._declared:
            return np.array(self._manager.flat_rows(obs, "policy"))
        count = int(obs.batch_size[0])
        parts = [obs[path].reshape(count, -1).numpy(force=True) for path in self._paths]
        none = np.zeros((count, 0), np.float32)  # concatenate needs at least one part
        return np.concatenate([none, *parts], axis=1, dtype=np.float32)
