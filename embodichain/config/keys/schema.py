"""The root of a config as data classes, against which YAML and the command line are checked.

`task` is the same `EnvCfg` as in the Python API; those of its keys that are root keys here are
refused below `task` (`ROOT_INSTEAD`). Imports neither torch nor Hydra.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, GetCoreSchemaHandler

from embodichain.config.keys.algorithms import AnyAlgoCfg
from embodichain.config.keys.viewers import NO_VIEWER, VIEWERS
from embodichain.lab.gym.envs.cfg import EnvCfg
from embodichain.lab.sim.cfg import EngineName, WarpCfg
from embodichain.utils.configclass import configclass

__all__ = [
    "JOB_VERBS",
    "LARGEST_TRAINING_SEED",
    "ROOT_INSTEAD",
    "SUGGESTED_KEYS",
    "CheckpointCfg",
    "CollectCfg",
    "EvalCfg",
    "JobVerb",
    "PolicyCfg",
    "RayCfg",
    "RecordCfg",
    "RootCfg",
    "SimCfg",
    "VideoCfg",
    "ViewerCfg",
    "WandbCfg",
]

ROOT_INSTEAD = {
    "num_envs": "it is a key of the root: num_envs=N",
    "seed": "it is a key of the root: seed=N",
    "first_env": "it is a key of the group sim: sim.first_env=N",
    "sim_cfg": "use task.physics for the physics and the group sim for how it runs",
}
"""Fields of `EnvCfg` that a task file must not set -> what to use instead."""

JobVerb = Literal["run", "train", "collect"]
JOB_VERBS: tuple[JobVerb, ...] = ("run", "train", "collect")
"""Verbs of the command line with a root config of their name."""

LARGEST_TRAINING_SEED = 2**32 - 1
"""Largest seed of numpy's global generator, which Stable-Baselines3 seeds."""

PositiveInt = Annotated[int, Field(ge=1)]


@configclass
class RayCfg:
    """The cluster of `sim.backend=ray`."""

    address: Annotated[str, Field(min_length=1)] | None = None
    """``auto``, ``HOST:PORT``; None is ``RAY_ADDRESS``, or a cluster of this machine alone."""
    cpus: PositiveInt = 1
    """Cores that each shard reserves."""
    save_every: PositiveInt = 1000
    """Control steps between two saved states, from which lost shards are rebuilt."""


@configclass
class SimCfg:
    """How the simulation runs; the scene itself is in the task."""

    engine: EngineName | None = None
    """`mujoco` is `mujoco.batch` on the CPU, `warp` MuJoCo Warp; null is that of `device`. Packages
    may have others."""
    backend: Literal["local", "ray"] = "local"
    """Where environments run: in this process, or in shards on the nodes of a Ray cluster."""
    shards: PositiveInt = 1
    """Number of shards of `ray`; results do not depend on it."""
    ray: RayCfg = RayCfg()
    num_threads: Annotated[int, Field(ge=0)] = 0
    """Physics threads; 0 is one for every core that the process may use."""
    first_env: Annotated[int, Field(ge=0)] = 0
    """Number of the first environment: *i* draws as first_env + i of a larger batch."""
    persistent: bool | None = None
    """One MjData per environment (True) or per thread (False); None is True only for a model that
    needs it (sleep, IPC, plugins)."""
    warp: WarpCfg = WarpCfg()
    """Memory of MuJoCo Warp; null values are measured before the run."""


Pixels = Annotated[int, Field(ge=1, le=8192)]


@configclass
class ImagesCfg:
    """Pictures in a log; they can be drawn again from any log without them."""

    cameras: Annotated[list[str], Field(min_length=1)] | None = None
    """Camera sensors, or cameras of the scene; None is all camera sensors."""
    envs: Annotated[list[Annotated[int, Field(ge=0)]], Field(min_length=1)] = [0]
    format: Literal["h264", "jpeg", "png"] = "h264"
    rate: Annotated[float, Field(gt=0)] = 10.0
    """Hz of simulated time."""
    size: tuple[Pixels, Pixels] | None = None
    """Width and height in pixels; None is that of each camera."""


@configclass
class RecordCfg:
    """What a run writes into its log."""

    format: Literal["mcap", "none"] = "mcap"
    state: Literal["all", "keyframes", "none"] = "all"
    """`all` and the smaller `keyframes` record all that `replay --verify` needs."""
    keyframe_every: Annotated[int, Field(ge=1)] = 100
    """With `keyframes`: control steps between two recorded states."""
    every: Annotated[int, Field(ge=1)] = 1
    """k records all environments during every k-th episode of the first viewed environment."""
    max_mb: Annotated[float, Field(gt=0)] | None = None
    """Megabytes after which the log continues in another file."""
    compression: Literal["zstd", "lz4", "none"] = "zstd"
    view_envs: list[Annotated[int, Field(ge=0)]] = [0]
    """Environments recorded for viewers: transforms, shapes, joint states."""
    view_hz: Annotated[float, Field(gt=0)] = 10.0
    """Rate of these in simulated time, Hz."""
    images: ImagesCfg | None = None
    """Pictures of cameras; None is none."""


class _ViewerNames:
    """Tells pydantic the names of viewers, when it first builds a schema with them."""

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> Any:
        names: Any = Literal[(NO_VIEWER, *VIEWERS.names())]
        return handler.generate_schema(names)


@configclass
class ViewerCfg:
    """The viewer of a run."""

    name: Annotated[str, _ViewerNames()] = NO_VIEWER
    """`native` is MuJoCo's window; `web` and `foxglove` serve a page and a WebSocket."""
    host: Annotated[str, Field(min_length=1)] = "127.0.0.1"
    """The address to listen on."""
    port: Annotated[int, Field(ge=1, le=65535)] | None = None
    """None is the viewer's default: the first free port from 8080 (`web`) or 8765 (`foxglove`)."""
    env: Annotated[int, Field(ge=0)] = 0
    """The environment that is shown first."""
    wait_s: Annotated[float, Field(ge=0)] = 30.0
    """Seconds for which `run` and `demo` wait for the first person who looks, unless they are
    started in a terminal, where they wait until a key is pressed; 0 waits nowhere, inf as long as
    it takes."""
    token: str = "auto"
    """What a browser or viewer must know: `auto` draws it, `none` asks for none (on addresses of
    this machine alone); records have `<token>` instead of another text."""
    allow_hosts: list[str] = []
    """Names of the server beside its address, such as those of a proxy."""
    allow_origins: list[str] | None = None
    """Sites whose pages may connect; None is the apps of Foxglove and Lichtblick for `foxglove`."""


FilmPixels = Annotated[int, Field(ge=16, le=8192, multiple_of=2)]


@configclass
class VideoCfg:
    """The film of a run, in real time."""

    size: Annotated[list[FilmPixels], Field(min_length=2, max_length=2)] = [640, 480]
    """Width and height in pixels, both even."""
    every: PositiveInt | None = None
    """Control steps from one picture to the next; null is the least that gives at most 60 pictures
    a second."""
    max_seconds: Annotated[float, Field(gt=0)] | None = None
    """Length of the film; null is the whole log."""
    format: Literal["mp4", "gif"] | None = None
    """Kind of the file; null is mp4 where the extra `video` is installed, else gif, which has at
    most 25 pictures a second."""


@configclass
class PolicyCfg:
    """A policy with parameters."""

    func: str
    """A registered name or ``package.module:function``."""
    params: dict[str, Any] = {}


@configclass
class CheckpointCfg:
    """When a training writes checkpoints before the final one."""

    every_steps: PositiveInt | None = None
    """Environment steps between two, rounded up to whole rollouts; null is a tenth of all."""
    keep: Annotated[int, Field(ge=0)] = 3
    """How many of these are kept; `best` and `final` are always kept."""
    replay_buffer: bool = False
    """Whether checkpoints include the replay buffer, for algorithms that have one."""


@configclass
class EvalCfg:
    """The evaluation at the end of a training; `record` and `video` apply to its episodes."""

    episodes: Annotated[int, Field(ge=0)] = 100
    """Episodes over all environments; 0 means no evaluation."""


@configclass
class CollectCfg:
    """When `collect` ends an episode, and when it gives up."""

    success_steps: PositiveInt = 30
    """Control steps in a row with success after which an episode ends, as a success if the next
    step is one too."""
    wait_steps: Annotated[int, Field(ge=0)] = 25
    """Control steps after a policy with an end is done; without success by then, the episode is a
    failure."""
    give_up_after: PositiveInt | None = 500
    """Failures in a row; null is never."""


@configclass
class WandbCfg:
    """Logging of a training to Weights & Biases (extra `wandb`)."""

    mode: Literal["disabled", "online", "offline"] = "disabled"
    """`offline` only writes files, for `wandb sync`."""
    project: str = "embodichain"
    entity: str | None = None
    """User or team; null is the user's default."""
    name: str | None = None
    """Name of the run; null is the name of its folder."""
    group: str | None = None
    tags: list[str] = []


@configclass
class RootCfg:
    """The root of a config. Null keys are filled from the task's suggestions, then defaults."""

    task: EnvCfg
    sim: SimCfg = SimCfg()
    record: RecordCfg = RecordCfg()
    viewer: ViewerCfg = ViewerCfg()
    algo: AnyAlgoCfg | None = None
    num_envs: PositiveInt | None = None
    seed: Annotated[int, Field(ge=0, lt=2**63)] | None = None
    device: str | None = None
    episodes: PositiveInt | None = None
    """Episodes of each environment; for `collect`, successful episodes of all environments."""
    max_steps: PositiveInt | None = None
    """Control steps; None means no limit."""
    total_timesteps: PositiveInt | None = None
    """Control steps of training, summed over environments."""
    policy: str | PolicyCfg | None = None
    allow_changed: bool = False
    """Whether a policy or a resumed training may be used in a task that changed since training."""
    trust: bool = False
    """Whether code of a policy's file is run where it cannot be read without."""
    dataset: str | Annotated[list[str], Field(min_length=1)] | None = None
    """Demonstrations for a training: a collection's folder or a log, or several."""
    resume: str | None = None
    """The folder of a training or a collection, or ``last``."""
    collect: CollectCfg = CollectCfg()
    checkpoint: CheckpointCfg = CheckpointCfg()
    eval: EvalCfg = EvalCfg()
    wandb: WandbCfg = WandbCfg()
    video: bool | VideoCfg | None = None
    """Whether a video of the log's first environment is written; its settings turn it on."""
    scene_png: bool = True
    """Whether `run` writes a picture of the first environment at its start."""
    gym_config: str | None = None
    """EmbodiChain's gym config that the task was converted from."""
    output_dir: str = "outputs"
    quiet: bool = False
    json: bool = False
    traceback: bool = False


SUGGESTED_KEYS = (
    "num_envs",
    "seed",
    "device",
    "episodes",
    "max_steps",
    "total_timesteps",
    "policy",
    "video",
)
"""Root keys that `task.suggested.VERB` may fill (`.train` has `algo` too)."""
