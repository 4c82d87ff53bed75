import numpy as np
import pytest

from embodichain.recording.viewers import native
from embodichain.utils.errors import RenderError
from tests.recording.scene import SmallEnv


class Window:
    """Stands for MuJoCo's window, which needs a display."""

    def __init__(self, engine, env_id):
        self.shown, self.is_running, self.engine, self.env_id = [], True, engine, env_id

    def sync(self):
        self.shown.append(self.engine.rows[self.env_id].tobytes())

    def close(self):
        self.is_running = False


@pytest.fixture
def view(monkeypatch):
    monkeypatch.setattr(native, "NativeViewer", Window)
    env = SmallEnv()
    view = native.NativeView(env, env_id=1, fps=1e9, realtime=False)
    env.add_observer(view)
    return env, view


def test_without_a_display_it_says_so(monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(RenderError, match="no display"):
        native.NativeView(SmallEnv())


def test_it_shows_every_reset_and_step_and_changes_nothing(view):
    env, shown = view
    plain = SmallEnv()
    for e in (env, plain):
        e.reset()
        for _ in range(3):
            e.step()
    assert len(shown._window.shown) == 4
    assert shown._window.shown[-1] == env.sim.engine.rows[1].tobytes()
    assert np.array_equal(env.sim.engine.rows, plain.sim.engine.rows)


def test_a_closed_window_stays_closed(view):
    env, shown = view
    env.reset()
    shown._window.is_running = False
    assert not shown.is_open
    env.step()
    assert len(shown._window.shown) == 1
