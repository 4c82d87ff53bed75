"""Which algorithm made a zip that says only what its attributes are. Runs nothing of the file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

__all__ = ["made_by"]

# Names of attributes that only this algorithm's models have, among those further down. DDPG is
# TD3 with other values: as policies they are the same.
_MARKS: tuple[tuple[str, frozenset[str]], ...] = (
    ("tqc", frozenset({"top_quantiles_to_drop_per_net"})),
    ("crossq", frozenset({"target_entropy", "policy_delay"})),
    ("sac", frozenset({"target_entropy"})),
    ("td3", frozenset({"target_policy_noise"})),
    ("dqn", frozenset({"exploration_fraction"})),
    ("trpo", frozenset({"cg_max_steps"})),
    ("ppo", frozenset({"clip_range", "n_epochs"})),
    ("a2c", frozenset({"gae_lambda"})),
)


def made_by(data: Mapping[str, Any]) -> str | None:
    """Return the algorithm's name, as in ``algo.name``; None if it is none that is known.

    Args:
        data: The JSON of a zip of Stable-Baselines3: attributes of the model.
    """
    policy = data.get("policy_class")
    if isinstance(policy, Mapping) and "recurrent" in str(policy.get("__module__")):
        return "recurrent_ppo"
    return next((name for name, marks in _MARKS if marks <= data.keys()), None)
