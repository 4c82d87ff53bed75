"""Learning in the batched environment: Stable-Baselines3, rsl_rl, skrl, and learned policies.

Names are imported on first use, so that importing the package imports neither torch nor
Stable-Baselines3. Train with `embodichain.learning.train.train`; a name `train` here would hide
the module.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import lazy_loader

if TYPE_CHECKING:
    from embodichain.learning.checkpoint import find_checkpoint
    from embodichain.learning.evaluation import Evaluation, evaluate
    from embodichain.learning.exported import ExportedPolicy
    from embodichain.learning.exporting import export_policy
    from embodichain.learning.policy import LearnedPolicy, load_policy
    from embodichain.learning.rsl_rl_ppo import RslRlVecEnv
    from embodichain.learning.skrl_ppo import SkrlEnv
    from embodichain.learning.vec_env import SB3VecEnv

__getattr__, __dir__, _ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "checkpoint": ["find_checkpoint"],
        "evaluation": ["Evaluation", "evaluate"],
        "exported": ["ExportedPolicy"],
        "exporting": ["export_policy"],
        "policy": ["LearnedPolicy", "load_policy"],
        "rsl_rl_ppo": ["RslRlVecEnv"],
        "skrl_ppo": ["SkrlEnv"],
        "vec_env": ["SB3VecEnv"],
    },
)

__all__ = [
    "Evaluation",
    "ExportedPolicy",
    "LearnedPolicy",
    "RslRlVecEnv",
    "SB3VecEnv",
    "SkrlEnv",
    "evaluate",
    "export_policy",
    "find_checkpoint",
    "load_policy",
]
