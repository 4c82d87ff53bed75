"""Record six small logs, one a kind of task, for `embodichain impact`.

`python scripts/golden_logs.py FOLDER` makes ``FOLDER/TASK/rollout.mcap``. Episodes part in the last
bits on another processor: record them on the machine that compares them.
"""

import sys
from pathlib import Path

from embodichain.cli import main

TASKS = {
    "reach": "expert",
    "push_cube": "expert",
    "pick_place": "expert",
    "cart_pole": "random",
    "quadruped_velocity": "pretrained",
    "humanoid_velocity": "random",
}
"""Task -> the policy that acts in it."""
_OPTIONS = ("num_envs=2", "episodes=1", "seed=1", "max_steps=300", "scene_png=false", "quiet=true")


def record(folder: Path) -> int:
    """Record the logs; return the first exit code that is not 0, or 0."""
    for task, policy in TASKS.items():
        words = [f"task={task}", f"policy={policy}", *_OPTIONS, f"hydra.run.dir={folder / task}"]
        code = main(["run", *words])
        if code:
            return code
    return 0


if __name__ == "__main__":
    sys.exit(record(Path(sys.argv[1])))
