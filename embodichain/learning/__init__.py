"""Learning in the batched environment: Stable-Baselines3, rsl_rl, skrl, and learned policies.

Names are imported on first use, so that importing the package imports neither torch nor
Stable-Baselines3. Train with `embodichain.learning.training.train.train`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import lazy_loader

if TYPE_CHECKING:
    from embodichain.learning.checkpoints.checkpoint import find_checkpoint
    from embodichain.learning.evaluation.evaluation import Evaluation, evaluate
    from embodichain.learning.policies.exported import ExportedPolicy
    from embodichain.learning.policies.exporting import export_policy
    from embodichain.learning.policies.policy import LearnedPolicy, load_policy
    from embodichain.learning.sb3.vec_env import SB3VecEnv
    from embodichain.learning.tensors.rsl_rl_ppo import RslRlVecEnv
    from embodichain.learning.tensors.skrl_ppo import SkrlEnv

__getattr__, __dir__, _ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "checkpoints.checkpoint": ["find_checkpoint"],
        "evaluation.evaluation": ["Evaluation", "evaluate"],
        "policies.exported": ["ExportedPolicy"],
        "policies.exporting": ["export_policy"],
        "policies.policy": ["LearnedPolicy", "load_policy"],
        "tensors.rsl_rl_ppo": ["RslRlVecEnv"],
        "tensors.skrl_ppo": ["SkrlEnv"],
        "sb3.vec_env": ["SB3VecEnv"],
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
