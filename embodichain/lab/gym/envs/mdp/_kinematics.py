"""`Chain`: where a link is, and how it moves with the joints above it, without the simulation.

Forward kinematics on numpy rows, one row an environment, from the compiled model's constants. Like
everything that terms compute, a row's result does not depend on the other rows: elementwise
arithmetic in a fixed order, no matrix library.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from embodichain.utils.math import quat_to_matrix

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
    from embodichain.lab.sim.engine.base import F64

__all__ = ["Chain", "Posture", "apply", "links_below", "matmul", "tool_links"]

_SLIDE, _HINGE = 2, 3  # mjtJoint


def matmul(a: F64, b: F64) -> F64:
    """Products of matrices, (..., i, 3) and (..., 3, j), summed from the first column on."""
    terms = a[..., :, :, None] * b[..., None, :, :]
    out: F64 = terms[..., 0, :] + terms[..., 1, :] + terms[..., 2, :]
    return out


def apply(a: F64, v: F64) -> F64:
    """Matrices (..., 3, 3) times vectors (..., 3)."""
    terms = a * v[..., None, :]
    out: F64 = terms[..., 0] + terms[..., 1] + terms[..., 2]
    return out


@dataclass(frozen=True)
class _Joint:
    """One joint of the chain, constants only, in the frame before it.

    Attributes:
        lines: (3, 2) where its body is, and its axis.
        turn: (3, 3) the body's axes in the joint's reference posture.
        sine, versine: (3, 3) what sin(t) and 1 - cos(t) add to them: Rodrigues' formula,
            R = I + sin(t) K + (1 - cos(t)) K^2 (zeros of a slide).
        anchor: (3,) where the axis passes, in the body's frame; None is the body's origin.
        slides: Whether it is prismatic.
        column: Its index among the articulation's joints.
        zero: Its position in the model's reference posture.
    """

    lines: F64
    turn: F64
    sine: F64
    versine: F64
    anchor: F64 | None
    slides: bool
    column: int
    zero: float


@dataclass(frozen=True)
class Posture:
    """Where a chain's link is.

    Attributes:
        pos: (n, 3) metres, environment's frame.
        mat: (n, 3, 3) its axes as columns.
        anchors: (K, n, 3) a point on the axis of each joint of the chain.
        axes: (K, n, 3).
    """

    pos: F64
    mat: F64
    anchors: F64
    axes: F64


class Chain:
    """The joints between an articulation's root and one of its links.

    Args:
        asset: Handle of the articulation, its scene compiled.
        body: MuJoCo body id of the link.

    Attributes:
        columns: (K,) the joints, as indices among the articulation's, from the root on.
        slides: (K,) which of them are prismatic.
    """

    def __init__(self, asset: Any, body: int) -> None:
        model, index = asset.engine.model, asset.entity
        addresses = {int(a): d for d, a in enumerate(np.asarray(index.qpos_adr))}
        path: list[int] = []
        while body != index.root_body_id:
            path.append(body)
            body = int(model.body_parentid[body])
        self._joints: list[_Joint] = []
        offset, turn = np.zeros(3), np.eye(3)
        for body in reversed(path):
            offset = offset + apply(turn, model.body_pos[body])
            turn = matmul(turn, quat_to_matrix(model.body_quat[body]))
            first = int(model.body_jntadr[body])
            for joint in range(first, first + int(model.body_jntnum[body])):
                self._joints.append(_constants(model, joint, addresses, offset, turn))
                offset, turn = np.zeros(3), np.eye(3)
        self._tail = offset, turn
        self._turns = np.array([j.turn for j in self._joints]).reshape(-1, 3, 3)
        self._sines = np.array([j.sine for j in self._joints]).reshape(-1, 3, 3)
        self._versines = np.array([j.versine for j in self._joints]).reshape(-1, 3, 3)
        self._zeros = np.array([j.zero for j in self._joints])
        self.columns: NDArray[np.int64] = np.array([j.column for j in self._joints], np.int64)
        self.slides: NDArray[np.bool_] = np.array([j.slides for j in self._joints], np.bool_)

    def posture(self, root_pos: F64, root_mat: F64, qpos: F64) -> Posture:
        """Where the link is.

        Args:
            root_pos: (n, 3) of the articulation's root.
            root_mat: (n, 3, 3).
            qpos: (n, D) all joints of the articulation, rad or m.
        """
        pos, mat = root_pos, root_mat
        moved = qpos[:, self.columns] - self._zeros
        sin, cos = np.sin(moved)[:, :, None, None], np.cos(moved)[:, :, None, None]
        turns = self._turns + sin * self._sines + (1.0 - cos) * self._versines
        anchors: list[F64] = []
        axes: list[F64] = []
        for number, joint in enumerate(self._joints):
            lines = matmul(mat, joint.lines)
            pos, axis = pos + lines[:, :, 0], lines[:, :, 1]
            before, mat = mat, matmul(mat, turns[:, number])
            anchor = pos
            if joint.slides:
                pos = pos + axis * moved[:, number, None]
            elif joint.anchor is not None:
                anchor = pos + apply(matmul(before, joint.turn), joint.anchor)
                pos = anchor - apply(mat, joint.anchor)
            anchors.append(anchor)
            axes.append(axis)
        offset, turn = self._tail
        where = pos + apply(mat, offset)
        return Posture(where, matmul(mat, turn), np.array(anchors), np.array(axes))


def _constants(model: Any, joint: int, addresses: dict[int, int], offset: F64, turn: F64) -> _Joint:
    kind, address = int(model.jnt_type[joint]), int(model.jnt_qposadr[joint])
    if kind not in (_SLIDE, _HINGE) or address not in addresses:
        raise ValueError("a chain may hold hinge and slide joints only")
    x, y, z = axis = np.array(model.jnt_axis[joint], np.float64)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    if kind == _SLIDE:
        cross = np.zeros((3, 3))
    anchor = np.array(model.jnt_pos[joint], np.float64)
    return _Joint(
        lines=np.stack([offset, apply(turn, axis)], axis=1),
        turn=turn,
        sine=matmul(turn, cross),
        versine=matmul(turn, matmul(cross, cross)),
        anchor=anchor if anchor.any() else None,
        slides=kind == _SLIDE,
        column=addresses[address],
        zero=float(model.qpos0[address]),
    )


def tool_links(entity: ResolvedEntity) -> list[int]:
    """The link that acts, as an index; several or none where that cannot be told.

    It is the tool point that the robot's `solver_cfg` gives the picked control part (without one,
    the whole robot), else the farthest link that all picked joints move.
    """
    parsed, parts = entity.asset.parsed, entity.control_parts or ("default",)
    tool = parsed.tools.get(parts[0]) if len(parts) == 1 else None
    if tool is not None:
        return [parsed.link_names.index(tool)]
    return links_below(entity.asset, entity.joint_ids)


def links_below(asset: Any, joints: Sequence[int]) -> list[int]:
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
