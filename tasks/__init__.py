"""Python of single tasks: importing `embodichain.tasks` registers them with Gymnasium.

Every YAML task is registered as ``embodichain/NAME-v0``; its YAML is read when one is made. Modules
of tasks in Python stand beside this file and are imported here.
"""

from functools import partial

from embodichain.config.composed import list_options
from embodichain.config.factory import make
from embodichain.lab.gym.utils.registration import REGISTERED_ENVS, register_env

__all__: list[str] = []


def _register_yaml_tasks() -> None:
    for name in list_options("task"):
        env_id = f"embodichain/{name}-v0"
        if env_id not in REGISTERED_ENVS:
            register_env(env_id)(partial(make, name))


_register_yaml_tasks()
