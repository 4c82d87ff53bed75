"""What LeRobot's own package reads of a data set: `python lerobot_reader.py SET OUT.npz`.

Run by an interpreter that has LeRobot (`make lerobot`); nothing of this project is imported here.
"""

import sys

import numpy as np
import torch
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from torch.utils.data import DataLoader

root, out = sys.argv[1:]
# PyAV comes with LeRobot; torchcodec, its default, wants FFmpeg's libraries on the machine.
data = LeRobotDataset("local/set", root=root, video_backend="pyav")
ahead = LeRobotDataset(
    *("local/set", root), delta_timestamps={"action": [0, 1 / data.fps]}, video_backend="pyav"
)
batches = list(DataLoader(data, batch_size=7))
columns = {
    name: torch.cat([batch[name] for batch in batches]).numpy()
    for name, value in batches[0].items()
    if isinstance(value, torch.Tensor)
}
np.savez(
    out,
    **columns,
    about=[len(data), data.num_episodes, data.fps],
    tasks=[task for batch in batches for task in batch["task"]],
    two_actions=torch.stack([ahead[i]["action"] for i in range(len(ahead))]).numpy(),
    action_names=data.meta.features["action"]["names"],
    **{
        f"{kind}/{name}": stats[kind]
        for name, stats in data.meta.stats.items()
        for kind in ("min", "max", "mean", "std", "count", "q01", "q50", "q99")
    },
)
