"""Sensors of the generalized forces at joints."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import numpy as np

from embodichain.lab.sim.compiler.sensing.sensor_index import SensorIndex
from embodichain.lab.sim.configs.references import OF, JointsCfg
from embodichain.lab.sim.configs.sensor_cfg import SensorCfg
from embodichain.lab.sim.sensors.base_sensor import BaseSensor, register_sensor
from embodichain.utils.configclass import configclass

if TYPE_CHECKING:
    import mujoco

    from embodichain.lab.sim.compiler.index import EntityIndex
    from embodichain.lab.sim.compiler.sensing.sensor_plans import SceneNames, SensorPlan
    from embodichain.lab.sim.engine.api import EnvIndex
    from embodichain.lab.sim.sensors.sampling import Readings
    from embodichain.utils.array_types import Floats
    from embodichain.utils.errors import Problem

__all__ = ["JointTorqueSensor", "JointTorqueSensorCfg"]


@configclass
class JointTorqueSensorCfg(SensorCfg):
    """Generalized forces at joints: N m of hinges, N of slides."""

    reads: ClassVar[tuple[str, ...]] = ("torque", "actuator", "passive", "constraint")

    sensor_type: Literal["joint_torque"] = "joint_torque"
    of: Annotated[JointsCfg, OF] = JointsCfg()
    """The joints."""


@register_sensor(JointTorqueSensorCfg)
class JointTorqueSensor(BaseSensor):
    """Generalized forces that act at n joints: N m of hinges, N of slides.

    They are those of the last physics step or, after a reset, of the reset state. At rest their sum
    balances gravity (``qfrc_bias``) and forces that are applied from outside.
    """

    @classmethod
    def make_plan(
        cls, uid: str, cfg: JointTorqueSensorCfg, scene: SceneNames
    ) -> tuple[SensorPlan | None, list[Problem]]:
        """Look up its joints."""
        return scene.plan_joints(uid, cfg, cfg.of)

    @classmethod
    def find_index(
        cls, model: mujoco.MjModel, plan: SensorPlan, entities: Mapping[str, EntityIndex]
    ) -> SensorIndex:
        """Return the columns of its joints in qvel."""
        dofs = [model.joint(name).dofadr[0] for name in plan.joints]
        return SensorIndex(dofs=np.array(dofs, np.int64))

    def measure(self, env_ids: EnvIndex | None) -> Readings:
        """(n, joints) forces of actuators, passive forces and forces of constraints."""
        where = slice(None) if env_ids is None else env_ids[:, None]
        fields = ("qfrc_actuator", "qfrc_passive", "qfrc_constraint")
        return tuple(self.engine.acceleration(name)[where, self.index.dofs] for name in fields)

    def read_torque(self) -> Floats:
        """(N, n) sum of the other three."""
        actuator, passive, constraint = self.latest()
        return actuator + passive + constraint

    def read_actuator(self) -> Floats:
        """(N, n) of drives and other actuators (``qfrc_actuator``, `jointactuatorfrc`)."""
        return self.latest()[0].copy()

    def read_passive(self) -> Floats:
        """(N, n) of springs, dampers and gravity compensation (``qfrc_passive``)."""
        return self.latest()[1].copy()

    def read_constraint(self) -> Floats:
        """(N, n) of limits, dry friction, equalities and contacts (``qfrc_constraint``)."""
        return self.latest()[2].copy()
