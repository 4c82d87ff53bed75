"""Robot experiments declared in YAML: batches of MuJoCo, logs, learning.

`make` builds the environments of a task, as torch tensors::

    import torch

    import embodichain

    env = embodichain.make("reach", num_envs=4, seed=1)
    obs, info = env.reset()
    for _ in range(100):
        action = 2 * torch.rand(env.action_space.shape) - 1
        obs, reward, terminated, truncated, info = env.step(action)
    env.close()

Further ways in, each with its own help:

- ``gymnasium.make("embodichain/reach-v0")`` and ``gymnasium.make_vec("embodichain/reach-v0",
  num_envs=4)``: numpy. Importing this package registers an id for every task;
- `embodichain.config`: `resolve`, `make_env`: a config with its mistakes, and what is made of it;
- `embodichain.learning`: vector environments of Stable-Baselines3 and others, training, policies;
- `embodichain.recording`: read, verify, film and export logs: ``recording.open("outputs/latest")``;
- `embodichain.lab`: simulation, robots and sensors; terms (`embodichain.lab.gym.envs.mdp`);
- ``embodichain --help`` in a shell: run, train, eval, report, ...

Nothing heavy is imported before it is used. EmbodiChain's import paths are answered by `compat`,
whose terms join the built-in ones.
"""

from typing import TYPE_CHECKING

import lazy_loader

from embodichain.compat import moved, names
from embodichain.config.gymnasium_ids import register_with_gymnasium
from embodichain.utils.on_disk import require_files

if TYPE_CHECKING:
    from embodichain.config.environments.factory import make

__version__ = "0.1.0"

# Submodules are imported when they are named: `embodichain.recording.open(...)`.
__getattr__, _lazy_dir, _ = lazy_loader.attach(
    __name__,
    submodules=["cli", "config", "data", "lab", "learning", "recording", "tasks", "utils"],
    submod_attrs={"config.environments.factory": ["make"]},
)

__all__ = ["__version__", "make"]


def __dir__() -> list[str]:
    """Return the public names, also of what is not imported yet."""
    return sorted({*_lazy_dir(), *__all__})


require_files(__file__)
names.install()
moved.install()

from embodichain.utils.plugins import MISSING_NAMES, TERM_MODULES  # noqa: E402  (found by the hook)

TERM_MODULES.append("embodichain.compat.terms")
MISSING_NAMES.append("embodichain.compat.unavailable")
register_with_gymnasium()
