"""Distances of a link from a commanded pose, plain and through the tanh kernel.

A pose command is (N, 7): x, y, z in metres and a wxyz quaternion, in the frame of the robot's root.
For the plain error of a position three columns are enough.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from embodichain.lab.gym.envs.managers.param_types import Positive
from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.mdp import _body, _kernels, _spatial
from embodichain.lab.gym.envs.mdp._commands import columns
from embodichain.lab.gym.envs.mdp._judge import Judge
from embodichain.utils.math import quat_multiply, quat_rotate

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import F64

__all__ = ["OrientationCommandError", "PositionCommandError", "PositionCommandErrorTanh"]


@register_term("reward", "metric", name="position_command_error")
class PositionCommandError(Judge):
    """Metres between a link and the commanded position: give it a negative weight.

    Isaac Lab's reward of the same name.

    Args:
        entity_cfg: The robot and one link of it.
        command_name: A command whose first three columns are x, y, z in the root's frame, metres.

    Example:
        ``{func: position_command_error, weight: -0.2, params: {entity_cfg: {uid: ur10, link_names: [ee_link]}, command_name: pose}}``
    """  # noqa: E501  (an example is one line)

    def __init__(self, env: TermContext, entity_cfg: ResolvedEntity, command_name: str) -> None:
        self._entity = entity_cfg
        self._command = columns(env, command_name, 3)

    def value(self) -> F64:
        """(N,) m."""
        root, turned = self._entity.asset.read_pose()
        wanted = root + quat_rotate(turned, self._command()[:, :3])
        return _spatial.norm(wanted - _spatial.position(self._entity))


@register_term("reward", "metric", name="position_command_error_tanh")
class PositionCommandErrorTanh(PositionCommandError):
    """1 - tanh(d / std) of `position_command_error`. Isaac Lab's reward of the same name.

    Args:
        entity_cfg: The robot and one link of it.
        command_name: A command whose first three columns are x, y, z in the root's frame, metres.
        std: Metres: where the value has fallen to 0.24.

    Example:
        ``{func: position_command_error_tanh, weight: 0.1, params: {entity_cfg: {uid: ur10, link_names: [ee_link]}, command_name: pose, std: 0.1}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self, env: TermContext, entity_cfg: ResolvedEntity, command_name: str, std: Positive
    ) -> None:
        super().__init__(env, entity_cfg, command_name)
        self._std = std

    def value(self) -> F64:
        """(N,) in (0, 1]."""
        return _kernels.tanh_kernel(super().value(), self._std)


@register_term("reward", "metric", name="orientation_command_error")
class OrientationCommandError(Judge):
    """Radians in [0, pi] between a link and the commanded orientation: weigh it negatively.

    Isaac Lab's reward of the same name.

    Args:
        entity_cfg: The robot and one link of it.
        command_name: A command (N, 7); columns 3 to 6 are a wxyz quaternion in the root's frame.

    Example:
        ``{func: orientation_command_error, weight: -0.1, params: {entity_cfg: {uid: ur10, link_names: [ee_link]}, command_name: pose}}``
    """  # noqa: E501  (an example is one line)

    def __init__(self, env: TermContext, entity_cfg: ResolvedEntity, command_name: str) -> None:
        self._entity = entity_cfg
        self._command = columns(env, command_name, 7)

    def value(self) -> F64:
        """(N,) rad."""
        wanted = quat_multiply(self._entity.asset.read_pose()[1], self._command()[:, 3:7])
        return _body.angle_between(_body.orientation(self._entity), wanted)
