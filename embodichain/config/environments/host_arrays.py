"""Where arrays are on Warp (`sim.warp.arrays`): what of a job reads arrays of the host."""

from __future__ import annotations

from embodichain.config.keys.schema import PolicyCfg, RootCfg, Verb
from embodichain.config.resolved import Resolved, thaw
from embodichain.lab.gym.policies import POLICIES

__all__ = ["why_host", "why_not_device", "with_arrays"]

_PLANNED = ("expert", "teleop")


def why_not_device(root: RootCfg, verb: Verb | None) -> list[str]:
    """Return why a job cannot have its arrays on the device, with the keys to change.

    Args:
        root: The config.
        verb: The verb of the job; None is an environment without a log, a viewer or a policy.
    """
    found: list[str] = []
    if root.viewer.name == "native" or (verb is not None and root.viewer.name != "none"):
        found.append(f"viewer={root.viewer.name} shows arrays of the host")
    if verb in (None, "train"):
        return found
    if verb == "collect":
        found.append("collect chooses episodes by arrays of the host")
    if root.record.format != "none" and root.record.images is not None:
        found.append("record.images: pictures are drawn on the host")
    if (name := _policy(root)) in _PLANNED:
        found.append(f"policy={name} plans with arrays of the host")
    return found


def why_host(root: RootCfg, verb: Verb | None) -> list[str]:
    """Return `why_not_device`, and what may read arrays of the host: functions of users.

    Args:
        root: The config.
        verb: The verb of the job.
    """
    found = why_not_device(root, verb)
    name = _policy(root)
    if verb not in (None, "train") and name not in POLICIES and ":" in name:
        found.append(f"policy={name} may read arrays of the host")
    return found


def _policy(root: RootCfg) -> str:
    policy = root.policy or "random"
    return policy.func if isinstance(policy, PolicyCfg) else policy


def with_arrays(resolved: Resolved, arrays: str) -> Resolved:
    """Return the config with a value of `sim.warp.arrays`, if it runs on Warp."""
    if resolved.tree["sim"]["engine"] != "warp":
        return resolved
    warp = {**vars(resolved.root.sim.warp), "arrays": arrays}
    return resolved.changed(sim={**thaw(resolved.tree["sim"]), "warp": warp})
