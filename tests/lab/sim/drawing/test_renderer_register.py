"""Renderers of packages: they draw where they are named, and only what they say they can."""

from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np
import pytest

from embodichain.lab.sim.drawing.gl import VARIABLE
from embodichain.lab.sim.drawing.offscreen import OffscreenRenderer, need_colors
from embodichain.lab.sim.drawing.renderer_register import RENDERERS, renderer
from embodichain.lab.sim.drawing.states import DataState
from embodichain.lab.sim.drawing.views import View, Viewpoint, view_of
from embodichain.utils.errors import RenderError

BALL = "<mujoco><worldbody><light pos='0 0 3'/><geom size='.1'/></worldbody></mujoco>"


class Depths:
    """A renderer of depth alone, everywhere 1 m."""

    about = "one metre"

    def draw(self, state: Any, views: list[View], envs: Any = None) -> list[dict[str, Any]]:
        sizes = [(state.num_envs, view.optics.height, view.optics.width) for view in views]
        return [{"depth": np.ones(size, np.float32)} for size in sizes]

    def close(self) -> None:
        pass


@pytest.fixture(autouse=True)
def register(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A register that forgets what a test adds: it has no method for that, as nothing else asks."""
    assert "rays" in RENDERERS
    monkeypatch.setattr(RENDERERS, "_members", dict(RENDERERS.items()))
    monkeypatch.setattr(RENDERERS, "_places", dict(RENDERERS._places))

    @renderer("depths", outputs=("depth",))
    def open_depths(model: mujoco.MjModel) -> Any:
        return Depths()

    yield


@pytest.fixture
def state() -> DataState:
    model = mujoco.MjModel.from_xml_string(BALL)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return DataState(data)


def view(state: DataState, *outputs: Any) -> View:
    viewpoint = Viewpoint.look_at((0.4, -0.4, 0.4), (0.0, 0.0, 0.0))
    return view_of(state, viewpoint, 8, 6, outputs=outputs)


def test_a_named_renderer_draws(state: DataState, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, "depths")
    drawing = OffscreenRenderer(state.model)
    assert (drawing.kind, drawing.about, drawing.outputs) == ("depths", "one metre", ("depth",))
    (pictures,) = drawing.draw(state, [view(state, "depth")])
    assert pictures["depth"].shape == (1, 6, 8) and (pictures["depth"] == 1.0).all()
    with pytest.raises(RenderError, match="'depths' draws depth only, not mask: unset EMBODI"):
        drawing.draw(state, [view(state, "depth"), view(state, "mask")])
    colours = "colours need OpenGL, and the renderer 'depths' draws .*EMBODI.* is 'depths': unset"
    with pytest.raises(RenderError, match=colours):
        drawing.draw(state, [view(state, "color")])
    drawing.close()
    with pytest.raises(RenderError, match="video: colours need OpenGL"):
        need_colors("video")


def test_a_renderer_that_is_not_named_is_not_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(VARIABLE, raising=False)
    monkeypatch.setenv("MUJOCO_GL", "disable")
    drawing = OffscreenRenderer(mujoco.MjModel.from_xml_string(BALL))
    assert drawing.kind == "rays"
    drawing.close()


def test_a_renderer_without_outputs_is_refused() -> None:
    with pytest.raises(ValueError, match="'blind' draws nothing"):
        renderer("blind", outputs=())
