"""Algorithms as data classes, one each: what `algo` may hold, without importing torch.

Fields are arguments of the algorithm's class; None keeps its default. That they are all of them, a
test compares with the signatures. What names in `policy_kwargs` mean is `learning`'s.
"""

from __future__ import annotations

import dataclasses
from typing import Annotated, Any, Literal

from pydantic import Field

from embodichain.utils.configclass import configclass

__all__ = [
    "ALGO_INSTEAD",
    "DEFAULT_ALGORITHM",
    "PATTERNS",
    "AlgoCfg",
    "AnyAlgoCfg",
    "OffPolicyCfg",
    "PpoCfg",
]

DEFAULT_ALGORITHM = "ppo"

Count = Annotated[int, Field(ge=1)]
Whole = Annotated[int, Field(ge=0)]
Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Share = Annotated[float, Field(ge=0, le=1)]
Sampling = Annotated[int, Field(ge=-1)]
_LINEAR = r"^lin_(\d+\.?\d*|\.\d+)(e[+-]?\d+)?$"
_AUTO = r"^auto(_(\d+\.?\d*|\.\d+))?$"
PATTERNS = {_LINEAR: "a schedule lin_VALUE", _AUTO: "auto or auto_VALUE"}
"""What text must look like, in words."""
LinearSchedule = Annotated[str, Field(pattern=_LINEAR)]
"""``lin_3e-4``: from 3e-4 down to 0 in a straight line over the training (rl-zoo3's spelling)."""
Schedule = Positive | LinearSchedule

_WRAPPER = "wrappers are not used here: observation and reward terms do what they do"
ALGO_INSTEAD = {
    "n_timesteps": "it stands at the root: total_timesteps=N",
    "n_envs": "it stands at the root: num_envs=N",
    "seed": "it stands at the root: seed=N",
    "device": "it stands at the root: device=NAME",
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
# Not arguments of an algorithm: how its environment and its noise are made.
_OURS = ("name", "normalize", "normalize_kwargs", "noise_type", "noise_std")


@configclass
class AlgoCfg:
    """What every algorithm has."""

    name: str = ""
    policy: Literal["MlpPolicy"] = "MlpPolicy"
    """Observations are one flat vector."""
    learning_rate: Schedule | None = None
    gamma: Share | None = None
    policy_kwargs: dict[str, Any] = {}
    """Arguments of the policy's class: `net_arch`, `log_std_init`..."""
    normalize: Literal["obs", "reward", "both"] | bool | None = None
    """What `VecNormalize` normalizes; true is both (rl-zoo3's spelling)."""
    normalize_kwargs: dict[str, Any] = {}
    """Arguments of `VecNormalize`; its `gamma` is the algorithm's unless given."""

    def arguments(self) -> dict[str, Any]:
        """Return what is set, as keyword arguments of the algorithm's class."""
        fields = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}
        return {k: v for k, v in fields.items() if k not in _OURS and v is not None}


@configclass
class OnPolicyCfg(AlgoCfg):
    """Algorithms that learn from whole rollouts and forget them."""

    n_steps: Count | None = None
    """Control steps of each environment between updates."""
    gae_lambda: Share | None = None
    normalize_advantage: bool | None = None
    use_sde: bool | None = None
    sde_sample_freq: Sampling | None = None
    stats_window_size: Count | None = None


@configclass
class PpoCfg(OnPolicyCfg):
    """Arguments of `stable_baselines3.PPO`."""

    name: Literal["ppo"] = "ppo"
    batch_size: Annotated[int, Field(ge=2)] | None = None
    n_epochs: Count | None = None
    clip_range: Schedule | None = None
    clip_range_vf: Schedule | None = None
    ent_coef: NonNegative | None = None
    vf_coef: NonNegative | None = None
    max_grad_norm: Positive | None = None
    target_kl: Positive | None = None


@configclass
class RecurrentPpoCfg(PpoCfg):
    """Arguments of `sb3_contrib.RecurrentPPO`: PPO with a policy that remembers (LSTM)."""

    name: Literal["recurrent_ppo"] = "recurrent_ppo"  # type: ignore[assignment]
    policy: Literal["MlpLstmPolicy"] = "MlpLstmPolicy"  # type: ignore[assignment]


@configclass
class A2cCfg(OnPolicyCfg):
    """Arguments of `stable_baselines3.A2C`."""

    name: Literal["a2c"] = "a2c"
    ent_coef: NonNegative | None = None
    vf_coef: NonNegative | None = None
    max_grad_norm: Positive | None = None
    rms_prop_eps: Positive | None = None
    use_rms_prop: bool | None = None


@configclass
class TrpoCfg(OnPolicyCfg):
    """Arguments of `sb3_contrib.TRPO`."""

    name: Literal["trpo"] = "trpo"
    batch_size: Annotated[int, Field(ge=2)] | None = None
    cg_max_steps: Count | None = None
    cg_damping: Positive | None = None
    line_search_shrinking_factor: Share | None = None
    line_search_max_iter: Count | None = None
    n_critic_updates: Count | None = None
    target_kl: Positive | None = None
    sub_sampling_factor: Count | None = None


@configclass
class OffPolicyCfg(AlgoCfg):
    """Algorithms that learn from a replay buffer."""

    buffer_size: Count | None = None
    learning_starts: Whole | None = None
    """Environment steps with random actions before anything is learned."""
    batch_size: Count | None = None
    train_freq: Count | None = None
    """Control steps between updates."""
    gradient_steps: Sampling | None = None
    """Gradient steps an update; -1: as many as environment steps since the last."""
    optimize_memory_usage: bool | None = None
    n_steps: Count | None = None
    """Of n-step returns."""


@configclass
class NoisyCfg(OffPolicyCfg):
    """Algorithms with noise on their actions; `action_noise` in rl-zoo3's spelling."""

    noise_type: Literal["normal", "ornstein-uhlenbeck"] | None = None
    noise_std: NonNegative | None = None
    """Of actions in [-1, 1]; null is 0.1."""


@configclass
class DdpgCfg(NoisyCfg):
    """Arguments of `stable_baselines3.DDPG`."""

    name: Literal["ddpg"] = "ddpg"
    tau: Share | None = None


@configclass
class Td3Cfg(NoisyCfg):
    """Arguments of `stable_baselines3.TD3`."""

    name: Literal["td3"] = "td3"
    tau: Share | None = None
    policy_delay: Count | None = None
    target_policy_noise: NonNegative | None = None
    target_noise_clip: NonNegative | None = None
    stats_window_size: Count | None = None


@configclass
class EntropyCfg(NoisyCfg):
    """Algorithms that keep their entropy up."""

    ent_coef: NonNegative | Annotated[str, Field(pattern=_AUTO)] | None = None
    target_entropy: float | Literal["auto"] | None = None
    use_sde: bool | None = None
    sde_sample_freq: Sampling | None = None
    use_sde_at_warmup: bool | None = None
    stats_window_size: Count | None = None


@configclass
class SacCfg(EntropyCfg):
    """Arguments of `stable_baselines3.SAC`."""

    name: Literal["sac"] = "sac"
    tau: Share | None = None
    target_update_interval: Count | None = None


@configclass
class TqcCfg(EntropyCfg):
    """Arguments of `sb3_contrib.TQC`."""

    name: Literal["tqc"] = "tqc"
    tau: Share | None = None
    target_update_interval: Count | None = None
    top_quantiles_to_drop_per_net: Whole | None = None


@configclass
class CrossqCfg(EntropyCfg):
    """Arguments of `sb3_contrib.CrossQ`."""

    name: Literal["crossq"] = "crossq"
    policy_delay: Count | None = None


@configclass
class DqnCfg(OffPolicyCfg):
    """Arguments of `stable_baselines3.DQN`, which needs discrete actions."""

    name: Literal["dqn"] = "dqn"
    tau: Share | None = None
    target_update_interval: Count | None = None
    exploration_fraction: Share | None = None
    exploration_initial_eps: Share | None = None
    exploration_final_eps: Share | None = None
    max_grad_norm: Positive | None = None
    stats_window_size: Count | None = None


AnyAlgoCfg = Annotated[
    PpoCfg
    | A2cCfg
    | SacCfg
    | Td3Cfg
    | DdpgCfg
    | DqnCfg
    | TrpoCfg
    | TqcCfg
    | CrossqCfg
    | RecurrentPpoCfg,
    Field(discriminator="name"),
]
"""What `algo` may be; ``name`` chooses."""
