"""embodichain's tasks as environments of LeRobot, ``--env.type=embodichain``.

Importing it registers the type. LeRobot 0.6 imports it by the name of its distribution; earlier
releases when ``--env.discover_packages_path=lerobot_env_embodichain`` is given.
"""

from lerobot_env_embodichain.env_config import EmbodiChainEnv
from lerobot_env_embodichain.vector_env_hook import install

__all__ = ["EmbodiChainEnv"]

install(EmbodiChainEnv)
