"""Configs of a scene: simulation, robots, objects, drives. Pure data.

Names, order and defaults are EmbodiChain 0.2.1's; fields after `# ours` are this project's and
keyword-only. Fields without a counterpart in MuJoCo are accepted and documented as "No effect".
Nothing here imports MuJoCo or torch; `compiler` and `sim_manager` use these classes.
"""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, GetCoreSchemaHandler

from embodichain.lab.sim.configs.contact_cfg import Coefficient, ContactCfg
from embodichain.lab.sim.configs.drive_cfg import JointDrivePropertiesCfg
from embodichain.lab.sim.configs.physics_cfg import GPUMemoryCfg, PhysicsCfg, RenderCfg
from embodichain.lab.sim.configs.robot_names_cfg import GripperCfg, HomeCfg
from embodichain.lab.sim.configs.scene_cfg import (
    Finite,
    Four,
    Length,
    LightCfg,
    ObjectBaseCfg,
    Point,
    Quat,
    Rgb,
    Scale,
    SceneCfg,
    Vec3,
    ViewCfg,
)
from embodichain.lab.sim.configs.self_collision_cfg import SelfCollisionCfg
from embodichain.lab.sim.configs.solver_cfg import SolverCfg
from embodichain.lab.sim.configs.urdf_cfg import URDFCfg
from embodichain.lab.sim.engine.engine_register import ENGINES
from embodichain.lab.sim.shapes import AnyShapeCfg, CubeCfg, SiteCfg, VariantCfg
from embodichain.utils.configclass import configclass
from embodichain.utils.errors import Problem
from embodichain.utils.fields.defaults import KEEP_DEFAULT, DefaultFloat, DefaultInt
from embodichain.utils.fields.no_effect import NO_EFFECT, NoEffect
from embodichain.utils.fields.value_checks import require
from embodichain.utils.plugins import missing_class
from embodichain.utils.suggest import did_you_mean

__all__ = [
    "DEFAULT_RENDERER",
    "ArticulationCfg",
    "AttachedFileCfg",
    "ContactCfg",
    "EngineName",
    "Four",
    "GPUMemoryCfg",
    "GripperCfg",
    "HaloCfg",
    "HomeCfg",
    "JointDrivePropertiesCfg",
    "LightCfg",
    "MarkCfg",
    "MarkerCfg",
    "ObjectBaseCfg",
    "PhysicsCfg",
    "Quat",
    "ReachedCfg",
    "RenderCfg",
    "RigidBodyAttributesCfg",
    "RigidObjectCfg",
    "RobotCfg",
    "SelfCollisionCfg",
    "SimulationManagerCfg",
    "SiteCfg",
    "SolverCfg",
    "URDFCfg",
    "VariantCfg",
    "Vec3",
    "WarpCfg",
    "WindowRecordCfg",
    "choose_engine",
]

DEFAULT_RENDERER = "hybrid"


class _EngineNames:
    """Tells pydantic the names of engines, when it first builds a schema with them."""

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> Any:
        names: Any = Literal[ENGINES.names()]
        return handler.generate_schema(names)


EngineName = Annotated[str, _EngineNames()]
"""The name of an engine in `ENGINES`."""
PositiveInt = Annotated[int, Field(ge=1)]
NotNegative = Annotated[
    float,
    require("must be finite and not negative, got {}", lambda value: 0 <= value < math.inf),
]


@configclass
class WindowRecordCfg:
    """Recording from the viewer's window. No effect: runs are recorded in the log."""

    enable_hotkey: bool = True
    save_path: str | None = None
    fps: int = 20
    max_memory: int = 1024
    video_prefix: str = "viewer_record"


@configclass
class WarpCfg:
    """Memory of MuJoCo Warp, too little is an error that names the key; and where arrays are."""

    nconmax: PositiveInt | None = None
    """Contacts and pairs of geoms near each other, for each environment; all share the memory."""
    njmax: PositiveInt | None = None
    """Rows of constraints of each environment."""
    arrays: Literal["auto", "host", "device"] = "auto"
    """Where states, observations and rewards are: copied to the host in every step, or on the
    device, in float32. ``auto`` is chosen by `embodichain.make` and the commands; without them it
    is the host."""


@configclass
class SimulationManagerCfg:
    """One simulation: how it runs, and the physics every environment shares."""

    width: PositiveInt = 1920
    """Window width in pixels."""
    height: PositiveInt = 1080
    headless: bool = False
    """False opens a viewer where a display exists, and warns where none does."""
    render_cfg: RenderCfg = RenderCfg()
    gpu_id: Annotated[int, Field(ge=0)] = 0
    """The card of `sim_device` "cuda"; "cuda:N" names it by itself."""
    thread_mode: Any = "RENDER_SHARE_ENGINE"
    """No effect."""
    cpu_num: int = 1
    """No effect; see `num_threads`."""
    num_envs: PositiveInt = 1
    """Overwritten by `EnvCfg.num_envs`."""
    arena_space: Annotated[float, Field(allow_inf_nan=False)] = 5.0
    """Grid pitch in metres between environments, in viewers and logs only."""
    physics_dt: Annotated[float, Field(gt=0, allow_inf_nan=False)] = 0.01
    """Seconds per physics step."""
    sim_device: Any = "cpu"
    """Where physics runs: "cpu", "cuda", "cuda:N", or such a `torch.device`. Tensors of the
    environment are on the CPU."""
    physics_config: PhysicsCfg = PhysicsCfg()
    gpu_memory_config: GPUMemoryCfg = GPUMemoryCfg()
    window_record: WindowRecordCfg = WindowRecordCfg()
    visualization: Any = None
    """A `VisualizationCfg` of `embodichain.lab.visualization`: the viewer in a browser."""
    # ours
    engine: EngineName | None = dataclasses.field(default=None, kw_only=True)
    """``mujoco`` is `mujoco.batch` on the CPU, ``warp`` MuJoCo Warp, another one that of a package
    (`ENGINES`); None is that of the device."""
    warp: WarpCfg = dataclasses.field(default_factory=WarpCfg, kw_only=True)
    """Values that are None are estimated by MuJoCo Warp."""
    num_threads: Annotated[int, Field(ge=0)] = dataclasses.field(default=0, kw_only=True)
    """Physics threads; 0 uses every core the process may use."""
    persistent: bool | None = dataclasses.field(default=None, kw_only=True)
    """One MjData per environment (True; 200 kB each) or per thread (False); None is True only for
    models that need it (sleep, IPC, plugins)."""
    window_env: Annotated[int, Field(ge=0)] = dataclasses.field(default=0, kw_only=True)
    """The environment that the window shows."""
    ground_plane: bool = dataclasses.field(default=True, kw_only=True)
    """Whether the scene has a ground plane; False overrides `scene.ground`."""
    scene: SceneCfg = dataclasses.field(default_factory=SceneCfg, kw_only=True)
    """Overwritten by `EnvCfg.scene`."""
    views: dict[str, ViewCfg] = dataclasses.field(default_factory=dict, kw_only=True)
    """Camera views by name; overwritten by `EnvCfg.views`."""

    @property
    def device_name(self) -> str:
        """`sim_device` with its card: "cpu", "cuda" or "cuda:N"."""
        name = str(self.sim_device)
        return f"cuda:{self.gpu_id}" if name == "cuda" and self.gpu_id else name

    @property
    def has_ground(self) -> bool:
        """Whether there is a `default_plane`: a plane at z = 0, or a terrain."""
        if self.scene.terrain is not None:
            return True
        ground = self.scene.ground
        if ground is None:  # a scene's file brings its own
            return self.ground_plane and not self.scene.fpath
        return self.ground_plane and ground.type != "none"


_SPEED = NoEffect("MuJoCo has no velocity limit")
_PHYSX = NoEffect("a PhysX setting; MuJoCo has none like it")
_SLEEP = NoEffect("MuJoCo puts nothing to sleep here")
_OFFSET = NoEffect("MuJoCo has margin and gap: see contact")
_RESTITUTION = NoEffect("MuJoCo has no restitution coefficient")
_STATIC = NoEffect("MuJoCo has one sliding coefficient, dynamic_friction")
_USD = NoEffect("USD is not read")


@configclass
class RigidBodyAttributesCfg:
    """Mass, damping, friction and contact of a rigid body."""

    mass: NotNegative = 1.0
    """kg; 0 computes it from `density`."""
    density: float = 1000.0
    """kg/m^3, used when `mass` is 0."""
    angular_damping: NotNegative = 0.0
    """1/s: torque = -angular_damping x inertia x angular velocity. EmbodiChain's default is 0.7."""
    linear_damping: NotNegative = 0.0
    """1/s: force = -linear_damping x mass x velocity. EmbodiChain's default is 0.7."""
    max_depenetration_velocity: Annotated[float, _PHYSX] = 10.0
    """No effect."""
    sleep_threshold: Annotated[float, _SLEEP] = 0.001
    """No effect."""
    min_position_iters: Annotated[int, _PHYSX] = 4
    """No effect."""
    min_velocity_iters: Annotated[int, _PHYSX] = 1
    """No effect."""
    max_linear_velocity: Annotated[float, _SPEED] = 1e2
    """No effect."""
    max_angular_velocity: Annotated[float, _SPEED] = 1e2
    """No effect."""
    enable_ccd: Annotated[bool, _PHYSX] = False
    """No effect."""
    contact_offset: Annotated[float, _OFFSET] = 0.002
    """No effect: MuJoCo's soft contacts need no offset."""
    rest_offset: Annotated[float, _OFFSET] = 0.0
    """No effect."""
    enable_collision: bool = True
    restitution: Annotated[float, _RESTITUTION] = 0.0
    """No effect: MuJoCo has no restitution coefficient. A task file may only say 0."""
    dynamic_friction: Annotated[NotNegative, KEEP_DEFAULT] = DefaultFloat(0.5)
    """Sliding friction. A contact takes the larger value of its two bodies, but a body that does
    not move and was given none lets the other one decide. Not given, links of an MJCF keep their
    own."""
    static_friction: Annotated[float, KEEP_DEFAULT, _STATIC] = DefaultFloat(0.5)
    """No effect: MuJoCo has one sliding coefficient, `dynamic_friction`. A task file may only say
    0."""


@configclass
class AttachmentCfg(ObjectBaseCfg):
    """A rigid shape fixed on a link: a pusher, a tool, a payload. It becomes a separate link.

    Its pose (`init_pos`, `init_rot`, `init_quat`) is in the frame of the link, site or geom it is
    fixed on; one of these is given.
    """

    link: str = ""
    """The parent link."""
    site: str | None = dataclasses.field(default=None, kw_only=True)
    """A site on the parent link."""
    geom: str | None = dataclasses.field(default=None, kw_only=True)
    """A geom of the parent link."""
    shape: AnyShapeCfg = CubeCfg()
    mass: Annotated[float, Field(gt=0, allow_inf_nan=False)] = 0.1
    """kg."""
    dynamic_friction: Annotated[Coefficient, KEEP_DEFAULT] = DefaultFloat(0.5)
    enable_collision: bool = True
    # ours
    contact: ContactCfg | None = dataclasses.field(default=None, kw_only=True)
    """Its other contact parameters."""


@configclass
class CollisionShapeCfg(ObjectBaseCfg):
    """A shape that a link collides as; its pose is in the frame of the link."""

    shape: AnyShapeCfg = CubeCfg()


@configclass
class HaloCfg:
    """A translucent sphere around an object, in pictures and films for people.

    Nothing touches or measures it; cameras whose images are observations do not see it.
    """

    radius: Length
    """Metres."""
    color: Rgb | None = None
    """RGB in [0, 1]; None is the object's."""


@configclass
class ReachedCfg:
    """Another colour while something is near, or a joint is past a position.

    It is for pictures and films for people: cameras whose images are observations see things as
    they are. `by` needs `within`; `joint` needs `above` or `below`.
    """

    by: str | None = None
    """What has to be near: an entity, or a link, site or geom of one, ``UID/NAME``."""
    within: Length | None = None
    """Metres: the largest distance."""
    offset: Point = (0.0, 0.0, 0.0)
    """Metres: the point that it is measured from, in the frame of what is marked."""
    color: Rgb = (0.15, 0.75, 0.3)
    """RGB in [0, 1]."""
    # ours
    joint: str | None = dataclasses.field(default=None, kw_only=True)
    """A joint, ``UID/NAME``, that has to be past a position."""
    above: Finite | None = dataclasses.field(default=None, kw_only=True)
    """rad or m: its least position."""
    below: Finite | None = dataclasses.field(default=None, kw_only=True)
    """rad or m: its largest position."""


@configclass
class MarkCfg:
    """How a link, site or geom is marked, in pictures and films for people."""

    halo: HaloCfg | None = None
    reached: ReachedCfg | None = None


@configclass
class ArticulationCfg(ObjectBaseCfg):
    """A jointed mechanism read from a URDF or MJCF file.

    The pose of a floating base (`fix_base` false) is that of its root in the scene; a position or a
    rotation that is not given is that of the file or its keyframe. The pose of a fixed base is that
    of the file's world in the scene.
    """

    init_pos: Vec3 | None = None  # type: ignore[assignment]
    """Metres; None is the file's."""
    init_rot: Vec3 | None = None  # type: ignore[assignment]
    """Euler angles in degrees, intrinsic XYZ (R = Rx Ry Rz); None is the file's."""

    fpath: str | None = None
    """A .urdf or .xml file, found by `embodichain.data.get_data_path`."""
    drive_pros: JointDrivePropertiesCfg = JointDrivePropertiesCfg(drive_type="none")
    body_scale: Vec3 = (1.0, 1.0, 1.0)
    """Only (1, 1, 1) for now."""
    attrs: RigidBodyAttributesCfg = RigidBodyAttributesCfg()
    """Friction and collision of all links (an MJCF file's friction stays unless given here); mass
    and inertia come from the file."""
    fix_base: bool = True
    """Whether the root is fixed (overrides the file); False gives it a free joint."""
    disable_self_collision: bool = False
    """Whether no links collide with each other. EmbodiChain's default is True; here an MJCF decides
    for itself, and links of a URDF collide, except for parent and child and for links that overlap
    at the start."""
    init_qpos: Any = None
    """(D,) values or {joint regex: value}, rad or m; None is the file's keyframe, else an MJCF's
    `qpos0` (zeros, or each joint's `ref`), a URDF's zeros clamped to the limits. With `attach`, a
    list may give those of the robot's own file alone."""
    sleep_threshold: Annotated[float, _SLEEP] = 0.005
    """No effect."""
    min_position_iters: Annotated[int, _PHYSX] = 4
    """No effect."""
    min_velocity_iters: Annotated[int, _PHYSX] = 1
    """No effect."""
    build_pk_chain: Annotated[bool, NoEffect("kinematics are MuJoCo's")] = True
    """No effect: kinematics are MuJoCo's."""
    compute_uv: Annotated[bool, NO_EFFECT] = False
    """No effect."""
    use_usd_properties: Annotated[bool, _USD] = False
    """No effect: USD is not read."""
    # ours
    attachments: dict[str, AttachmentCfg] = dataclasses.field(default_factory=dict, kw_only=True)
    """Link name -> a shape fixed on one of the file's links."""
    gravcomp: Annotated[float, Field(allow_inf_nan=False)] | None = dataclasses.field(
        default=None, kw_only=True
    )
    """Compensated share of the links' weight (MuJoCo's gravcomp): 1 for an arm with a controller
    that compensates gravity. None keeps the file's."""
    collision: Literal["hull", "decompose"] = dataclasses.field(default="hull", kw_only=True)
    """Collision geometry of the file's meshes: their convex hull, or convex parts
    (`embodichain[decompose]`)."""
    collision_shapes: dict[str, CollisionShapeCfg | None] = dataclasses.field(
        default_factory=dict, kw_only=True
    )
    """Link regex -> the shape that it collides as, instead of the file's; None: with nothing."""
    locked_joints: dict[str, Annotated[float, Field(allow_inf_nan=False)]] = dataclasses.field(
        default_factory=dict, kw_only=True
    )
    """Joint regex -> position (rad or m) at which joints of a URDF are fixed, no longer joints."""
    contact: dict[str, ContactCfg] = dataclasses.field(default_factory=dict, kw_only=True)
    """Link or geom regex -> contact parameters; later entries override earlier ones."""
    self_collision: SelfCollisionCfg = dataclasses.field(
        default_factory=SelfCollisionCfg, kw_only=True
    )
    """Pairs of links that collide, or do not, instead of what the rule of the file says."""
    names: dict[str, str | list[str]] = dataclasses.field(default_factory=dict, kw_only=True)
    """Further names of links, sites or geoms: name -> one of them, a regex, or a list of these.
    They are valid wherever a link is named, so that a task need not know the file's names."""
    marks: dict[str, MarkCfg] = dataclasses.field(default_factory=dict, kw_only=True)
    """Link, site or geom -> how it is marked in pictures: a halo, and another colour when it is as
    the task wants it."""


@configclass
class AttachedFileCfg:
    """A URDF or MJCF file fixed on a link of a robot: a gripper, a tool, a sensor's mount.

    It becomes part of the robot: its links, joints, actuators and cameras are named ``NAME/...``,
    with the key of this entry as NAME.
    """

    fpath: str | None = None
    """A .urdf or .xml file, found by `embodichain.data.get_data_path`."""
    to: str = ""
    """The link it is fixed on, or the site, such as ``attachment_site``, or the geom; of another
    attached file, ``NAME/LINK``."""
    pos: Vec3 = (0.0, 0.0, 0.0)
    """Metres: origin of the file's world in the frame of that link, site or geom."""
    rot: Vec3 = (0.0, 0.0, 0.0)
    """Euler angles in degrees, intrinsic XYZ, in that frame."""
    quat: Quat | None = None
    """wxyz; overrides `rot`."""
    attrs: RigidBodyAttributesCfg = RigidBodyAttributesCfg()
    """Friction and collision of its links, as `ArticulationCfg.attrs`."""
    collision: Literal["hull", "decompose"] = "hull"
    """Collision geometry of the file's meshes."""
    contact: dict[str, ContactCfg] = {}
    """Link or geom regex of this file -> contact parameters; later entries override earlier."""


def _by_part(value: Any) -> Any:
    """Take one solver without a part name as that of the whole robot."""
    names = {field.name for field in dataclasses.fields(SolverCfg)}
    flat = isinstance(value, Mapping) and not names.isdisjoint(value)
    return {"default": value} if flat or isinstance(value, SolverCfg) else value


@configclass
class RobotCfg(ArticulationCfg):
    """An articulation with drives and named parts."""

    drive_pros: JointDrivePropertiesCfg = JointDrivePropertiesCfg(drive_type="force")
    control_parts: dict[str, list[str]] | None = None
    """Part name -> joint-name regexes."""
    urdf_cfg: URDFCfg | None = None
    """Several URDF files assembled into one robot, instead of `fpath`."""
    solver_cfg: Annotated[dict[str, SolverCfg] | None, BeforeValidator(_by_part)] = None
    """Control part -> its tool point; a single `SolverCfg` is that of the whole robot."""
    # ours
    attach: dict[str, AttachedFileCfg] = dataclasses.field(default_factory=dict, kw_only=True)
    """Name -> a file fixed on one of its links, in this order; a robot has one handle."""
    grippers: dict[str, GripperCfg] = dataclasses.field(default_factory=dict, kw_only=True)
    """Control part -> how this gripper opens and closes."""
    home: HomeCfg | None = dataclasses.field(default=None, kw_only=True)
    """The pose of the tool at the start; the joints that move it are solved from `init_qpos`."""


@configclass
class RigidObjectCfg(ObjectBaseCfg):
    """One rigid body with one shape, or in each environment one of several."""

    shape: AnyShapeCfg = CubeCfg()
    attrs: RigidBodyAttributesCfg = RigidBodyAttributesCfg()
    body_type: Literal["dynamic", "kinematic", "static"] = "dynamic"
    """dynamic: simulated; kinematic: moved only by code; static: never moves."""
    max_convex_hull_num: Annotated[int, Field(ge=1), KEEP_DEFAULT] = DefaultInt(1)
    """Maximum number of convex parts for a mesh's collision (`embodichain[decompose]`); 1 is its
    hull. Not given, it is the hull, or as many as needed if `collision` is ``decompose``."""
    sdf_resolution: Annotated[int, _PHYSX] = 0
    """No effect."""
    body_scale: Scale = (1.0, 1.0, 1.0)
    """Multiplies the shape's size."""
    use_usd_properties: Annotated[bool, _USD] = False
    """No effect: USD is not read."""
    # ours
    collision: Literal["hull", "decompose", "pieces"] = dataclasses.field(
        default="hull", kw_only=True
    )
    """Collision geometry of a mesh: its convex hull, as many convex parts as needed, or the hull of
    each of its pieces: of the triangles that share corners."""
    any_of: dict[str, VariantCfg] = dataclasses.field(default_factory=dict, kw_only=True)
    """Name -> a shape, in place of `shape`. An environment has the first until the event
    `randomize_shape` draws another one."""
    contact: ContactCfg | None = dataclasses.field(default=None, kw_only=True)
    """Contact parameters beside `attrs.dynamic_friction`; those of all its shapes."""
    sites: dict[str, SiteCfg] = dataclasses.field(default_factory=dict, kw_only=True)
    """Name -> a place on the object, for references and experts: ``UID/NAME``. Relations put things
    `in` the box of the site ``inside``, and `on` that of ``top``, if there is one."""
    halo: HaloCfg | None = dataclasses.field(default=None, kw_only=True)
    """What lets a small goal be seen in pictures."""
    reached: ReachedCfg | None = dataclasses.field(default=None, kw_only=True)
    """When it has another colour in pictures: as a rule, when the task is solved."""


@configclass
class MarkerCfg:
    """A coordinate frame that viewers may draw."""

    name: str = "marker"
    marker_type: str = "axis"
    axis_xpos: Any = None
    axis_size: float = 0.002
    axis_len: float = 0.005
    arena_index: int = 0


def __getattr__(name: str) -> Any:
    """Return a config class of EmbodiChain that raises the reason why it is missing."""
    cls = missing_class(name)
    if cls is not None:
        return cls
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def name_of(cfg: ObjectBaseCfg) -> str:
    """Return the uid of an entity; for an articulation without one, the stem of its file's name.

    Raises:
        ValueError: If it has neither.
    """
    if cfg.uid:
        return cfg.uid
    fpath = getattr(cfg, "fpath", None)
    if fpath:
        # "menagerie:NAME" is called NAME
        return re.split(r"[/\\:]", str(fpath))[-1].rsplit(".", 1)[0]
    urdf: URDFCfg | None = getattr(cfg, "urdf_cfg", None)
    if urdf is not None and urdf.stem():
        return urdf.stem()
    raise ValueError(f"{type(cfg).__name__} has no uid")


def choose_engine(engine: EngineName | None, device: Any) -> tuple[EngineName, list[Problem]]:
    """Return the engine for a device, and why it cannot run there or here.

    Args:
        engine: The engine, or None for that of the device: ``warp`` on CUDA, else ``mujoco``.
        device: ``cpu``, ``cuda``, ``cuda:N``, or an object whose string is one of these.
    """
    name = str(device)
    if not re.fullmatch(r"cpu|cuda(:\d+)?", name):
        hint = did_you_mean(name, ["cpu", "cuda"]).strip()
        message = f"unknown device {name!r}; allowed: cpu, cuda, cuda:N."
        return engine or "mujoco", [Problem("device", message, hint)]
    chosen = engine or ("mujoco" if name == "cpu" else "warp")
    kind = ENGINES.get(chosen)
    if kind is None:
        return chosen, [Problem("sim.engine", ENGINES.unknown(chosen))]
    if name.partition(":")[0] not in kind.devices:
        return chosen, [Problem("device", _wrong_device(chosen, name))]
    reason = kind.why_missing(name)
    path = "sim.engine" if name == "cpu" else "device"
    return chosen, [Problem(path, reason)] if reason else []


def _wrong_device(engine: EngineName, device: str) -> str:
    """Say where an engine runs instead, and which engines run on the device."""
    kind = device.partition(":")[0]
    others = [name for name, entry in ENGINES.items() if kind in entry.devices]
    ways = [f"device={ENGINES[engine].devices[0]}"]
    if others:
        ways.append(f"sim.engine={' or '.join(others)}")
    return f"sim.engine={engine} does not run on {device!r}: {', or '.join(ways)}"
