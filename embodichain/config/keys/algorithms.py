"""Configs of the algorithms: the keys that `algo` may have. Does not import torch.

A config has every argument of the algorithm's class; null keeps the default of the class. The
schema is built from one table with the type of each argument and the arguments of each algorithm.
"""

from __future__ import annotations

import dataclasses
from functools import reduce
from operator import or_
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Field, GetCoreSchemaHandler

from embodichain.config.keys.learners import LEARNERS, Demonstrations, learner
from embodichain.config.keys.tensor_algorithms import TensorAlgoCfg
from embodichain.utils.configclass import configclass

__all__ = [
    "ALGORITHMS",
    "ALGO_INSTEAD",
    "DEFAULT_ALGORITHM",
    "PATTERNS",
    "AlgoCfg",
    "AnyAlgoCfg",
]

DEFAULT_ALGORITHM = "ppo"

_LINEAR = r"^lin_(\d+\.?\d*|\.\d+)(e[+-]?\d+)?$"
_AUTO = r"^auto(_(\d+\.?\d*|\.\d+))?$"
PATTERNS = {_LINEAR: "a schedule lin_VALUE", _AUTO: "auto or auto_VALUE"}
"""Pattern of a string -> its description in words."""

_WRAPPER = "wrappers are not used here: observation and reward terms do what they do"
ALGO_INSTEAD = {
    "n_timesteps": "it is a key of the root: total_timesteps=N",
    "n_envs": "it is a key of the root: num_envs=N",
    "seed": "it is a key of the root: seed=N",
    "device": "it is a key of the root: device=NAME",
    "lr": "it is called learning_rate",
    "env": "the environment is the task's",
    "env_wrapper": _WRAPPER,
    "vec_env_wrapper": _WRAPPER,
    "frame_stack": "give observation terms a history_length",
    "callback": "write a callback in Python, on an SB3VecEnv",
    "monitor_kwargs": "returns, lengths and successes are counted anyway",
    "verbose": "the command shows progress itself",
    "tensorboard_log": "event files are in the run folder",
}
"""Keys that other tools have below the algorithm (rl-zoo3), and what to use instead."""
# Keys that are not arguments of the algorithm's class.
_NOT_ARGUMENTS = (
    "name",
    "normalize",
    "normalize_kwargs",
    "noise_type",
    "noise_std",
    "critic_groups",
    "symmetric",
)

Count = Annotated[int, Field(ge=1)]
Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Share = Annotated[float, Field(ge=0, le=1)]
# ``lin_3e-4``: decays linearly from 3e-4 to 0 over the training (rl-zoo3's spelling).
Schedule = Positive | Annotated[str, Field(pattern=_LINEAR)]


@configclass
class AlgoCfg:
    """The keys that every algorithm of Stable-Baselines3 has."""

    name: str = ""
    policy: str = "MlpPolicy"
    """Class of Stable-Baselines3: observations are one flat vector, for CnnPolicy one image, for
    MultiInputPolicy a dict."""
    learning_rate: Schedule | None = None
    critic_groups: Annotated[list[str], Field(min_length=1)] | None = None
    """Observation groups that the critic reads; null is `policy`, the group that the policy reads.
    Needs MultiInputPolicy."""
    symmetric: bool | None = None
    """Whether actor and critic have the task's `symmetry` exactly."""
    policy_kwargs: dict[str, Any] = {}
    """Arguments of the policy's class: `net_arch`, `log_std_init`..."""
    normalize: Literal["obs", "reward", "both"] | bool | None = None
    """Whether `VecNormalize` is used, and for what; true is both (rl-zoo3's spelling)."""
    normalize_kwargs: dict[str, Any] = {}
    """Arguments of `VecNormalize`; `gamma` defaults to the algorithm's."""

    def arguments(self) -> dict[str, Any]:
        """Return the keys that are set, as keyword arguments of the algorithm's class."""
        fields = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}
        return {k: v for k, v in fields.items() if k not in _NOT_ARGUMENTS and v is not None}


_KEYS: dict[str, Any] = {
    "batch_size": Count,
    "buffer_size": Count,
    "cg_damping": Positive,
    "cg_max_steps": Count,
    "chunk_size": Count,  # actions predicted at once, the first for the current step
    "clip_range": Schedule,
    "clip_range_vf": Schedule,
    "ent_coef": NonNegative | Annotated[str, Field(pattern=_AUTO)],
    "exploration_final_eps": Share,
    "exploration_fraction": Share,
    "ensemble_decay": NonNegative,  # of the weights of later predictions of the same action
    "exploration_initial_eps": Share,
    "gae_lambda": Share,
    "gamma": Share,
    # Gradient steps per update; -1: as many as environment steps since the last update.
    "gradient_steps": Annotated[int, Field(ge=-1)],
    "ignore": list[str],  # observations that the policy does not read; null: `last_action`
    "learning_starts": Annotated[int, Field(ge=0)],  # environment steps with random actions
    "line_search_max_iter": Count,
    "line_search_shrinking_factor": Share,
    "max_grad_norm": Positive,
    "n_critic_updates": Count,
    "n_epochs": Count,
    # On-policy: control steps per environment between updates; off-policy: n of n-step returns.
    "n_steps": Count,
    "noise_std": NonNegative,  # of actions in [-1, 1]; null is 0.1
    "noise_type": Literal["normal", "ornstein-uhlenbeck"],  # `action_noise`, rl-zoo3's spelling
    "normalize_advantage": bool,
    "optimize_memory_usage": bool,
    "policy_delay": Count,
    "rms_prop_eps": Positive,
    "sde_sample_freq": Annotated[int, Field(ge=-1)],
    "stats_window_size": Count,
    "sub_sampling_factor": Count,
    "target_entropy": float | Literal["auto"],
    "target_kl": Positive,
    "target_noise_clip": NonNegative,
    "target_policy_noise": NonNegative,
    "target_update_interval": Count,
    "tau": Share,
    "top_quantiles_to_drop_per_net": Annotated[int, Field(ge=0)],
    "train_freq": Count,  # control steps between updates
    "use_rms_prop": bool,
    "use_sde": bool,
    "use_sde_at_warmup": bool,
    "validation_share": Annotated[float, Field(ge=0, lt=1)],  # of the demonstrations
    "vf_coef": NonNegative,
}
# On-policy algorithms allow fewer values.
_ON_POLICY_KEYS = {"batch_size": Annotated[int, Field(ge=2)], "ent_coef": NonNegative}

_ON_POLICY = (
    "n_steps gamma gae_lambda normalize_advantage use_sde sde_sample_freq stats_window_size"
)
_PPO = (
    f"{_ON_POLICY} batch_size n_epochs clip_range clip_range_vf ent_coef vf_coef max_grad_norm "
    "target_kl"
)
_OFF_POLICY = (
    "buffer_size learning_starts batch_size gamma train_freq gradient_steps "
    "optimize_memory_usage n_steps"
)
_NOISY = f"{_OFF_POLICY} noise_type noise_std"
_ENTROPY = (
    f"{_NOISY} ent_coef target_entropy use_sde sde_sample_freq use_sde_at_warmup stats_window_size"
)
ALGORITHMS: dict[str, tuple[str, str]] = {
    "ppo": ("stable_baselines3.PPO", _PPO),
    "a2c": (
        "stable_baselines3.A2C",
        f"{_ON_POLICY} ent_coef vf_coef max_grad_norm rms_prop_eps use_rms_prop",
    ),
    "sac": ("stable_baselines3.SAC", f"{_ENTROPY} tau target_update_interval"),
    "td3": (
        "stable_baselines3.TD3",
        f"{_NOISY} tau policy_delay target_policy_noise target_noise_clip stats_window_size",
    ),
    "ddpg": ("stable_baselines3.DDPG", f"{_NOISY} tau"),
    "dqn": (
        "stable_baselines3.DQN",
        f"{_OFF_POLICY} tau target_update_interval exploration_fraction exploration_initial_eps "
        "exploration_final_eps max_grad_norm stats_window_size",
    ),
    "trpo": (
        "sb3_contrib.TRPO",
        f"{_ON_POLICY} batch_size cg_max_steps cg_damping line_search_shrinking_factor "
        "line_search_max_iter n_critic_updates target_kl sub_sampling_factor",
    ),
    "tqc": (
        "sb3_contrib.TQC",
        f"{_ENTROPY} tau target_update_interval top_quantiles_to_drop_per_net",
    ),
    "crossq": ("sb3_contrib.CrossQ", f"{_ENTROPY} policy_delay"),
    "recurrent_ppo": ("sb3_contrib.RecurrentPPO", _PPO),
    "bc": (
        "embodichain.learning.cloning.BehaviorCloning",
        "batch_size chunk_size ensemble_decay validation_share ignore max_grad_norm",
    ),
}
"""Algorithm -> its class, and the keys of its config besides those of `AlgoCfg`. Those of rsl_rl
and skrl are in `tensor_algorithms`."""

_DEMONSTRATIONS: dict[str, Demonstrations] = {
    "bc": "only",
    "sac": "more",
    "td3": "more",
    "ddpg": "more",
    "tqc": "more",
    "crossq": "more",
}
_DEFAULTS: dict[str, dict[str, Any]] = {"bc": {"learning_rate": "lin_1e-3", "normalize": "obs"}}
"""Values of keys that are not those of the algorithm's class."""
_POLICIES = "MlpPolicy", "CnnPolicy", "MultiInputPolicy"
_RECURRENT = "MlpLstmPolicy", "CnnLstmPolicy", "MultiInputLstmPolicy"


def _config(name: str) -> type[AlgoCfg]:
    keys = ALGORITHMS[name][1].split()
    kinds = _KEYS | (_ON_POLICY_KEYS if "gae_lambda" in keys else {})
    policies = _RECURRENT if name == "recurrent_ppo" else _POLICIES
    members: dict[str, Any] = {"name": name, "policy": policies[0], **dict.fromkeys(keys)}
    members |= _DEFAULTS.get(name, {})
    annotations = {"name": Literal[name], "policy": Literal[policies]}
    annotations |= {key: kinds[key] | None for key in keys}
    namespace = {"__annotations__": annotations, "__module__": __name__, **members}
    return configclass(type(name, (AlgoCfg,), namespace))


for _name, (_path, _) in ALGORITHMS.items():
    learner(
        _name,
        builds=":".join(_path.rsplit(".", 1)),
        demonstrations=_DEMONSTRATIONS.get(_name, "none"),
    )(_config(_name))


class _RegisteredConfigs:
    """Tells pydantic the configs of all learners, when it first builds a schema with them."""

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> Any:
        configs = [entry.config for _, entry in LEARNERS.items()]
        union: Any = reduce(or_, configs)
        return handler.generate_schema(Annotated[union, Field(discriminator="name")])


if TYPE_CHECKING:
    AnyAlgoCfg = AlgoCfg | TensorAlgoCfg
else:
    AnyAlgoCfg = Annotated[AlgoCfg | TensorAlgoCfg, _RegisteredConfigs()]
"""The union of the algorithms' configs, chosen by ``name``."""
