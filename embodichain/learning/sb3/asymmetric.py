"""Policies of Stable-Baselines3 whose actor and critic read different entries of an observation.

The critic, which only training needs, may read the state of the simulation, while the actor reads
what a robot can measure (Pinto et al., "Asymmetric Actor Critic for Image-Based Robot Learning",
2017). A trained policy acts on observations without the critic's entries.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from gymnasium import spaces
from stable_baselines3.common.policies import (
    ActorCriticPolicy,
    BasePolicy,
    MultiInputActorCriticPolicy,
)
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor, MlpExtractor
from stable_baselines3.common.type_aliases import PyTorchObs, Schedule
from stable_baselines3.sac.policies import MultiInputPolicy as SacPolicy
from stable_baselines3.td3.policies import MultiInputPolicy as Td3Policy
from torch import Tensor

__all__ = [
    "ASYMMETRIC",
    "AsymmetricActorCriticPolicy",
    "AsymmetricSacPolicy",
    "AsymmetricTd3Policy",
    "actor_space",
]


class _TwoViews(BasePolicy):
    """The entries of actor and critic, and a features extractor for some entries.

    Args:
        observation_space: A Dict that has the entries of both.
        action_space: The actions, (A,).
        lr_schedule: The learning rate.
        actor_keys: Entries that the actor reads.
        critic_keys: Entries that the critic reads.
        **kwargs: As for the policy of Stable-Baselines3.
    """

    def __init__(
        self,
        observation_space: spaces.Dict,
        action_space: spaces.Space[Any],
        lr_schedule: Schedule,
        *,
        actor_keys: Iterable[str],
        critic_keys: Iterable[str],
        **kwargs: Any,
    ) -> None:
        # Before the networks are built, which is done by the constructor of Stable-Baselines3.
        self.actor_keys = tuple(actor_keys)
        self.critic_keys = tuple(critic_keys)
        kwargs["share_features_extractor"] = False
        super().__init__(observation_space, action_space, lr_schedule, **kwargs)

    def extractor_of(self, keys: Iterable[str]) -> BaseFeaturesExtractor:
        """Return a new features extractor for some entries of the observation."""
        space: Any = self.observation_space
        entries = spaces.Dict({key: space[key] for key in keys})
        return self.features_extractor_class(entries, **self.features_extractor_kwargs)


class AsymmetricActorCriticPolicy(_TwoViews, MultiInputActorCriticPolicy):
    """``MultiInputPolicy`` of PPO, A2C and TRPO with separate entries for actor and critic.

    Args:
        observation_space: A Dict that has the entries of both.
        action_space: The actions, (A,).
        lr_schedule: The learning rate.
        actor_keys: Entries that the actor reads.
        critic_keys: Entries that the critic reads.
        **kwargs: As for `MultiInputActorCriticPolicy`; ``share_features_extractor`` is False.
    """

    def make_features_extractor(self) -> BaseFeaturesExtractor:
        """Return a features extractor for the actor."""
        return self.extractor_of(self.actor_keys)

    def _build(self, lr_schedule: Schedule) -> None:
        self.vf_features_extractor = self.extractor_of(self.critic_keys)
        super()._build(lr_schedule)

    def _build_mlp_extractor(self) -> None:
        super()._build_mlp_extractor()
        width = self.vf_features_extractor.features_dim
        critic = MlpExtractor(width, self.net_arch, self.activation_fn, self.device)
        self.mlp_extractor.value_net = critic.value_net

    # Stable-Baselines3 converts the images of every entry that it is given, read or not.

    def extract_features(  # type: ignore[override]
        self, obs: PyTorchObs, features_extractor: BaseFeaturesExtractor | None = None
    ) -> tuple[Tensor, Tensor]:
        """Return the features of the actor and of the critic, (B, F) each."""
        extract = super(ActorCriticPolicy, self).extract_features
        return (
            extract(_only(obs, self.actor_keys), self.pi_features_extractor),
            extract(_only(obs, self.critic_keys), self.vf_features_extractor),
        )

    def get_distribution(self, obs: PyTorchObs) -> Any:
        """Return the distribution of actions; entries of the critic alone may be missing."""
        return super().get_distribution(_only(obs, self.actor_keys))

    def predict_values(self, obs: PyTorchObs) -> Tensor:
        """Return the values (B, 1); entries of the actor alone may be missing."""
        return super().predict_values(_only(obs, self.critic_keys))


class _OffPolicy(_TwoViews):
    def make_actor(self, features_extractor: BaseFeaturesExtractor | None = None) -> Any:
        """Return an actor that reads its entries."""
        return super().make_actor(self.extractor_of(self.actor_keys))  # type: ignore[misc]

    def make_critic(self, features_extractor: BaseFeaturesExtractor | None = None) -> Any:
        """Return critics that read theirs."""
        return super().make_critic(self.extractor_of(self.critic_keys))  # type: ignore[misc]


class AsymmetricSacPolicy(_OffPolicy, SacPolicy):
    """``MultiInputPolicy`` of SAC with separate entries for actor and critics."""


class AsymmetricTd3Policy(_OffPolicy, Td3Policy):
    """``MultiInputPolicy`` of TD3 and DDPG with separate entries for actor and critics."""


ASYMMETRIC: dict[type[BasePolicy], type[BasePolicy]] = {
    MultiInputActorCriticPolicy: AsymmetricActorCriticPolicy,
    SacPolicy: AsymmetricSacPolicy,
    Td3Policy: AsymmetricTd3Policy,
}
"""Policy of Stable-Baselines3 -> its version with separate entries."""


def actor_space(policy: BasePolicy) -> spaces.Space[Any]:
    """Return the space of the observations that a policy needs to act."""
    space: Any = policy.observation_space
    if not isinstance(policy, _TwoViews):
        return policy.observation_space
    return spaces.Dict({key: space[key] for key in policy.actor_keys})


def _only(obs: Any, keys: Iterable[str]) -> Any:
    return {key: obs[key] for key in keys}
