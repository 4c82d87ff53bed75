"""The action that sets the controls of actuators, as the robot's file defines them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from embodichain.lab.gym.envs.cfg import Names
from embodichain.lab.gym.envs.managers.param_types import Whole
from embodichain.lab.gym.envs.managers.term import ActionMeaning, ActionTerm, finite_limits
from embodichain.lab.gym.envs.managers.terms.per_name import JointClip, PerJoint
from embodichain.lab.gym.envs.managers.terms.registry import register_term
from embodichain.lab.gym.envs.mdp.actions.joint_action import Affine
from embodichain.lab.sim.compiler.names import NamedBy, match_every
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    import torch
    from numpy.typing import NDArray

    from embodichain.lab.gym.envs.managers.context import TermContext
    from embodichain.lab.sim.compiler.robot.parsed_articulation import ParsedArticulation
    from embodichain.utils.array_types import Floats

__all__ = ["ActuatorCtrl", "picked_controls"]


@register_term("action", name="actuator_ctrl")
class ActuatorCtrl(ActionTerm):
    """Controls of actuators (MuJoCo's ``ctrl``): ctrl = offset + scale x clamp(action, clip).

    One column per control, in the model's order: the actuators of an MJCF file in the file's order,
    then the drives that ``drive_pros`` adds, in joint order; an actuator with several inputs has
    several columns (``NAME.INPUT``). Targets of drives and servos respect ``max_velocity``. It is
    the default action of an MJCF robot in a task without action terms.

    Example:
        ``{func: actuator_ctrl, params: {of: {uid: ur10}, actuator_names: "Joint[1-3]"}}``

    Args:
        entity_cfg: The robot.
        actuator_names: Regexes over the names of controls; null is all of them.
        scale: Units of ctrl per unit of action: a number, a list per control, or {regex: number}.
        offset: Units of ctrl, likewise.
        clip: Bounds of the action: [low, high], a list of pairs, or {regex: [low, high]}. By
            default (range - offset) / scale with the range of each control: the file's ctrlrange,
            and for position servos and drives without one the joint's limits (+-2 pi where it has
            none).

    Raises:
        ConfigError: If a regex matches no control, joints are picked, or a control has no range and
            there is no `clip`.
    """

    def __init__(
        self,
        env: TermContext,
        entity_cfg: Whole,
        actuator_names: Names | None = None,
        scale: PerJoint = 1.0,
        offset: PerJoint = 0.0,
        clip: JointClip | None = None,
    ) -> None:
        self._period = env.step_dt
        self._asset = entity_cfg.articulation
        if not entity_cfg.is_articulation or not self._asset.parsed.control_names:
            message = f"{entity_cfg.uid!r} has no actuators"
            raise ConfigError([Problem("entity_cfg.uid", message)])
        if list(entity_cfg.joint_ids) != self._asset.active_joint_ids:
            message = "picks joints; this term picks actuators: actuator_names"
            raise ConfigError([Problem("entity_cfg", message)])
        parsed = self._asset.parsed
        self._which, named_by = picked_controls(actuator_names, parsed.control_names)
        self.names = tuple(parsed.control_names[i] for i in self._which)
        self.named_by = named_by
        self._affine = Affine(
            names=self.names,
            env=env,
            scale=scale,
            offset=offset,
            clip=clip,
            limits=self._control_ranges(parsed),
            what="actuator",
            named_by=named_by,
        )
        self.low = self._affine.low
        self.high = self._affine.high
        self._require_bounds()
        self._initial: Floats = parsed.init_ctrl[self._which]

    def _control_ranges(self, parsed: ParsedArticulation) -> tuple[Floats, Floats]:
        """Low and high of the controls, (A,) each; infinite where nothing bounds them."""
        limits: Floats = parsed.ctrl_limits.copy()
        index = self._asset.index
        joints = np.flatnonzero((index.ctrl_ids >= 0) & (parsed.stiffness > 0))
        low, high = finite_limits(parsed.qpos_limits, joints)
        # The joint's limits in units of ctrl; a negative scale turns them round.
        ends = np.sort(np.stack([low, high], axis=1) * parsed.servos.scale[joints, None], axis=1)
        controls = np.searchsorted(index.own_ctrl_ids, index.ctrl_ids[joints])
        limits[controls] = np.where(np.isfinite(limits[controls]), limits[controls], ends)
        low, high = limits[self._which].T.copy()
        return low, high

    def _require_bounds(self) -> None:
        """Refuse controls without a range that no `clip` bounds."""
        is_bounded = np.isfinite(self.low) & np.isfinite(self.high)
        if is_bounded.all():
            return
        unbounded = ", ".join(self.names[i] for i in np.flatnonzero(~is_bounded))
        message = (
            f"actuators without a ctrlrange: {unbounded}; give the bounds of the "
            "action, as in actions: {ctrl: {func: actuator_ctrl, params: {of: {uid: "
            f"{self._asset.uid}}}, clip: [-1, 1]}}}}}}, or clip: {{NAME: [-1, 1], ...}}"
        )
        raise ConfigError([Problem("clip", message)])

    def apply(self, action: torch.Tensor) -> None:
        """Write the controls of (N, A) actions."""
        controls = self._affine.value(action)
        self._asset.write_ctrl(controls, self._which, seconds=self._period)

    def centre_and_scale(self) -> tuple[Sequence[float | str], Sequence[float | str]]:
        """Of controls, in their units."""
        return self._affine.centre.tolist(), self._affine.scale.tolist()

    def meaning(self) -> ActionMeaning:
        """Controls, whose units the actuators of the file define."""
        return ActionMeaning(quantity="control", mode="absolute")

    def home(self) -> Floats:
        """(A,) the action for the initial controls, within the bounds."""
        return self._affine.action_for(self._initial)

    def hold(self) -> Floats:
        """(N, A) the action that keeps the present controls, within the bounds."""
        return self._affine.action_for(self._asset.read_ctrl()[:, self._which])


def picked_controls(
    patterns: Names | None, names: tuple[str, ...]
) -> tuple[NDArray[np.int64], tuple[NamedBy, ...]]:
    """Return the indices of the controls that regexes match in full, in the model's order.

    Returns:
        The indices, and each regex with what it matches; none if there are no patterns.

    Raises:
        ConfigError: If a regex, or an alternative in it, matches none; lists the names.
    """
    if patterns is None:
        return np.arange(len(names)), ()
    if isinstance(patterns, str):
        patterns = [patterns]
    picked: set[int] = set()
    named_by: list[NamedBy] = []
    for pattern in patterns:
        matching, problems = match_every(pattern, names, "actuator", "actuator_names")
        if problems:
            raise ConfigError(problems)
        picked.update(matching)
        matching_names = tuple(names[i] for i in matching)
        named_by.append(NamedBy("actuator_names", pattern, matching_names))
    return np.asarray(sorted(picked), np.int64), tuple(named_by)
