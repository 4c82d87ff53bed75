"""`ResolvedEntity`: the entity, joints and frames of a `SceneEntityCfg`, and their state.

`compiler.names.pick` picks joints and frames (links, sites or geoms), here and when a config is
checked. Arrays are the engine's float64 arrays. Sums run over columns in a fixed order, because the
rounding of a reduction may depend on the number of environments.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import GetCoreSchemaHandler

from embodichain.lab.gym.envs.cfg import SceneEntityCfg
from embodichain.lab.sim.reads.body_motion import BodyMotion, Frame
from embodichain.lab.sim.reads.frames import BodyFrames, frame_named, frames_named, link_frame
from embodichain.utils.arrays import columns_of, is_host
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.fields.type_errors import from_dict
from embodichain.utils.math import quat_conjugate, quat_multiply, quat_rotate

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from embodichain.lab.sim.compiler.names import FrameKind, NamedBy
    from embodichain.lab.sim.objects.articulation import Articulation
    from embodichain.lab.sim.objects.computed_effort import ComputedEfforts
    from embodichain.lab.sim.objects.rigid_object import RigidObject
    from embodichain.lab.sim.sim_manager import SimulationManager
    from embodichain.utils.array_types import Floats

__all__ = ["ResolvedEntity", "references_in", "resolve_entity"]

_HINGE = 3
"""MuJoCo's ``mjJNT_HINGE``; listing terms must not import MuJoCo."""
UNLIMITED = 1e9
"""Speeds and efforts at least this large are not limits (EmbodiChain's default is 1e10)."""


@dataclass(frozen=True, eq=False)
class ResolvedEntity:
    """An entity of the scene, its picked joints, and its picked links, sites or geoms.

    A term's parameter annotated with this class, or with `SceneEntityCfg`, receives one.

    Attributes:
        uid: The entity.
        asset: Its handle: a `Robot`, `Articulation` or `RigidObject`.
        joint_ids: Picked joints; by default all active ones (no mimic joints). Empty for rigid
            objects.
        joint_names: Names of the picked joints.
        kind: Whether frames are links, sites or geoms.
        frame_ids: Picked frames, in the entity's order of that kind; by default none, which means
            the root.
        frame_names: Names of the picked frames.
        in_model: Their names in the compiled scene.
        frame_key: The key of the reference that names them, for messages.
        control_parts: Picked control parts.
        joints_by: The entries of the reference that name joints, as written; none picks all.
        frames_by: The entries that name frames, likewise.
        path: Its key path, for messages; empty if Python code made it.
        all_joints: Whether `joint_ids` is every joint in the entity's order, so that no indexing
            is needed.
    """

    uid: str
    asset: Articulation | RigidObject
    joint_ids: tuple[int, ...] = ()
    joint_names: tuple[str, ...] = ()
    kind: FrameKind = "link"
    frame_ids: tuple[int, ...] = ()
    frame_names: tuple[str, ...] = ()
    in_model: tuple[str, ...] = ()
    frame_key: str = "link_names"
    all_joints: bool = False
    control_parts: tuple[str, ...] = ()
    path: str = ""
    joints_by: tuple[NamedBy, ...] = ()
    frames_by: tuple[NamedBy, ...] = ()

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> Any:
        """Configs contain a `SceneEntityCfg` instead."""
        return handler.generate_schema(SceneEntityCfg)

    @property
    def is_articulation(self) -> bool:
        """Whether the entity has joints and links, as an `Articulation` or a `Robot` has."""
        return hasattr(self.asset, "parsed")

    @property
    def articulation(self) -> Articulation:
        """`asset` where it is known to be an articulation: where joints were picked, for example.

        Its class is not checked: this is read in every step.
        """
        return self.asset  # type: ignore[return-value]

    @property
    def rigid_object(self) -> RigidObject:
        """`asset` where it is known to be a rigid object."""
        return self.asset  # type: ignore[return-value]

    @property
    def joints(self) -> list[int] | None:
        """`joint_ids` as handles take them: None is all."""
        return None if self.all_joints else list(self.joint_ids)

    # -- links, sites or geoms ------------------------------------------------------------------

    @property
    def link_ids(self) -> tuple[int, ...]:
        """Picked links, in the entity's order; none means the root.

        Raises:
            ConfigError: If sites or geoms were picked.
        """
        self.require_links()
        return self.frame_ids

    @property
    def link_names(self) -> tuple[str, ...]:
        """Names of the picked links; raises as `link_ids`."""
        self.require_links()
        return self.frame_names

    @property
    def body_ids(self) -> tuple[int, ...]:
        """EmbodiChain's name of `link_ids`."""
        return self.link_ids

    @property
    def body_names(self) -> tuple[str, ...]:
        """EmbodiChain's name of `link_names`."""
        return self.link_names

    @property
    def link_name(self) -> str | None:
        """The one picked link, or None for the root.

        Raises:
            ConfigError: If several were picked, or sites or geoms.
        """
        self.require_links()
        return self.frame_name

    @property
    def frame_name(self) -> str | None:
        """The one picked link, site or geom, or None for the root.

        Raises:
            ConfigError: If several were picked.
        """
        if len(self.frame_names) > 1:
            message = f"one {self.kind} of {self.uid!r} is wanted, got {self._listed_frames}"
            raise self._error_at_frames(message)
        return self.frame_names[0] if self.frame_names else None

    @property
    def _listed_frames(self) -> str:
        return ", ".join(self.frame_names)

    def _error_at_frames(self, message: str) -> ConfigError:
        """Return an error with the path of the key that names frames."""
        return ConfigError([Problem(f"{self.path}.{self.frame_key}".lstrip("."), message)])

    def require_links(self) -> None:
        """Raise a ConfigError if sites or geoms were picked, where only links have a meaning."""
        if self.kind == "link":
            return
        if len(self.frame_names) == 1:
            frames = f"the {self.kind} {self._listed_frames}"
        else:
            frames = f"{self.kind}s: {self._listed_frames}"
        message = f"links are wanted here, got {frames}: name the link that carries it"
        raise self._error_at_frames(message)

    def require_whole(self) -> None:
        """Raise a ConfigError if sites or geoms were picked, where only the entity counts."""
        if self.kind != "link":
            message = f"only {self.uid!r} itself counts here, no {self.kind} of it: leave this out"
            raise self._error_at_frames(message)

    @cached_property
    def frame(self) -> BodyFrames:
        """The one picked link, site or geom, else the root, in the compiled scene.

        Raises:
            ConfigError: If several were picked.
        """
        if self.frame_name is None:
            return link_frame(int(self.asset.index.root_body_id))
        return frame_named(self.asset.engine.model, self.kind, self.in_model[0])

    @cached_property
    def frames(self) -> BodyFrames:
        """All picked links, sites or geoms, else the root, in the compiled scene."""
        if not self.frame_names:
            root = int(self.asset.index.root_body_id)
            return BodyFrames("link", slice(root, root + 1), slice(root, root + 1))
        return frames_named(self.asset.engine.model, self.kind, self.in_model)

    @property
    def link_body(self) -> int | None:
        """MuJoCo body id of the picked link, or of the one that carries the site or geom.

        None for the root.
        """
        return None if self.frame_name is None else int(self.frame.bodies)

    @property
    def body_id(self) -> int:
        """MuJoCo body id of the picked link, site's or geom's link, else of the root."""
        return int(self.frame.bodies)

    # -- joints, in float64; K is the number of picked joints ------------------------------------

    @cached_property
    def _columns(self) -> NDArray[np.int64]:
        return np.asarray(self.joint_ids, np.int64)

    @cached_property
    def _dofs(self) -> NDArray[np.int64]:
        return np.asarray(self.asset.index.dof_adr, np.int64)[self._columns]

    @cached_property
    def _dof_columns(self) -> slice | NDArray[np.int64]:
        return columns_of(self._dofs)

    def _pick(self, values: Floats) -> Floats:
        return values if self.all_joints else values[:, self._columns]

    def require_joints(self) -> None:
        """Raise a ConfigError if the entity has no joints."""
        if not self.joint_ids:
            raise ConfigError([Problem(self.path, f"{self.uid!r} has no joints")])

    @cached_property
    def initial_qpos(self) -> Floats:
        """(K,) initial joint positions, rad or m."""
        return np.asarray(self.articulation.parsed.init_qpos, np.float64)[self._columns]

    def qpos(self) -> Floats:
        """(N, K) joint positions, rad or m; do not write to it or store it."""
        qpos = self.articulation.read_qpos()
        return qpos if self.all_joints else qpos[:, self._columns]

    @cached_property
    def _initial_rows(self) -> Floats:
        rows = np.tile(self.initial_qpos, (self.asset.num_instances, 1))
        return self.asset.sim.arrays.put(rows)

    def displacement(self) -> Floats:
        """(N, K) joint positions minus the initial ones, rad or m."""
        return self.qpos() - self._initial_rows

    def encoder_bias(self) -> Floats:
        """(N, K) what encoders read minus joint positions, rad or m."""
        return self._pick(self.articulation.drives.encoder_bias)

    def qvel(self) -> Floats:
        """(N, K) joint velocities, rad/s or m/s; do not write to it or store it."""
        qvel = self.articulation.read_qvel()
        return qvel if self.all_joints else qvel[:, self._columns]

    def target_qpos(self) -> Floats:
        """(N, K) position targets of the drives, rad or m; qpos of joints without a drive."""
        return self.articulation.drives.read_target_qpos()[:, self._columns]

    def effort(self) -> Floats:
        """(N, K) efforts of the last physics step, N m or N: drive, damping and applied efforts."""
        applied = self.asset.engine.state("qfrc_applied")[:, self._dof_columns]
        return self._pick(self.articulation.read_qf()) + applied

    @cached_property
    def _computed(self) -> ComputedEfforts:
        from embodichain.lab.sim.objects.computed_effort import ComputedEfforts  # needs MuJoCo

        return ComputedEfforts(self.articulation, self._columns)

    def computed_effort(self) -> Floats:
        """(N, K) efforts of the last physics step before limits of force cut them, N m or N."""
        return self._computed.read()

    def hinges(self) -> NDArray[np.bool_]:
        """(K,) whether a joint is a hinge, not a slide."""
        model = self.asset.engine.model
        return model.jnt_type[model.dof_jntid[self._dofs]] == _HINGE

    def qpos_limits(self, soft_ratio: float = 1.0) -> tuple[Floats, Floats]:
        """Low and high position limits in force, (N, K) each; infinite without a limit.

        Args:
            soft_ratio: Fraction of the range, about its middle.

        Raises:
            ConfigError: If no joint has a limit.
        """
        low, high = self.articulation.drives.limits.of(self._columns, None)
        if not self._was_checked(low, "position"):
            self._require_limits(np.isfinite(low) | np.isfinite(high), "position")
        if soft_ratio == 1.0:
            return low, high
        is_limited = np.isfinite(low) & np.isfinite(high)
        # Where a side is infinite the range has no middle: it is left as it is.
        width = np.subtract(high, low, where=is_limited, out=np.zeros_like(low))
        inset = 0.5 * (1.0 - soft_ratio) * width
        return low + inset, high - inset

    def qpos_ranges(self) -> tuple[Floats, Floats]:
        """Low and high position limits in force, (N, K) each.

        Raises:
            ConfigError: If a joint has no limits.
        """
        low, high = self.articulation.drives.limits.of(self._columns, None)
        if self._was_checked(low, "ranges"):
            return low, high
        is_limited = self.asset.sim.arrays.host(np.isfinite(low) & np.isfinite(high))
        if not is_limited.all():
            is_limited_everywhere = np.asarray(is_limited.all(axis=0))
            joints = zip(self.joint_names, is_limited_everywhere, strict=True)
            unlimited_joints = ", ".join(name for name, limited in joints if not limited)
            message = f"joints of {self.uid!r} without position limits: {unlimited_joints}"
            raise ConfigError([Problem(self.path, message)])
        return low, high

    def qvel_limits(self) -> Floats:
        """(N, K) rad/s or m/s: the smaller of the drive's maximum and the file's limit.

        Raises:
            ConfigError: If no joint has a limit.
        """
        return self._smaller_limits(
            self.articulation.drives.max_velocity, "qvel_limits", "velocity"
        )

    def effort_limits(self) -> Floats:
        """(N, K) N m or N: the smaller of the drive's maximum and the file's limit.

        Raises:
            ConfigError: If no joint has a limit.
        """
        drives = self.articulation.drives
        return self._smaller_limits(drives.max_effort * drives.strength, "qf_limits", "effort")

    def _smaller_limits(self, of_drives: Floats, file_attribute: str, what: str) -> Floats:
        """(N, K) the smaller of the drives' limits, (N, D), and those of the file."""
        of_file = np.asarray(getattr(self.articulation.parsed, file_attribute), np.float64)
        limits = np.minimum(of_drives[:, self._columns], of_file[self._columns])
        limits = np.where(limits >= UNLIMITED, np.inf, limits)
        if not self._was_checked(limits, what):
            self._require_limits(np.isfinite(limits), what)
        return limits

    @cached_property
    def _checked(self) -> set[str]:
        return set()

    def _was_checked(self, limits: Floats, what: str) -> bool:
        """Whether limits on a device were checked before: once, because it waits for the device."""
        if is_host(limits):
            return False
        if what in self._checked:
            return True
        self._checked.add(what)
        return False

    def _require_limits(self, is_limited: NDArray[np.bool_], what: str) -> None:
        if not self.asset.sim.arrays.host(is_limited).any():
            names = ", ".join(self.joint_names)
            message = f"none of the joints picked of {self.uid!r} has limits of {what}: {names}"
            raise ConfigError([Problem(self.path, message)])

    # -- the picked frame, else the root: environment's frame, wxyz, float64 ---------------------

    @cached_property
    def _motion(self) -> BodyMotion:
        return self.asset.motion_of(self.frame)

    def position(self) -> Floats:
        """(N, 3) m: a live view; do not write to it or store it."""
        return self._motion.position()

    def vector_to(self, other: ResolvedEntity) -> Floats:
        """(N, 3) m from this origin to another one; do not write to it."""
        return self._motion.vector_to(other._motion)

    def distance_to(self, other: ResolvedEntity) -> Floats:
        """(N,) m from this origin to another one; do not write to it."""
        return self._motion.distance_to(other._motion)

    def orientation(self) -> Floats:
        """(N, 4) wxyz: a live view; do not write to it or store it."""
        return self._motion.orientation()

    def axes(self) -> Floats:
        """(N, 3, 3) rotation matrix; do not write to it."""
        return self._motion.axes()

    def gravity(self) -> Floats:
        """(N, 3) unit vector of gravity in the frame's axes; do not write to it."""
        return self._motion.gravity()

    def linear_velocity(self, frame: Frame = "world") -> Floats:
        """(N, 3) m/s of the origin; do not write to it. See `BodyMotion.linear_velocity`."""
        return self._motion.linear_velocity(frame)

    def angular_velocity(self, frame: Frame = "world") -> Floats:
        """(N, 3) rad/s; do not write to it. See `BodyMotion.linear_velocity`."""
        return self._motion.angular_velocity(frame)

    # -- all picked frames; L is their number, 1 for the root ------------------------------------

    def link_poses(self, in_root_frame: bool = False) -> tuple[Floats, Floats]:
        """Positions (N, L, 3) in m and orientations (N, L, 4), wxyz; do not store them.

        Args:
            in_root_frame: Whether they are relative to the root of the entity, in its axes.
        """
        root_position, root_quat = self.asset.read_pose()
        if self.frame_names:
            engine = self.asset.engine
            position = self.frames.positions(engine)
            quat = self.frames.orientations(engine)
        else:
            position = root_position[:, None]
            quat = root_quat[:, None]
        if not in_root_frame:
            return position, quat
        inverse = _repeated(quat_conjugate(root_quat), position.shape[1])
        return quat_rotate(inverse, position - root_position[:, None]), quat_multiply(inverse, quat)

    def link_velocities(self, in_root_frame: bool = False) -> tuple[Floats, Floats]:
        """Linear in m/s, of the frames' origins, and angular in rad/s, (N, L, 3) each.

        Args:
            in_root_frame: Whether the root's velocity is subtracted, in the root's axes.
        """
        root = self._root
        if self.frame_names:
            linear, angular = self.frames.velocities(self.asset.engine)
        else:
            linear = self.linear_velocity()[:, None]
            angular = self.angular_velocity()[:, None]
        if not in_root_frame:
            return linear, angular
        inverse = _repeated(quat_conjugate(root.orientation()), linear.shape[1])
        linear = linear - root.linear_velocity()[:, None]
        angular = angular - root.angular_velocity()[:, None]
        return quat_rotate(inverse, linear), quat_rotate(inverse, angular)

    @cached_property
    def _root(self) -> ResolvedEntity:
        return ResolvedEntity(self.uid, self.asset) if self.frame_names else self


def _repeated(quat: Floats, count: int) -> Floats:
    """(N, count, 4) of (N, 4)."""
    return np.broadcast_to(quat[:, None], (len(quat), count, 4))


def resolve_entity(
    sim: SimulationManager,
    cfg: SceneEntityCfg | Mapping[str, Any] | ResolvedEntity,
    path: str = "",
) -> ResolvedEntity:
    """Look an entity up in the scene.

    Args:
        sim: The scene.
        cfg: The reference; a mapping is read as a `SceneEntityCfg`.
        path: Its key path.

    Raises:
        ConfigError: If the entity, a joint or a link does not exist; lists those that do.
    """
    if isinstance(cfg, ResolvedEntity):
        return cfg
    from embodichain.lab.sim.compiler.names import frame_in_model, frame_names, pick

    if not isinstance(cfg, SceneEntityCfg):
        cfg = _from_mapping(cfg)
    picked, problems = pick(path, vars(cfg), sim.known)
    if problems:
        raise ConfigError(problems)
    entity: Any = sim.known[cfg.uid]
    assets: dict[str, Any] = {**sim.robots, **sim.articulations, **sim.rigid_objects}
    names: tuple[str, ...] = ()
    if picked.frames:
        all_names = frame_names(entity, cfg.uid, picked.kind) or ()
        names = tuple(all_names[i] for i in picked.frames)
    joints = getattr(entity, "joint_names", ())
    picks_all_joints = hasattr(entity, "joint_names") and (
        picked.joints == tuple(range(len(joints)))
    )
    return ResolvedEntity(
        uid=cfg.uid,
        asset=assets[cfg.uid],
        joint_ids=picked.joints,
        joint_names=tuple(joints[i] for i in picked.joints),
        kind=picked.kind,
        frame_ids=picked.frames,
        frame_names=names,
        in_model=tuple(frame_in_model(entity, cfg.uid, picked.kind, name) for name in names),
        frame_key=picked.key,
        control_parts=picked.parts,
        path=path,
        joints_by=picked.joints_by,
        frames_by=picked.frames_by,
        all_joints=picks_all_joints,
    )


def _from_mapping(cfg: Mapping[str, Any]) -> SceneEntityCfg:
    return from_dict(SceneEntityCfg, dict(cfg))


_FIELDS = frozenset(SceneEntityCfg.__dataclass_fields__)
_KEY = re.compile(r"(.*_)?(entity_cfg|cfg|relative_to)|of|from|to")


def references_in(path: str, params: Any) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield key path and fields of every reference to an entity within parameters.

    A value is a reference if it is a `SceneEntityCfg`, or a map with only its keys that has ``uid``
    or is named like one (``of``, ``from``, ``to``, ``..._cfg``, ``relative_to``).

    Args:
        path: Key path of the parameters.
        params: Parameters of a term, or a value in them.
    """
    items: Iterable[tuple[Any, Any]] = ()
    if isinstance(params, Mapping):
        items = params.items()
    elif isinstance(params, (list, tuple)):
        items = enumerate(params)
    for key, value in items:
        where = f"{path}.{key}"
        if isinstance(value, SceneEntityCfg):
            yield where, vars(value)
        elif (
            isinstance(value, Mapping)
            and ("uid" in value or _KEY.fullmatch(str(key)))
            and _FIELDS.issuperset(value)
        ):
            yield where, value
        else:
            yield from references_in(where, value)
