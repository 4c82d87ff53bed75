"""Configs of the algorithms of rsl_rl and skrl. Does not import torch.

They learn on the tensors that the environment returns, on its device. Names and meanings of the
keys are those of the library; the defaults are the settings that Isaac Lab publishes for a Unitree
Go2 on flat ground (its `rsl_rl_ppo_cfg.py` and `skrl_flat_ppo_cfg.yaml`; those for a UR10 that
reaches differ in the size of the networks and the number of epochs), with normalized observations
and `action_scale`.
"""

from __future__ import annotations

import dataclasses
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, NonNegativeFloat, PositiveFloat, PositiveInt

from embodichain.config.keys.learners import learner
from embodichain.utils.configclass import configclass

__all__ = ["PUBLISHED_STEPS", "RslRlPpoCfg", "SkrlPpoCfg", "TensorAlgoCfg"]

PUBLISHED_STEPS = 24
"""Control steps of each environment in a rollout, in Isaac Lab's settings."""

Share = Annotated[float, Field(ge=0, le=1)]
_NOT_ARGUMENTS = (
    *("name", "critic_groups", "hidden_dims", "activation", "action_scale", "init_std"),
    *("obs_normalization", "desired_kl", "num_steps_per_env"),
)


@configclass
class TensorAlgoCfg:
    """The keys that every such algorithm has."""

    rollout_key: ClassVar[str] = ""
    """The key with the control steps of each environment between updates; where it is null, it
    follows `num_envs` and `total_timesteps`. Empty: the learner decides."""
    batches_key: ClassVar[str] = ""
    """The key with the number of batches of a rollout; empty: there is none."""
    name: str = ""
    critic_groups: Annotated[list[str], Field(min_length=1)] | None = None
    """Observation groups that the critic reads; null is `policy`, the group that the actor reads.
    """
    hidden_dims: Annotated[list[PositiveInt], Field(min_length=1)] = [128, 128, 128]
    """Widths of the hidden layers of actor and critic, which are separate networks."""
    activation: Literal["elu", "gelu", "relu", "selu", "sigmoid", "tanh"] = "elu"
    action_scale: PositiveFloat = 0.25
    """Action, in [-1, 1], for an output of 1 of the actor. Outputs of Isaac Lab's actors are in
    units of the action term; where actions are clipped to 4 such units, that is the same."""
    init_std: PositiveFloat = 1.0
    """Standard deviation of the actor's outputs at the start."""
    obs_normalization: bool = True
    """Whether observations are normalized by their mean and standard deviation so far."""
    desired_kl: PositiveFloat | None = 0.01
    """KL divergence between policies before and after an update, to which the learning rate is
    adapted; null: the learning rate is constant."""

    def arguments(self) -> dict[str, Any]:
        """Return the keyword arguments of the library's algorithm."""
        names = [field.name for field in dataclasses.fields(self)]
        return {name: getattr(self, name) for name in names if name not in _NOT_ARGUMENTS}


@learner(
    "rsl_rl_ppo",
    builds="embodichain.learning.tensors.rsl_rl_ppo:RslRlPpo",
    package="rsl_rl",
    requires="embodichain[rsl-rl]",
)
@configclass
class RslRlPpoCfg(TensorAlgoCfg):
    """Keys of ``rsl_rl_ppo``."""

    rollout_key: ClassVar[str] = "num_steps_per_env"
    batches_key: ClassVar[str] = "num_mini_batches"
    name: Literal["rsl_rl_ppo"] = "rsl_rl_ppo"
    num_steps_per_env: PositiveInt | None = None
    """Control steps of each environment between updates; null follows `num_envs` and
    `total_timesteps`."""
    num_learning_epochs: PositiveInt = 5
    num_mini_batches: PositiveInt = 4
    clip_param: PositiveFloat = 0.2
    gamma: Share = 0.99
    lam: Share = 0.95
    value_loss_coef: NonNegativeFloat = 1.0
    entropy_coef: NonNegativeFloat = 0.01
    learning_rate: PositiveFloat = 1e-3
    max_grad_norm: PositiveFloat = 1.0
    optimizer: Literal["adam", "adamw", "rmsprop", "sgd"] = "adam"
    use_clipped_value_loss: bool = True
    normalize_advantage_per_mini_batch: bool = False
    use_mixed_precision: bool = False


@learner(
    "skrl_ppo",
    builds="embodichain.learning.tensors.skrl_ppo:SkrlPpo",
    package="skrl",
    requires="embodichain[skrl]",
)
@configclass
class SkrlPpoCfg(TensorAlgoCfg):
    """Keys of ``skrl_ppo``."""

    rollout_key: ClassVar[str] = "rollouts"
    batches_key: ClassVar[str] = "mini_batches"
    name: Literal["skrl_ppo"] = "skrl_ppo"
    rollouts: PositiveInt | None = None
    """Control steps of each environment between updates; null follows `num_envs` and
    `total_timesteps`."""
    learning_epochs: PositiveInt = 5
    mini_batches: PositiveInt = 4
    discount_factor: Share = 0.99
    gae_lambda: Share = 0.95
    learning_rate: PositiveFloat = 1e-3
    grad_norm_clip: NonNegativeFloat = 1.0
    """0: gradients are not clipped."""
    ratio_clip: PositiveFloat = 0.2
    value_clip: NonNegativeFloat = 0.2
    """0: predicted values are not clipped."""
    entropy_loss_scale: NonNegativeFloat = 0.01
    value_loss_scale: NonNegativeFloat = 1.0
    kl_threshold: NonNegativeFloat = 0.0
    """KL divergence at which an epoch of updates ends early; 0: never."""
    time_limit_bootstrap: bool = True
    """Whether an episode that is cut off is valued as if it went on, from its last observation."""
    mixed_precision: bool = False
