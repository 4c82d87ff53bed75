"""`Solid`: volume and moments of inertia of a primitive shape at other sizes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from embodichain.utils.array_types import Floats

__all__ = ["Solid"]

_GEOM = mujoco.mjtGeom
_NAMES = {
    int(_GEOM.mjGEOM_BOX): "box",
    int(_GEOM.mjGEOM_SPHERE): "sphere",
    int(_GEOM.mjGEOM_ELLIPSOID): "ellipsoid",
    int(_GEOM.mjGEOM_CYLINDER): "cylinder",
    int(_GEOM.mjGEOM_CAPSULE): "capsule",
}


@dataclass(frozen=True, eq=False)
class Solid:
    """One primitive geom.

    Attributes:
        uid: The entity it belongs to.
        kind: ``box``, ``sphere``, ``ellipsoid``, ``cylinder`` or ``capsule``.
        geom: Its id in the model.
        size: (3,) its compiled half sizes in metres, as MuJoCo's `geom_size`.
        axes: (3,) index of the geom axis parallel to each principal axis of the body.
    """

    uid: str
    kind: str
    geom: int
    size: Floats
    axes: NDArray[np.int64]

    @staticmethod
    def of(uid: str, model: mujoco.MjModel, geom: int) -> Solid:
        """The shape of a geom.

        Raises:
            ValueError: If its size cannot differ between environments.
        """
        kind = _NAMES.get(int(model.geom_type[geom]))
        if kind is None:
            what = _GEOM(int(model.geom_type[geom])).name.removeprefix("mjGEOM_").lower()
            raise ValueError(
                f"{uid} is a {what}, whose size is compiled into the model's assets: only "
                f"{', '.join(_NAMES.values())} have a size per environment"
            )
        principal_axes = np.zeros(9)
        geom_axes = np.zeros(9)
        mujoco.mju_quat2Mat(principal_axes, model.body_iquat[model.geom_bodyid[geom]])
        mujoco.mju_quat2Mat(geom_axes, model.geom_quat[geom])
        cosines = np.abs(principal_axes.reshape(3, 3).T @ geom_axes.reshape(3, 3))
        return Solid(
            uid=uid,
            kind=kind,
            geom=geom,
            size=model.geom_size[geom].copy(),
            axes=cosines.argmax(axis=1),
        )

    @property
    def equal_axes(self) -> tuple[int, ...]:
        """Axes that must have equal scales to keep the kind of shape."""
        if self.kind == "sphere":
            return (0, 1, 2)
        if self.kind in ("cylinder", "capsule"):
            return (0, 1)
        return ()

    def check(self, scale: Floats) -> None:
        """Check that scales (n, 3) are positive and keep the kind of shape.

        Raises:
            ValueError: If they do not.
        """
        if not (scale > 0).all():
            raise ValueError(f"{self.uid}: scales must be positive, got {scale.min()}")
        equal = list(self.equal_axes)
        if equal and (scale[:, equal] != scale[:, equal[:1]]).any():
            axes = ", ".join("xyz"[axis] for axis in equal)
            raise ValueError(f"{self.uid}: a {self.kind} scales equally along {axes}")

    def scaled(self, scale: Floats) -> tuple[Floats, Floats, Floats]:
        """Sizes (n, 3); ratios to the compiled volume (n,) and moments at equal mass (n, 3).

        Args:
            scale: (n, 3) factors along the geom's axes.
        """
        if self.kind in ("box", "ellipsoid"):
            size = self.size * scale
        elif self.kind == "sphere":
            size = self.size * scale[:, :1]
        else:
            size = self.size * scale[:, [0, 2, 2]]
        volume = _volume(self.kind, size) / _volume(self.kind, self.size[None])
        moments = _moments(self.kind, size) / _moments(self.kind, self.size[None])
        return size, volume, moments[:, self.axes]


def _volume(kind: str, size: Floats) -> Floats:
    """Volume (n,), up to a constant factor."""
    a, b, c = size.T
    if kind == "sphere":
        return a * a * a
    if kind == "cylinder":
        return a * a * b
    if kind == "capsule":
        return a * a * (2.0 * b + 4.0 / 3.0 * a)
    return a * b * c


def _moments(kind: str, size: Floats) -> Floats:
    """Moments of inertia (n, 3) about the geom's axes per mass, up to a constant factor."""
    a, b, c = size.T
    if kind == "sphere":
        x = a * a
        return np.stack([x, x, x], axis=1)
    if kind == "cylinder":
        x = (3.0 * a * a + 4.0 * b * b) / 12.0
        z = 0.5 * a * a
        return np.stack([x, x, z], axis=1)
    if kind == "capsule":
        # Shares of mass of the two half balls at its ends, and of the tube between.
        ball = 4.0 / 3.0 * a / (2.0 * b + 4.0 / 3.0 * a)
        tube = 1.0 - ball
        tube_x = tube * (3.0 * a * a + 4.0 * b * b) / 12.0
        ball_x = ball * (0.4 * a * a + b * b + 0.75 * a * b)
        x = tube_x + ball_x
        z = tube * 0.5 * a * a + ball * 0.4 * a * a
        return np.stack([x, x, z], axis=1)
    return np.stack([b * b + c * c, a * a + c * c, a * a + b * b], axis=1)
