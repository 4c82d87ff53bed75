"""The root of a config as data classes: what YAML and the command line are checked against.

`task` is the very `EnvCfg` that the Python API uses; the keys of it that are root keys here are
refused below `task` (`ROOT_INSTEAD`). No torch, no Hydra.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field

from embodichain.config.algorithms import AnyAlgoCfg
from embodichain.lab.gym.envs.cfg import EnvCfg
from embodichain.utils.configclass import configclass

__all__ = [
    "LARGEST_TRAINING_SEED",
    "ROOT_INSTEAD",
    "SUGGESTED_KEYS",
    "VERBS",
    "CheckpointCfg",
    "EvalCfg",
    "PolicyCfg",
    "RecordCfg",
    "RootCfg",
    "SimCfg",
    "Verb",
    "ViewerCfg",
    "WandbCfg",
]

ROOT_INSTEAD = {
    "num_envs": "it is a key of the root: num_envs=N",
    "seed": "it is a key of the root: seed=N",
    "sim_cfg": "use task.physics for the physics and the group sim for how it runs",
}
"""Fields of `EnvCfg` that a task file must not set, and where their value goes instead."""

Verb = Literal["run", "train"]
VERBS: tuple[Verb, ...] = ("run", "train")

LARGEST_TRAINING_SEED = 2**32 - 1
"""Stable-Baselines3 seeds numpy's global generator, which takes no larger one."""

PositiveInt = Annotated[int, Field(ge=1)]


@configclass
class SimCfg:
    """How a scene is run; the scene itself is in the task."""

    engine: Literal["mujoco"] = "mujoco"
    """`mujoco.batch` on the CPU."""
    backend: Literal["local"] = "local"
    """Where environments live: in this process."""
    num_threads: Annotated[int, Field(ge=0)] = 0
    """Physics threads; 0 is every core the process may use."""
    persistent: bool | None = None
    """One MjData an environment (True) or a thread (False); None is the former only for a model
    that needs it (sleep, IPC, plugins)."""


@configclass
class RecordCfg:
    """What a run writes into its log."""

    format: Literal["mcap", "none"] = "mcap"
    state: Literal["all", "keyframes", "none"] = "all"
    """`all` keeps what `replay --verify` needs of every environment; `keyframes` too, in less."""
    keyframe_every: Annotated[int, Field(ge=1)] = 100
    """Control steps from one state to the next with `keyframes`."""
    every: Annotated[int, Field(ge=1)] = 1
    """k records every k-th episode of the first viewed environment, and all others meanwhile."""
    max_mb: Annotated[float, Field(gt=0)] | None = None
    """Megabytes after which the log goes on in another file."""
    compression: Literal["zstd", "lz4", "none"] = "zstd"
    view_envs: list[Annotated[int, Field(ge=0)]] = [0]
    """Environments that people look at: transforms, shapes, joint states."""
    view_hz: Annotated[float, Field(gt=0)] = 10.0
    """Of simulated time."""


@configclass
class ViewerCfg:
    """How people look on while it runs."""

    name: Literal["none", "native", "web", "foxglove"] = "none"
    """`native` is MuJoCo's window; `web` and `foxglove` serve a page and a WebSocket."""
    host: Annotated[str, Field(min_length=1)] = "127.0.0.1"
    """The address to listen on; there is no password."""
    port: Annotated[int, Field(ge=1, le=65535)] | None = None
    """None is the viewer's own: the first free one from 8080 for `web`, 8765 for `foxglove`."""
    env: Annotated[int, Field(ge=0)] = 0
    """The environment that is shown first."""


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
    """How many of these are kept; `best` and `final` are kept anyway."""
    replay_buffer: bool = False
    """Whether these and `final` have the replay buffer of algorithms that learn from one."""


@configclass
class EvalCfg:
    """The evaluation that ends a training; `record` and `video` are of its episodes."""

    episodes: Annotated[int, Field(ge=0)] = 100
    """Over all environments; 0 is no evaluation."""


@configclass
class WandbCfg:
    """Whether the numbers of a training go to Weights & Biases as well (extra `wandb`)."""

    mode: Literal["disabled", "online", "offline"] = "disabled"
    """`offline` only writes files, for `wandb sync`."""
    project: str = "embodichain"
    entity: str | None = None
    """User or team; null is the user's default."""
    name: str | None = None
    """Of the run; null is the name of its folder."""
    group: str | None = None
    tags: list[str] = []


@configclass
class RootCfg:
    """The root of a config. Null keys are filled by suggestions and defaults."""

    task: EnvCfg
    sim: SimCfg = SimCfg()
    record: RecordCfg = RecordCfg()
    viewer: ViewerCfg = ViewerCfg()
    algo: AnyAlgoCfg | None = None
    num_envs: PositiveInt | None = None
    seed: Annotated[int, Field(ge=0, lt=2**63)] | None = None
    device: str | None = None
    episodes: PositiveInt | None = None
    """For each environment."""
    max_steps: PositiveInt | None = None
    """Control steps; None is no limit."""
    total_timesteps: PositiveInt | None = None
    """Control steps of training, summed over environments."""
    policy: str | PolicyCfg | None = None
    allow_changed: bool = False
    """Whether a trained policy acts, and a training goes on, in a task that changed since."""
    resume: str | None = None
    """A training run's folder, or ``last``."""
    checkpoint: CheckpointCfg = CheckpointCfg()
    eval: EvalCfg = EvalCfg()
    wandb: WandbCfg = WandbCfg()
    video: bool | None = None
    """Whether the first environment of the log is filmed, too."""
    scene_png: bool = True
    """Whether `run` draws the first environment as it starts."""
    gym_config: str | None = None
    """The file of EmbodiChain's that the task was converted from."""
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
"""Root keys that `task.suggested.run` and `.train` may fill (`.train` has `algo` too)."""
