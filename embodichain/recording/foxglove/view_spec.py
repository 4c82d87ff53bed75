"""`ViewSpec`: what is said once about the environments that people look at.

It is plain data: whoever encodes their messages may be in another process.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

from embodichain.recording.shapes import PLANE_SIZE

__all__ = ["MarkerSpec", "Topics", "ViewSpec"]


class Topics(NamedTuple):
    """The channels of one environment."""

    scene: str
    joints: str
    markers: str
    metrics: str

    @classmethod
    def of(cls, env_id: int) -> Topics:
        """Those of this environment."""
        return cls(*(f"/env_{env_id}/{n}" for n in ("scene", "joint_states", "markers", "metrics")))


@dataclass(frozen=True, slots=True)
class MarkerSpec:
    """A command that is drawn.

    Attributes:
        name: The command's.
        kind: What its columns are, as in `CommandMarker`.
        body: Id of the body.
    """

    name: str
    kind: Literal["pose", "velocity"]
    body: int


@dataclass(frozen=True, slots=True)
class ViewSpec:
    """Which environments are viewed, and how.

    Attributes:
        env_ids: Sorted.
        offsets: Where each stands in ``world``, metres.
        ground: Metres that an infinite plane is drawn wide.
        markers: Commands that are drawn in each.
        every: Control steps from one sample to the next, where rows are not pushed because whoever
            makes the messages knows those of every step; else 0.
        period_ns: Simulated time from one sample to the next.
    """

    env_ids: tuple[int, ...] = ()
    offsets: tuple[tuple[float, float, float], ...] = ()
    ground: float = PLANE_SIZE
    markers: tuple[MarkerSpec, ...] = ()
    every: int = 0
    period_ns: int = 0

    @property
    def channels(self) -> dict[str, str]:
        """Schemas by topic of all channels but the metrics', which the first step tells."""
        found = {"/log": "foxglove.Log"}
        if self.env_ids:
            found["/tf"] = "foxglove.FrameTransforms"
        for topics in map(Topics.of, self.env_ids):
            found[topics.scene] = "foxglove.SceneUpdate"
            found[topics.joints] = "foxglove.JointStates"
            if self.markers:
                found[topics.markers] = "foxglove.SceneUpdate"
        return found
