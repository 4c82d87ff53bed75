"""`Robot`: an articulation with drives and control parts."""

from __future__ import annotations

from typing import TYPE_CHECKING

from embodichain.lab.sim.objects._arrays import to_tensor
from embodichain.lab.sim.objects.articulation import Articulation
from embodichain.lab.sim.unavailable import not_available
from embodichain.utils.tensor_mapping import TensorMapping

if TYPE_CHECKING:
    from embodichain.lab.sim.cfg import RobotCfg

__all__ = ["Robot"]

_IK = "IK solvers come later"


class Robot(Articulation):
    """An articulation with drives and control parts."""

    cfg: RobotCfg

    @property
    def control_parts(self) -> dict[str, list[str]]:
        """Joint names of each control part."""
        names = self.parsed.joint_names
        return {part: [names[i] for i in ids] for part, ids in self.parsed.control_parts.items()}

    def get_proprioception(self) -> TensorMapping:
        """Joint positions, velocities and efforts: ``qpos``, ``qvel``, ``qf``, (N, D) each."""
        parts = {"qpos": self.read_qpos(), "qvel": self.read_qvel(), "qf": self.read_efforts()}
        return TensorMapping({name: to_tensor(values) for name, values in parts.items()})

    compute_fk = not_available("compute_fk", f"{_IK}; get_link_pose reads the simulated pose")
    compute_ik = not_available("compute_ik", _IK)
    compute_batch_fk = not_available("compute_batch_fk", _IK)
    compute_batch_ik = not_available("compute_batch_ik", _IK)
    compute_jacobian = not_available("compute_jacobian", _IK)
    get_solver = not_available("get_solver", _IK)
    init_solver = not_available("init_solver", _IK)
    get_control_part_base_pose = not_available("get_control_part_base_pose", _IK)
