"""The tutorial's class, written against the Python API: overridden hooks, torch's own generator.

`scripts/tutorials/gym/random_reach.py` is the script; what its hook computes is replaced by what a
newcomer writes: homogeneous matrices and `torch.rand`.
"""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from typing import Any

import torch

SCRIPT = Path(__file__).parents[1] / "scripts" / "tutorials" / "gym" / "random_reach.py"


def make_tutorial(num_envs: int) -> Any:
    """N environments of the tutorial's class."""
    name = "benchmarks_tutorial_script"
    spec = importlib.util.spec_from_file_location(name, SCRIPT)
    if spec is None or spec.loader is None:
        raise FileNotFoundError(SCRIPT)
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)

    class Newcomer(module.RandomReachEnv):
        def _update_sim_state(self, **kwargs: Any) -> None:
            poses = torch.eye(4).expand(self.num_envs, 4, 4).clone()
            poses[:, :3, 3] = torch.rand(self.num_envs, 3) * 0.5 - 0.25
            self.cube.set_local_pose(poses)

    return Newcomer(num_envs=num_envs, headless=True)
