"""What a viewer is: `viewer` registers one, `Viewing` is what it shows.

A viewer is a function that shows a running environment::

    @viewer("ticker")
    def show(viewing: Viewing) -> None:
        viewing.env.add_observer(Ticker())

A package outside names its module with an entry point of the group ``embodichain.viewers``, called
as the viewer, which is then an option of the group `viewer` too.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, TypeVar

from embodichain.config.keys.viewers import NO_VIEWER, VIEWERS

if TYPE_CHECKING:
    from embodichain.config.keys.schema import ViewerCfg
    from embodichain.lab.gym.envs.base_env import BaseEnv
    from embodichain.lab.gym.teleop import Teleop
    from embodichain.recording.format.options import ImageOptions
    from embodichain.recording.viewers.web import WebView
    from embodichain.utils.system.access import Access

__all__ = ["Audience", "Show", "Shown", "Viewer", "Viewing", "viewer"]


@dataclass(frozen=True)
class Viewing:
    """What a viewer shows, and how.

    Attributes:
        env: The running environment; a viewer attaches itself with `env.add_observer`.
        cfg: The config's section `viewer`.
        access: Who may use the viewer, if it is a server.
        stopped: Whether the run was stopped, which ends a pause.
        realtime: Whether the run starts in real time while somebody looks.
        resets: Whether the viewer may end an episode.
        teleop: The policy of a person who moves the robot at the viewer, bound to `env`; or None.
        view_envs: Environments whose scenes the log contains for viewers.
        images: Pictures of cameras that the log contains; None without.
        title: The task's name, for a page's title.
    """

    env: BaseEnv
    cfg: ViewerCfg
    access: Access
    stopped: Callable[[], bool]
    realtime: bool
    resets: bool
    teleop: Teleop | None
    view_envs: Sequence[int]
    images: ImageOptions | None
    title: str = "embodichain"


@dataclass(frozen=True)
class Audience:
    """Those who look at a viewer: a command may wait for them.

    Attributes:
        is_watched: Whether somebody looks now; cheap, called after each step.
        what: What they look at, for messages: ``the page``, ``the window``.
        refresh: Shows the present state again; called several times a second while nothing steps.
        finish: Tells them that the run is over; its last state is shown until they are gone.
        may_return: Whether they may be back in a moment, as when a page is loaded again; a window
            that was closed stays closed.
    """

    is_watched: Callable[[], bool]
    what: str = "the page"
    refresh: Callable[[], None] = lambda: None
    finish: Callable[[], None] = lambda: None
    may_return: bool = True


@dataclass(frozen=True)
class Shown:
    """What a viewer has started: a server, or a window.

    Attributes:
        url: The server's address, with its token; empty if it is not a server.
        address: The address without the token, for logs.
        how: What to do with the address, if it is not a page; one sentence without its full stop.
        page: The `WebView`, if it is one.
        audience: Those who look, for whom `run` waits; None if the viewer does not know them.
    """

    url: str
    address: str
    how: str = ""
    page: WebView | None = None
    audience: Audience | None = None


class Show(Protocol):
    """Attaches a viewer to an environment; closing the environment closes it."""

    def __call__(self, viewing: Viewing) -> Shown | None:
        """Attach it; return what it has started, or None if nobody waits for it."""


@dataclass(frozen=True)
class Viewer:
    """A viewer as a config names it.

    Attributes:
        show: Attaches it.
        controls: Whether who looks may also act: pause, reset, move a robot.
        pictures: Whether it draws `Viewing.images`.
    """

    show: Show
    controls: bool = False
    pictures: bool = False


ShowFunction = TypeVar("ShowFunction", bound=Show)


def viewer(
    name: str, *, controls: bool = False, pictures: bool = False
) -> Callable[[ShowFunction], ShowFunction]:
    """Register a function ``show(viewing)`` as a viewer, see `Viewing`.

    Args:
        name: What `viewer` takes; also the name of its module and its entry point.
        controls: Whether who looks may also act: pause, reset, move a robot (`policy=teleop`).
        pictures: Whether it draws `Viewing.images`.

    Returns:
        A decorator that returns its argument.

    Raises:
        ValueError: If another function has the name, or it is ``none``.
    """
    if name == NO_VIEWER:
        raise ValueError(f"a viewer cannot be called {name!r}: that is to have none")

    def decorate(show: ShowFunction) -> ShowFunction:
        VIEWERS.add(name, describes=show)(Viewer(show, controls=controls, pictures=pictures))
        return show

    return decorate
