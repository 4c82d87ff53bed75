"""The root of a config as data classes: what YAML and the command line are checked against.

`task` is the very `EnvCfg` that the Python API uses; the keys of it that stand at the root here are
refused below `task` (`ROOT_INSTEAD`). No torch, no Hydra.
"""

from __future__ import annotations

import dataclasses
from typing import Annotated, Any, Literal

from pydantic import Field

from embodichain.lab.gym.envs.cfg import EnvCfg
from embodichain.utils.configclass import configclass

__all__ = [
    "LARGEST_TRAINING_SEED",
    "ROOT_INSTEAD",
    "SUGGESTED_KEYS",
    "PolicyCfg",
    "PpoCfg",
    "RecordCfg",
    "RootCfg",
    "SimCfg",
    "ViewerCfg",
]

ROOT_INSTEAD = {
    "num_envs": "it stands at the root: num_envs=N",
    "seed": "it stands at the root: seed=N",
    "sim_cfg": "use task.physics for the physics and the group sim for how it runs",
}
"""Fields of `EnvCfg` that a task file must not set, and where their value goes instead."""

LARGEST_TRAINING_SEED = 2**32 - 1
"""Stable-Baselines3 seeds numpy's global generator, which takes no larger one."""

PositiveInt = Annotated[int, Field(ge=1)]


@configclass
class SimCfg:
    """How a scene is run; what it is stands in the task."""

    engine: Literal["mujoco"] = "mujoco"
    """`mujoco.batch` on the CPU."""
    backend: Literal["local"] = "local"
    """Where environments live: in this process."""
    num_threads: Annotated[int, Field(ge=0)] = 0
    """Physics threads; 0 is every core the process may use."""
    persistent: bool | None = None
    """One MjData an environment (True) or a thread (False); None chooses by `num_envs`."""


@configclass
class RecordCfg:
    """What a run writes into its log."""

    format: Literal["mcap", "none"] = "mcap"
    state: Literal["all", "none"] = "all"
    """`all` keeps what `replay --verify` needs of every environment."""
    compression: Literal["zstd", "lz4", "none"] = "lz4"
    view_envs: list[Annotated[int, Field(ge=0)]] = [0]
    """Environments that people look at: transforms, shapes, joint states."""
    view_hz: Annotated[float, Field(gt=0)] = 10.0
    """Of simulated time."""


@configclass
class ViewerCfg:
    """A window onto the first environment."""

    name: Literal["none", "native"] = "none"


@configclass
class PolicyCfg:
    """A policy with parameters."""

    func: str
    """A registered name or ``package.module:function``."""
    params: dict[str, Any] = {}


@configclass
class PpoCfg:
    """Arguments of `stable_baselines3.PPO`; None keeps its default."""

    name: Literal["ppo"] = "ppo"
    policy: Literal["MlpPolicy"] = "MlpPolicy"
    """Observations are one flat vector."""
    learning_rate: Annotated[float, Field(gt=0)] | None = None
    n_steps: PositiveInt | None = None
    """Control steps of each environment between updates."""
    batch_size: Annotated[int, Field(ge=2)] | None = None
    n_epochs: PositiveInt | None = None
    gamma: Annotated[float, Field(ge=0, le=1)] | None = None
    gae_lambda: Annotated[float, Field(ge=0, le=1)] | None = None
    clip_range: Annotated[float, Field(gt=0)] | None = None
    clip_range_vf: Annotated[float, Field(gt=0)] | None = None
    normalize_advantage: bool | None = None
    ent_coef: Annotated[float, Field(ge=0)] | None = None
    vf_coef: Annotated[float, Field(ge=0)] | None = None
    max_grad_norm: Annotated[float, Field(gt=0)] | None = None
    target_kl: Annotated[float, Field(gt=0)] | None = None
    use_sde: bool | None = None
    sde_sample_freq: Annotated[int, Field(ge=-1)] | None = None
    stats_window_size: PositiveInt | None = None
    policy_kwargs: dict[str, Any] = {}
    """Arguments of the policy's class: `net_arch`, `log_std_init`..."""

    def arguments(self) -> dict[str, Any]:
        """Return what is set, as keyword arguments of `stable_baselines3.PPO`."""
        fields = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}
        return {k: v for k, v in fields.items() if k != "name" and v is not None}


@configclass
class RootCfg:
    """Everything one execution is told. Null keys are filled by `derive`."""

    task: EnvCfg
    sim: SimCfg = SimCfg()
    record: RecordCfg = RecordCfg()
    viewer: ViewerCfg = ViewerCfg()
    algo: PpoCfg | None = None
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
    resume: str | None = None
    """A training run's folder, or ``last``."""
    video: bool | None = None
    """Not available yet."""
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
