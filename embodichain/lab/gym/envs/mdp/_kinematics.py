"""Which link of a robot is its tool."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity

__all__ = ["tool_links"]


def tool_links(entity: ResolvedEntity) -> list[int]:
    """The link that acts, as an index; several or none where that cannot be told.

    It is the tool point that the robot's `solver_cfg` gives the picked control part (without one,
    the whole robot), else the farthest link that all picked joints move.
    """
    parsed, parts = entity.asset.parsed, entity.control_parts or ("default",)
    tool = parsed.tools.get(parts[0]) if len(parts) == 1 else None
    if tool is not None:
        return [parsed.link_names.index(tool)]
    return _links_below(entity.asset, entity.joint_ids)


def _links_below(asset: Any, joints: Sequence[int]) -> list[int]:
    """Links that all the given joints move, and none beyond; the farthest from the root only.

    As indices. A hand that is fixed to an arm's last link is the arm's; its fingers are not.
    """
    model, index = asset.engine.model, asset.entity
    movers = {int(model.dof_bodyid[d]) for d in np.asarray(index.dof_adr)[list(joints)]}
    found: list[tuple[int, int]] = []
    for link, body in enumerate(np.asarray(index.body_ids)):
        above, here, carrier = set(), int(body), 0
        while here != 0:
            above.add(here)
            if carrier == 0 and model.body_dofnum[here]:
                carrier = here
            here = int(model.body_parentid[here])
        if movers <= above and carrier in movers:
            found.append((len(above), link))
    deepest = max((depth for depth, _ in found), default=0)
    return [link for depth, link in found if depth == deepest]
