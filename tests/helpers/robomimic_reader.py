"""What robomimic's own package makes of a data set: `python robomimic_reader.py SET.hdf5 OUT.npz`.

Run by an interpreter that has robomimic, gym and this project; robomimic makes the environment.
"""

import sys

import numpy as np
import robomimic.utils.env_utils as env_utils
import robomimic.utils.file_utils as file_utils
import robomimic.utils.obs_utils as obs_utils
from robomimic.utils.dataset import SequenceDataset

path, out = sys.argv[1:]
obs_utils.initialize_obs_utils_with_obs_specs({"obs": {"low_dim": ["flat"], "rgb": []}})
env = env_utils.create_env_from_metadata(file_utils.get_env_metadata_from_dataset(path))
data = SequenceDataset(path, obs_keys=["flat"], dataset_keys=["actions"], frame_stack=1)
first = env.reset()["flat"]
rewards = [env.step(data[i]["actions"][0])[1] for i in range(5)]
length = int(data.hdf5_file["data/demo_0"].attrs["num_samples"])
env.is_success()["task"]
np.savez(
    out,
    observation=first,
    action_dimension=env.action_dimension,
    rewards=rewards,
    length=length,
)
