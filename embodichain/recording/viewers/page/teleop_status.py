"""`TeleopStatus`: the state that an operator reads; `PageOperator`, the operator at a web page."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from embodichain.lab.gym.teleop import DISCARDED, Teleop, ToolCommand

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.observers import ObservedEnv, StepRecord
    from embodichain.recording.viewers.page.web_page import WebPage

__all__ = ["PageOperator", "TeleopStatus"]


class PageOperator:
    """An `Operator` at a web page.

    Args:
        page: The page.
        show: Shows the present state on it.
    """

    def __init__(self, page: WebPage, show: Callable[[], None]) -> None:
        self._page = page
        self._show = show

    def command(self, begins: bool) -> ToolCommand:
        """Return the present command; waits until a page operates, see `Operator`."""
        self._page.wait_for_operator(self._show)
        if begins:
            before = self._page.command
            self._page.wait_for_operator(self._show, lambda: self._page.command != before)
        return self._page.command


class TeleopStatus:
    """Poses and progress of an episode, in plain values.

    Args:
        env: The environment; it has one.
        teleop: Its policy, bound to it.
    """

    def __init__(self, env: ObservedEnv, teleop: Teleop) -> None:
        self._env = env
        self._teleop = teleop
        self._episode = -1
        self._step = 0
        self._success = False
        self._last_ending = ""

    def begin(self) -> None:
        """Count an episode that begins."""
        self._episode += 1
        self._step = 0
        self._success = False

    def note(self, step: StepRecord) -> None:
        """Note the result of a step."""
        success = bool(step.info["success"].numpy(force=True)[0])
        if not (step.terminated[0] or step.truncated[0]):
            self._step = int(step.info["elapsed_steps"].numpy(force=True)[0])
            self._success = success
            return
        if DISCARDED in self._teleop.failures:
            ending = "discarded"
        elif success:
            ending = "success"
        else:
            ending = "no success"
        self._last_ending = f"episode {int(step.episode_ids[0])}: {ending}"

    def status(self) -> dict[str, Any]:
        """The present status.

        Returns:
            ``tool``: x, y, z, qw, qx, qy, qz of the active tool; ``objects``: name to the same;
            ``tools``, ``active``: names of the tools, and which one moves; ``open``: whether its
            gripper is set to open, or None; ``axes``; ``episode``, ``step``, ``max_steps``,
            ``seconds``, ``success`` of the present episode, ``last``: how the last one ended.
        """
        teleop = self._teleop
        sim = self._env.sim
        poses = {}
        for uid, body in sim.rigid_objects.items():
            if body.cfg.body_type != "static":
                poses[uid] = body.get_local_pose()[0].tolist()
        for uid, articulation in sim.articulations.items():
            poses[uid] = articulation.get_local_pose()[0].tolist()
        return {
            "tool": np.concatenate(teleop.tool_pose()).tolist(),
            "objects": poses,
            "tools": teleop.tool_names,
            "active": teleop.active,
            "open": teleop.is_open,
            "axes": teleop.axes,
            "episode": self._episode,
            "step": self._step,
            "max_steps": teleop.max_steps,
            "seconds": self._step * self._env.step_dt,
            "success": self._success,
            "last": self._last_ending,
        }
