"""Inverse kinematics: `tool_links` finds a robot's tool, `Reach` moves it to a pose."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import lazy_loader
import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    import mujoco

    from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
    from embodichain.lab.sim.engine.api import F64
else:
    mujoco = lazy_loader.load("mujoco")

__all__ = [
    "Reach",
    "tool_links",
]


def tool_links(entity: ResolvedEntity) -> list[int]:
    """The index of the tool link; several or none where it is not unique.

    It is the tool point in the robot's `solver_cfg` for the picked control part (or the whole
    robot), else the farthest link that all picked joints move.
    """
    parsed, parts = entity.asset.parsed, entity.control_parts or ("default",)
    tool = parsed.tools.get(parts[0]) if len(parts) == 1 else None
    if tool is not None:
        return [parsed.link_names.index(tool)]
    return _links_below(entity.asset, entity.joint_ids)


def _links_below(asset: Any, joints: Sequence[int]) -> list[int]:
    """Indices of the links that all the given joints move, the farthest from the root only.

    Links beyond another joint are left out: a hand fixed to an arm's last link counts, its fingers
    do not.
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


POSITION_TOLERANCE = 5e-4
"""Metres; EmbodiChain's `pos_eps`."""
ROTATION_TOLERANCE = 5e-4
"""Rad; EmbodiChain's `rot_eps`."""
MAX_ITERATIONS = 60
_DAMPING = 1e-6
_LONGEST_STEP = 0.5
"""Rad or m: no joint moves farther in one iteration."""
_SHORTEST_STEP = 1e-5
"""Rad or m: the search ends when no joint moves farther than this in an iteration."""


class Reach:
    """Inverse kinematics of one tool.

    Each step solves (J J^T + c I) y = e and moves the joints by J^T y, where e is the pose error
    and c = |e|^2 / 2 + 1e-6 (T. Sugihara, "Solvability-unconcerned inverse kinematics by the
    Levenberg-Marquardt method", IEEE Transactions on Robotics 27(5), 2011). Environments are solved
    one by one with the compiled model, so that results are independent.

    Args:
        entity: The robot; its picked joints move, its picked link is the tool (by default that of
            `tool_links`).
        path: The parameter, for messages.

    Attributes:
        body: MuJoCo body id of the tool.

    Raises:
        ConfigError: If there is no such link or more than one, or no picked joint moves it.
    """

    def __init__(self, entity: ResolvedEntity, path: str = "entity_cfg") -> None:
        asset = entity.asset
        if not entity.joint_ids:
            raise ConfigError([Problem(f"{path}.uid", f"{entity.uid!r} has no joints")])
        links = list(entity.link_ids) or tool_links(entity)
        if len(links) != 1:
            names = [asset.parsed.link_names[link] for link in links]
            message = f"name one link as the tool; the picked joints suggest {names or 'none'}"
            raise ConfigError([Problem(f"{path}.link_names", message)])
        index = asset.entity
        self.body = int(index.body_ids[links[0]])
        self._model: mujoco.MjModel = asset.engine.model
        self._data = mujoco.MjData(self._model)
        dofs = np.asarray(index.dof_adr, np.int64)
        above, body = [], self.body
        while body != index.root_body_id:
            above.append(body)
            body = int(self._model.body_parentid[body])
        moving = [j for j in entity.joint_ids if self._model.dof_bodyid[dofs[j]] in above]
        if not moving:
            tool = asset.parsed.link_names[links[0]]
            message = f"none of the picked joints moves {tool!r}"
            raise ConfigError([Problem(f"{path}.link_names", message)])
        self.joints: NDArray[np.int64] = np.array(sorted(moving))
        self._dofs, self._qpos_adr = dofs[self.joints], np.asarray(index.qpos_adr, np.int64)
        self._low, self._high = np.asarray(asset.parsed.qpos_limits, np.float64)[self.joints].T
        self._root = index.root_body_id

    def solve(
        self, root_pos: F64, root_quat: F64, qpos: F64, pos: F64, quat: F64 | None
    ) -> tuple[F64, NDArray[np.bool_]]:
        """Search joint positions that move the tool to a pose.

        Args:
            root_pos: (n, 3) of the robot's root; all poses are in the environment's frame.
            root_quat: (n, 4) wxyz.
            qpos: (n, D) initial positions of all joints.
            pos: (n, 3) target position.
            quat: (n, 4) target orientation; None leaves it free.

        Returns:
            (n, D) joint positions within the limits, and (n,) whether they reach the pose within
            0.5 mm and 0.5 mrad.
        """
        found, solved = qpos.copy(), np.zeros(len(qpos), np.bool_)
        for row in range(len(qpos)):
            turn = None if quat is None else quat[row]
            aim = self._in_model(root_pos[row], root_quat[row], pos[row], turn)
            solved[row] = self._solve(found[row], *aim)
        return found, solved

    def _in_model(
        self, root_pos: F64, root_quat: F64, pos: F64, quat: F64 | None
    ) -> tuple[F64, F64 | None]:
        """The pose with the same transform to the root, for the root's pose in the model."""
        mujoco.mj_kinematics(self._model, self._data)
        home_pos, home_quat = self._data.xpos[self._root], self._data.xquat[self._root]
        back_pos, back_quat = np.empty(3), np.empty(4)
        mujoco.mju_negPose(back_pos, back_quat, root_pos, root_quat)
        for frame_pos, frame_quat in ((back_pos, back_quat), (home_pos, home_quat)):
            moved, turned = np.empty(3), np.empty(4)
            given = np.array([1.0, 0.0, 0.0, 0.0]) if quat is None else quat
            mujoco.mju_mulPose(moved, turned, frame_pos, frame_quat, pos, given)
            pos, quat = moved, None if quat is None else turned
        return pos, quat

    def _solve(self, qpos: F64, pos: F64, quat: F64 | None) -> bool:
        """Change joint positions (D,) in place until they reach a pose; return whether they do."""
        model, data, rows = self._model, self._data, 3 if quat is None else 6
        jacobian, error = np.zeros((6, model.nv)), np.zeros(6)
        for _ in range(MAX_ITERATIONS):
            data.qpos[self._qpos_adr] = qpos
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            error[:3] = pos - data.xpos[self.body]
            if quat is not None:
                mujoco.mju_subQuat(error[3:], quat, data.xquat[self.body])
                error[3:] = data.xmat[self.body].reshape(3, 3) @ error[3:]
            close = np.linalg.norm(error[:3]) < POSITION_TOLERANCE
            if close and np.linalg.norm(error[3:]) < ROTATION_TOLERANCE:
                return True
            mujoco.mj_jacBody(model, data, jacobian[:3], jacobian[3:], self.body)
            part = jacobian[:rows, self._dofs]
            damping = 0.5 * (error @ error) + _DAMPING
            step = part.T @ np.linalg.solve(part @ part.T + damping * np.eye(rows), error[:rows])
            step *= min(1.0, _LONGEST_STEP / max(np.abs(step).max(), 1e-12))
            before = qpos[self.joints]
            after = np.clip(before + step, self._low, self._high)
            if np.abs(after - before).max() <= _SHORTEST_STEP:
                return False
            qpos[self.joints] = after
        return False
