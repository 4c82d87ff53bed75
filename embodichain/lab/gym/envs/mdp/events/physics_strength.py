"""Events that make actuators stronger or weaker as a whole."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import lazy_loader
import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.envs.managers.param_types import Ranges
from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.managers.term import Term
from embodichain.lab.gym.envs.mdp._model_fields import (
    Distribution,
    Draw,
    Quantity,
    articulation_of,
)
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    import mujoco

    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import F64, Engine, EnvIndex
else:
    mujoco = lazy_loader.load("mujoco")

__all__ = ["RandomizeActuatorStrength"]


@register_term("event", name="randomize_actuator_strength")
class RandomizeActuatorStrength(Term):
    """Multiplies the force of joints' actuators by random factors: motors that are weak or strong.

    Gain, bias and force limits are scaled together, so force = factor x nominal force for the same
    control, position and velocity. It works on drives (`get_joint_drive` keeps the nominal gains,
    whatever randomizes those), on servos of an MJCF file, and on what else of the file acts on a
    joint. Passive damping of the joint is no actuator's.

    Args:
        entity_cfg: The robot or articulation; joint names or control parts pick joints.
        strength_range: Factors [low, high], not negative; or {joint regex: [low, high]}.
        distribution: ``uniform``, ``log_uniform`` or ``gaussian`` within the range.

    Example:
        ``{func: randomize_actuator_strength, mode: reset, params: {entity_cfg: {uid: ur10}, strength_range: [0.8, 1.1]}}``
    """  # noqa: E501

    drive_ranges: ClassVar = {"strength_range": "strength"}

    def __init__(
        self,
        env: TermContext,
        entity_cfg: ResolvedEntity,
        strength_range: Ranges,
        distribution: Distribution = "uniform",
    ) -> None:
        asset = articulation_of(entity_cfg).asset
        index = asset.entity
        joints = np.asarray(entity_cfg.joint_ids, np.int64)
        driven = joints[np.asarray(index.actuator_ids, np.int64)[joints] >= 0]
        dofs = np.asarray(index.dof_adr, np.int64)[joints]
        others = np.setdiff1d(index.own_actuator_ids, index.actuator_ids)
        own = _own_actuators(asset.engine.model, others, dofs)
        names = [asset.parsed.joint_names[i] for i in driven]
        names += [asset.engine.model.actuator(i).name or f"actuator {i}" for i in own]
        if not names:
            message = f"no actuator drives: {', '.join(entity_cfg.joint_names)}"
            raise ConfigError([Problem("entity_cfg", message)])
        quantity = Quantity("strength_range", strength_range, names, np.ones(len(names)), "abs", 0)
        self._draw = Draw([quantity], distribution)
        here = quantity.ids < len(driven)
        self._count = int(here.sum())
        self._drives, self._joints = asset.drives, driven[quantity.ids[here]]
        self._own = _Own(asset.engine, own[quantity.ids[~here] - len(driven)])

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Draw and write the strengths of these environments."""
        (factor,) = self._draw(env, env_ids)
        if self._count:
            self._drives.put("strength", factor[:, : self._count], env_ids, self._joints)
        if self._count < factor.shape[1]:
            self._own.write(factor[:, self._count :], env_ids)


class _Own:
    """Actuators of a file: everything that their force is proportional to."""

    def __init__(self, engine: Engine, actuators: NDArray[np.int64]) -> None:
        self._engine = engine
        model = engine.model
        limited = model.actuator_forcelimited[actuators] != 0
        gains, biases = model.actuator_gainprm.shape[1], model.actuator_biasprm.shape[1]
        self._parts = [
            self._part("actuator_gainprm", actuators, gains, 3),
            self._part("actuator_biasprm", actuators, biases, 3),
        ]
        if limited.any():
            part = self._part("actuator_forcerange", actuators[limited], 2, 2)
            self._parts.append((*part[:3], np.repeat(np.flatnonzero(limited), 2)))

    def _part(
        self, field: str, actuators: NDArray[np.int64], width: int, used: int
    ) -> tuple[str, NDArray[np.int64], F64, NDArray[np.int64]]:
        """A field, its columns, what was compiled, and whose factor each column takes."""
        columns = (width * actuators[:, None] + np.arange(used)).reshape(-1)
        compiled = getattr(self._engine.model, field).reshape(-1)[columns].copy()
        return field, columns, compiled, np.repeat(np.arange(len(actuators)), used)

    def write(self, factor: F64, env_ids: EnvIndex | None) -> None:
        """Set forces to (n, m) times the compiled ones."""
        for field, columns, compiled, source in self._parts:
            self._engine.write_model(field, compiled * factor[:, source], env_ids, columns)


def _own_actuators(
    model: mujoco.MjModel, actuators: NDArray[np.int64], dofs: NDArray[np.int64]
) -> NDArray[np.int64]:
    """A file's actuators on the joints of these dofs, whose force is linear in its parameters.

    Raises:
        ConfigError: If one has another force law, such as a muscle's.
    """
    joints = model.dof_jntid[dofs]
    kinds = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
    linear_gain = (int(mujoco.mjtGain.mjGAIN_FIXED), int(mujoco.mjtGain.mjGAIN_AFFINE))
    linear_bias = (int(mujoco.mjtBias.mjBIAS_NONE), int(mujoco.mjtBias.mjBIAS_AFFINE))
    found = [
        int(i)
        for i in actuators
        if model.actuator_trntype[i] in kinds and model.actuator_trnid[i, 0] in joints
    ]
    for i in found:
        gain, bias = model.actuator_gaintype[i], model.actuator_biastype[i]
        if gain not in linear_gain or bias not in linear_bias:
            message = f"{model.actuator(i).name!r} has a force law that has no strength to scale"
            raise ConfigError([Problem("entity_cfg", message)])
    return np.asarray(found, np.int64)
