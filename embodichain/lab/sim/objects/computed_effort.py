"""`ComputedEfforts`: what actuators would apply to joints without limits of force.

A drive's force is ``clip(gain ctrl + bias, -limit, limit)``. A joint's effort (`read_qf`) is what
is left of it; a penalty on cut-off efforts needs what was asked for, Isaac Lab's
``computed_effort``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from embodichain.utils.arrays import columns_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from embodichain.lab.sim.objects.articulation import Articulation
    from embodichain.utils.array_types import Floats

__all__ = ["ComputedEfforts"]

_JOINT = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
_FIXED = int(mujoco.mjtGain.mjGAIN_FIXED)
_LINEAR = (int(mujoco.mjtBias.mjBIAS_NONE), int(mujoco.mjtBias.mjBIAS_AFFINE))
_STATELESS = int(mujoco.mjtDyn.mjDYN_NONE)


class ComputedEfforts:
    """Efforts that picked joints would have had in the last physics step without limits of force.

    Of actuators on the joint itself with a force ``gain ctrl + bias``, without activation state:
    drives, servos and motors. Others count with the force that they apply.

    Args:
        asset: The articulation, in a compiled scene.
        joints: (K,) indices of its joints.
    """

    def __init__(self, asset: Articulation, joints: NDArray[np.int64]) -> None:
        self._asset = asset
        self._joints = joints
        self._engine = asset.engine
        model = self._engine.model
        dofs = np.asarray(asset.index.dof_adr, np.int64)[joints]
        model_joints = model.dof_jntid[dofs]
        self._dofs = columns_of(dofs)
        self._limited: NDArray[np.bool_] = model.jnt_actfrclimited[model_joints] != 0
        self._actuators: list[list[int]] = [
            _linear_actuators(model, joint) for joint in model_joints.tolist()
        ]
        # The first request of an acceleration field computes it, so make it here.
        for field in ("actuator_length", "actuator_velocity", "actuator_force"):
            self._engine.acceleration(field)

    def read(self) -> Floats:
        """(N, K) N m or N; efforts applied from outside (`set_qf`, effort actions) included."""
        engine = self._engine
        actual = engine.acceleration("qfrc_actuator")[:, self._dofs]
        efforts = [
            self._of_joint(actual[:, i], actuators, bool(self._limited[i]))
            for i, actuators in enumerate(self._actuators)
        ]
        applied = engine.state("qfrc_applied")[:, self._dofs]
        cut: Floats = self._asset.drives.cut_effort[:, self._joints]
        return np.stack(efforts, axis=1) + applied + cut

    def _of_joint(self, actual: Floats, actuators: list[int], limited: bool) -> Floats:
        """(N,) of actuators of one joint; other forces count as they are, unless cut together."""
        if not actuators:
            return actual
        gears = self._engine.model.actuator_gear[:, 0]
        forces = self._engine.acceleration("actuator_force")
        total = actual
        if limited:  # the joint's own limit cuts the sum: start from nothing
            total = np.zeros_like(actual)
        for actuator in actuators:
            gear = float(gears[actuator])
            total = total + gear * self._unlimited_force(actuator)
            if not limited:
                total = total - gear * forces[:, actuator]
        return total

    def _unlimited_force(self, actuator: int) -> Floats:
        """(N,) force of an actuator before its limit, N m or N."""
        engine = self._engine
        model = engine.model
        control: Any = engine.state("ctrl")[:, actuator]
        if model.actuator_ctrllimited[actuator]:
            low, high = model.actuator_ctrlrange[actuator]
            control = np.minimum(np.maximum(control, low), high)
        gain = engine.model_values("actuator_gainprm")[:, actuator, 0]
        force: Floats = gain * control
        if model.actuator_biastype[actuator] == _LINEAR[0]:
            return force
        bias = engine.model_values("actuator_biasprm")[:, actuator]
        length = engine.acceleration("actuator_length")[:, actuator]
        velocity = engine.acceleration("actuator_velocity")[:, actuator]
        return force + bias[:, 0] + bias[:, 1] * length + bias[:, 2] * velocity


def _linear_actuators(model: mujoco.MjModel, joint: int) -> list[int]:
    """The actuators on a joint (MuJoCo's id) whose force is linear."""
    return [
        actuator
        for actuator in range(model.nu)
        if _is_linear(model, actuator) and model.actuator_trnid[actuator, 0] == joint
    ]


def _is_linear(model: mujoco.MjModel, actuator: int) -> bool:
    """Whether an actuator acts on one joint with a force linear in control, length and velocity."""
    return (
        model.actuator_trntype[actuator] in _JOINT
        and model.actuator_gaintype[actuator] == _FIXED
        and model.actuator_biastype[actuator] in _LINEAR
        and model.actuator_dyntype[actuator] == _STATELESS
    )
