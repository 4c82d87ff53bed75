"""`Panel`: the window with the controls on the page of `viewer=web`.

It is drawn in the viewer's thread. Importing it imports MuJoCo Studio.
"""

from __future__ import annotations

import dataclasses
from collections import deque
from typing import Any

from mujoco.studio import messages, plugin, ux
from mujoco.studio.dear_imgui import dear_imgui as imgui
from mujoco.studio.implot import implot

from embodichain.recording.viewers.controls import SPEEDS, Facts, Setup

__all__ = ["Panel"]

_WIDTH, _HEIGHT, _MARGIN = 330.0, 640.0, 8.0
_BUTTON = imgui.Vec2(70.0, 0.0)
_KEPT = 400


class Panel(plugin.ViewerPlugin):  # type: ignore[misc]
    """Choose the environment, pause, step, reset, speed; rewards per term; how it is drawn.

    Args:
        setup: How it begins.

    Attributes:
        controls: Replaced as a whole, in the viewer's thread and by `leave`.
    """

    def __init__(self, setup: Setup) -> None:
        self._setup = setup
        self.controls = setup.controls
        self._facts: Facts | None = None
        self._history: deque[Facts] = deque(maxlen=_KEPT)
        self._camera = ux.UxState()
        self._open = True

    def tell(self, facts: Facts) -> None:
        """Show a step."""
        self._facts = facts
        self._history.append(facts)

    def leave(self) -> None:
        """End a pause: no browser has the panel."""
        self._change(paused=False)

    # -- asked for -------------------------------------------------------------------------------

    def choose(self, env_id: int) -> None:
        """Show another environment."""
        chosen = min(max(env_id, 0), self._setup.num_envs - 1)
        if chosen != self.controls.env_id:
            self._history.clear()
            self._change(env_id=chosen)

    def pause(self) -> None:
        """Wait, or go on."""
        self._change(paused=not self.controls.paused)

    def step(self) -> None:
        """Take one step, and wait."""
        self._change(paused=True, steps=self.controls.steps + self.controls.paused)

    def reset(self) -> None:
        """End the episode of the environment that is shown."""
        if self._setup.can_reset:
            self._change(resets=self.controls.resets + 1, reset_env=self.controls.env_id)

    def _change(self, **changed: Any) -> None:
        self.controls = dataclasses.replace(self.controls, **changed)

    # -- drawn -----------------------------------------------------------------------------------

    @messages.handler(priority=messages.Priority.CRITICAL)  # type: ignore[untyped-decorator]
    def _on_init(self, _: plugin.ViewerInitEvent) -> None:
        ux.setup_theme(ux.GuiTheme.DARK)
        self._camera.camera_index = ux.set_camera(
            self.viewer.model, self.viewer.camera, ux.TUMBLE_CAMERA_IDX
        )

    @messages.handler  # type: ignore[untyped-decorator]
    def _on_update(self, _: messages.UpdateEvent) -> None:
        if imgui.GetIO().WantCaptureKeyboard:
            return
        if imgui.IsKeyChordPressed(imgui.Key.Space):
            self.pause()
        elif imgui.IsKeyChordPressed(imgui.Key.RightArrow):
            self.step()
        elif imgui.IsKeyChordPressed(imgui.Key.Backspace):
            self.reset()
        elif imgui.IsKeyChordPressed(imgui.Key.P):
            self._open = not self._open

    @messages.handler  # type: ignore[untyped-decorator]
    def _on_build_gui(self, _: messages.BuildGuiEvent) -> None:
        self.viewer.camera_index = self._camera.camera_index
        if not self._open:
            return
        imgui.SetNextWindowPos(imgui.Vec2(_MARGIN, _MARGIN), int(imgui.Cond.FirstUseEver))
        imgui.SetNextWindowSize(imgui.Vec2(_WIDTH, _HEIGHT), int(imgui.Cond.FirstUseEver))
        expanded, self._open = imgui.Begin(self._setup.title, self._open)
        if expanded:
            self._draw_controls()
            if self._facts is not None:
                _draw_facts(self._facts)
                _draw_rewards(self._facts, list(self._history))
            self._draw_looks()
        imgui.End()

    def _draw_controls(self) -> None:
        if self._setup.num_envs > 1:
            changed, chosen = imgui.InputInt("environment", self.controls.env_id)
            if changed:
                self.choose(chosen)
        if imgui.Button("Go on" if self.controls.paused else "Pause", _BUTTON):
            self.pause()
        imgui.SetItemTooltip("Space")
        imgui.SameLine()
        if imgui.Button("Step", _BUTTON):
            self.step()
        imgui.SetItemTooltip("Right arrow: one control step, then a pause")
        imgui.SameLine()
        imgui.BeginDisabled(not self._setup.can_reset)
        if imgui.Button("Reset", _BUTTON):
            self.reset()
        imgui.EndDisabled()
        imgui.SetItemTooltip("Backspace: this environment's episode ends, as truncated")
        names = ["as fast as it goes", *(f"{speed:g} x real time" for speed in SPEEDS if speed)]
        changed, chosen = imgui.Combo("speed", SPEEDS.index(self.controls.speed), names)
        if changed:
            self._change(speed=SPEEDS[chosen])

    def _draw_looks(self) -> None:
        """Studio's own widgets: cameras, and what is drawn."""
        viewer = self.viewer
        if not imgui.CollapsingHeader("View"):
            return
        ux.camera_selection_gui(viewer.model, viewer.data, viewer.camera, self._camera)
        if imgui.TreeNodeEx("Rendering"):
            ux.rendering_gui(viewer.model, viewer.vis_options, viewer.render_flags)
            imgui.TreePop()
        if imgui.TreeNodeEx("Groups"):
            ux.groups_gui(viewer.model, viewer.vis_options)
            imgui.TreePop()
        if imgui.TreeNodeEx("Visualization"):
            ux.visualization_gui(viewer.model, viewer.vis_options, viewer.camera)
            imgui.TreePop()


def _draw_facts(facts: Facts) -> None:
    imgui.TextUnformatted(f"step {facts.step}   {facts.seconds:.2f} s of the episode")
    for name, text in facts.lines:
        imgui.TextUnformatted(f"{name} {text}")


def _draw_rewards(facts: Facts, history: list[Facts]) -> None:
    """A table of terms, and how they went."""
    if not facts.rewards:
        return
    imgui.SeparatorText("Rewards per term")
    flags = int(imgui.TableFlags.RowBg) | int(imgui.TableFlags.SizingStretchProp)
    if imgui.BeginTable("rewards", 3, flags):
        for name in ("term", "step", "episode"):
            imgui.TableSetupColumn(name)
        imgui.TableHeadersRow()
        for name, value in facts.rewards.items():
            imgui.TableNextRow()
            for text in (name, f"{value:+.4g}", f"{facts.sums.get(name, 0.0):+.4g}"):
                imgui.TableNextColumn()
                imgui.TextUnformatted(text)
        imgui.EndTable()
    implot.SetNextAxesToFit()
    if implot.BeginPlot("##rewards", imgui.Vec2(-1.0, 180.0)):
        implot.SetupAxes("control step", "")
        steps = [past.step for past in history]
        for name in facts.rewards:
            implot.PlotLine(name, steps, [past.rewards.get(name, 0.0) for past in history])
        implot.EndPlot()
