"""`FrameReads`: poses and velocities of an articulation's links, sites and geoms."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from embodichain.lab.sim.objects.entity import BatchEntity
from embodichain.lab.sim.reads.frames import BodyFrames, frame_named
from embodichain.utils.arrays import to_tensor
from embodichain.utils.math import pose_to_matrix
from embodichain.utils.suggest import did_you_mean, listing

if TYPE_CHECKING:
    import torch

    from embodichain.lab.sim.compiler.index import Ids
    from embodichain.lab.sim.compiler.robot.parsed_articulation import ParsedArticulation
    from embodichain.utils.array_types import Floats

__all__ = ["FrameReads"]


class FrameReads(BatchEntity):
    """An entity with links, and with sites and geoms on them.

    Attributes:
        parsed: Its file.
        link_names: (L,) parents before children.
    """

    parsed: ParsedArticulation
    link_names: list[str]

    def body_of(self, link: str | None) -> int:
        """MuJoCo body id of a link; None is the root link."""
        raise NotImplementedError

    def _bodies_of(self, links: Sequence[str] | None) -> Ids:
        return np.asarray([self.body_of(link) for link in links or self.link_names], np.int64)

    def pose_of(self, bodies: int | Ids) -> Floats:
        """(N, 7) x, y, z, qw, qx, qy, qz of a body (MuJoCo's id), or (N, k, 7) of k bodies."""
        pos = self.engine.derived("xpos")[:, bodies]
        return np.concatenate([pos, self.engine.derived("xquat")[:, bodies]], axis=-1)

    def velocity_of(self, bodies: int | Ids) -> Floats:
        """(N, 6) linear velocity of a body's origin, then angular, world axes; or (N, k, 6)."""
        frames = BodyFrames("link", bodies, bodies)
        return np.concatenate(frames.velocities(self.engine), axis=-1)

    def get_link_pose(
        self, link_name: str, env_ids: Any = None, to_matrix: bool = False
    ) -> torch.Tensor:
        """Pose of a link in the environment's frame, (n, 7) or (n, 4, 4)."""
        pose = self.pose_of(self.body_of(link_name))[self._rows(env_ids)]
        return to_tensor(pose_to_matrix(pose) if to_matrix else pose)

    def get_link_vel(self, link_name: str, env_ids: Any = None) -> torch.Tensor:
        """(n, 6) linear velocity of the link's origin, then angular velocity, world axes."""
        return to_tensor(self.velocity_of(self.body_of(link_name))[self._rows(env_ids)])

    def frame_of(self, kind: Literal["site", "geom"], name: str) -> BodyFrames:
        """A site or geom of the file, in the compiled scene.

        Raises:
            ValueError: If there is none of this name; lists them.
        """
        names = self.parsed.site_names if kind == "site" else self.parsed.geom_names
        alias = self.parsed.aliases.get(name)
        if alias is not None and alias.kind == kind and len(alias.frames) == 1:
            name = alias.frames[0]
        if name not in names:
            choices = f"{listing(names, name)}.{did_you_mean(name, names)}"
            raise ValueError(f"{self.uid} has no {kind} {name!r}; there are: {choices}")
        return frame_named(self.engine.model, kind, f"{self.uid}/{name}")

    def get_site_pose(
        self, site_name: str, env_ids: Any = None, to_matrix: bool = False
    ) -> torch.Tensor:
        """Pose of a site in the environment's frame, (n, 7) or (n, 4, 4)."""
        return self._frame_pose(self.frame_of("site", site_name), env_ids, to_matrix)

    def get_site_vel(self, site_name: str, env_ids: Any = None) -> torch.Tensor:
        """(n, 6) linear velocity of a site's origin, then angular velocity, world axes."""
        return self._frame_vel(self.frame_of("site", site_name), env_ids)

    def get_geom_pose(
        self, geom_name: str, env_ids: Any = None, to_matrix: bool = False
    ) -> torch.Tensor:
        """Pose of a geom in the environment's frame, (n, 7) or (n, 4, 4)."""
        return self._frame_pose(self.frame_of("geom", geom_name), env_ids, to_matrix)

    def get_geom_vel(self, geom_name: str, env_ids: Any = None) -> torch.Tensor:
        """(n, 6) linear velocity of a geom's origin, then angular velocity, world axes."""
        return self._frame_vel(self.frame_of("geom", geom_name), env_ids)

    def _frame_pose(self, frame: BodyFrames, env_ids: Any, to_matrix: bool) -> torch.Tensor:
        engine = self.engine
        pose = np.concatenate([frame.positions(engine), frame.orientations(engine)], axis=1)
        pose = pose[self._rows(env_ids)]
        return to_tensor(pose_to_matrix(pose) if to_matrix else pose)

    def _frame_vel(self, frame: BodyFrames, env_ids: Any) -> torch.Tensor:
        velocity = np.concatenate(frame.velocities(self.engine), axis=1)
        return to_tensor(velocity[self._rows(env_ids)])
