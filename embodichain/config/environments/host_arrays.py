"""Where arrays are on Warp (`sim.warp.arrays`): parts of a job that read arrays of the host."""

from __future__ import annotations

from embodichain.config.keys.schema import JobVerb, PolicyCfg, RootCfg
from embodichain.config.resolved import Resolved, thaw
from embodichain.lab.gym.policies import POLICIES

__all__ = ["why_host", "why_not_device", "with_arrays"]

_PLANNED = ("expert", "teleop")


def why_not_device(root: RootCfg, verb: JobVerb | None) -> list[str]:
    """Return why a job cannot have its arrays on the device, with the keys to change.

    Args:
        root: The config.
        verb: The verb of the job; None is an environment without a log, a viewer or a policy.
    """
    reasons: list[str] = []
    if root.viewer.name == "native" or (verb is not None and root.viewer.name != "none"):
        reasons.append(f"viewer={root.viewer.name} shows arrays of the host")
    if verb in (None, "train"):
        return reasons
    if verb == "collect":
        reasons.append("collect chooses episodes by arrays of the host")
    if root.record.format != "none" and root.record.images is not None:
        reasons.append("record.images: pictures are drawn on the host")
    name = _policy_name(root)
    if name in _PLANNED:
        reasons.append(f"policy={name} plans with arrays of the host")
    return reasons


def why_host(root: RootCfg, verb: JobVerb | None) -> list[str]:
    """Return `why_not_device`, and what may read arrays of the host: functions of users.

    Args:
        root: The config.
        verb: The verb of the job.
    """
    reasons = why_not_device(root, verb)
    name = _policy_name(root)
    if verb not in (None, "train") and name not in POLICIES and ":" in name:
        reasons.append(f"policy={name} may read arrays of the host")
    return reasons


def _policy_name(root: RootCfg) -> str:
    """The policy, without its parameters."""
    policy = root.policy or "random"
    if isinstance(policy, PolicyCfg):
        return policy.func
    return policy


def with_arrays(resolved: Resolved, arrays: str) -> Resolved:
    """Return the config with a value of `sim.warp.arrays`, if it runs on Warp."""
    if resolved.tree["sim"]["engine"] != "warp":
        return resolved
    warp = {**vars(resolved.root.sim.warp), "arrays": arrays}
    return resolved.changed(sim={**thaw(resolved.tree["sim"]), "warp": warp})
