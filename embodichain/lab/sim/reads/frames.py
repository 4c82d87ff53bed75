"""`BodyFrames`: frames fixed on bodies, which are bodies, sites or geoms of the compiled model.

Positions are MuJoCo's `xpos`, `site_xpos` and `geom_xpos`. Velocities are those of the point of the
body that is there. Nothing is stored: each read is of the engine's current state and model, which
may differ between environments.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from embodichain.utils.arrays import columns_of
from embodichain.utils.math import cross, quat_multiply

if TYPE_CHECKING:
    import mujoco

    from embodichain.lab.sim.compiler.names import FrameKind
    from embodichain.lab.sim.engine.api import Engine
    from embodichain.utils.array_types import Floats

__all__ = ["BodyFrames", "frame_named", "frames_named", "link_frame", "point_velocities"]


@dataclass(frozen=True)
class BodyFrames:
    """One frame, or B frames of one kind.

    Shapes below are of B frames; of one frame they lack that axis.

    Attributes:
        kind: Whether the ids are of bodies, sites or geoms.
        ids: MuJoCo's ids: (B,), a slice of them, or one.
        bodies: MuJoCo's ids of the bodies that carry them, likewise.
    """

    kind: FrameKind
    ids: Any
    bodies: Any

    @property
    def position_field(self) -> str:
        """MuJoCo's field of positions of this kind."""
        return "xpos" if self.kind == "link" else f"{self.kind}_xpos"

    def positions(self, engine: Engine) -> Floats:
        """(N, B, 3) metres, environment's frame: do not write or store."""
        return engine.derived(self.position_field)[:, self.ids]

    def orientations(self, engine: Engine) -> Floats:
        """(N, B, 4) wxyz: do not write or store."""
        of_bodies = engine.derived("xquat")[:, self.bodies]
        if self.kind == "link":
            return of_bodies
        on_bodies = engine.model_values(f"{self.kind}_quat")[:, self.ids]
        return quat_multiply(of_bodies, on_bodies)

    def axes(self, engine: Engine) -> Floats:
        """(N, B, 3, 3) rotation matrices: do not write or store."""
        field = "xmat" if self.kind == "link" else f"{self.kind}_xmat"
        return engine.derived(field).reshape(engine.num_envs, -1, 3, 3)[:, self.ids]

    def velocities(self, engine: Engine) -> tuple[Floats, Floats]:
        """(N, B, 3) m/s of the origins and (N, B, 3) rad/s, world axes."""
        return point_velocities(engine, self.bodies, self.positions(engine))


def link_frame(body: int) -> BodyFrames:
    """The frame of a body."""
    return BodyFrames("link", body, body)


def frame_named(model: mujoco.MjModel, kind: FrameKind, name: str) -> BodyFrames:
    """The frame with a name in the model."""
    if kind == "link":
        return link_frame(int(model.body(name).id))
    element = model.site(name) if kind == "site" else model.geom(name)
    return BodyFrames(kind, int(element.id), int(element.bodyid[0]))


def frames_named(model: mujoco.MjModel, kind: FrameKind, names: Sequence[str]) -> BodyFrames:
    """The frames with B names in the model."""
    frames = [frame_named(model, kind, name) for name in names]
    ids = columns_of([frame.ids for frame in frames])
    bodies = np.asarray([frame.bodies for frame in frames], np.int64)
    return BodyFrames(kind, ids, bodies)


def point_velocities(engine: Engine, bodies: Any, points: Floats) -> tuple[Floats, Floats]:
    """Velocities of points fixed on bodies, world axes.

    MuJoCo's `cvel` is (angular, linear) at the centre of mass of the kinematic tree; moved to a
    point by v = v_com + w x (point - com).

    Args:
        engine: The engine.
        bodies: B ids of bodies, a slice, or one id.
        points: (N, B, 3) metres; (N, 3) of one body.

    Returns:
        Linear in m/s and angular in rad/s, (N, B, 3) each; (N, 3) of one id.
    """
    roots = engine.model.body_rootid[bodies].astype(np.int64)
    cvel = engine.derived("cvel")[:, bodies]
    arm = points - engine.derived("subtree_com")[:, roots]
    angular = cvel[..., :3]
    return cvel[..., 3:] + cross(angular, arm), angular
