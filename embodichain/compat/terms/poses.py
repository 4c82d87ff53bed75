"""EmbodiChain's events that place objects and robots, as aliases."""

from __future__ import annotations

from typing import Any

from embodichain.compat.terms._alias import alias
from embodichain.lab.gym.envs.mdp.events.placing import RandomizePose
from embodichain.utils.errors import ConfigError, Problem

_OPTIONS = (
    *("position_range", "rotation_range", "relative_position", "relative_rotation"),
    *("relative_to", "physics_update_step"),
)
_EXAMPLE = (
    "{func: %s, mode: reset, params: {entity_cfg: {uid: %s}, "
    "position_range: [[-0.05, -0.05, 0], [0.05, 0.05, 0]]}}"
)


def _object(env: Any, params: dict[str, Any]) -> dict[str, Any]:
    return _checked(params, "is_non_dynamic", "a rigid object")


def _articulation(env: Any, params: dict[str, Any]) -> dict[str, Any]:
    return _checked(params, "parsed", "a robot or articulation")


def _checked(params: dict[str, Any], attribute: str, kind: str) -> dict[str, Any]:
    entity = params["entity_cfg"]
    if not hasattr(entity.asset, attribute):
        raise ConfigError([Problem("entity_cfg.uid", f"{entity.uid!r} is not {kind}")])
    return params


for _name, _uid, _summary, _convert in (
    ("randomize_rigid_object_pose", "cube", "Places a rigid object at random.", _object),
    ("randomize_articulation_root_pose", "ur10", "Places a robot's root at random.", _articulation),
):
    alias(
        "event",
        _name,
        RandomizePose,
        f"{_summary[:-1]}: EmbodiChain's event.",
        _EXAMPLE % (_name, _uid),
        params={"entity_cfg": "entity_cfg"},
        options=_OPTIONS,
        convert=_convert,
        caller=__name__,
    )
