"""`Robot`: an articulation with drives, control parts and inverse kinematics."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from embodichain.lab.sim.objects.articulation import Articulation
from embodichain.utils.arrays import as_env_ids, as_rows, to_tensor
from embodichain.utils.math import matrix_to_pose, normalize_quat, pose_to_matrix
from embodichain.utils.named import Named
from embodichain.utils.plugins import with_missing_members
from embodichain.utils.tensor_mapping import TensorMapping

if TYPE_CHECKING:
    from embodichain.lab.sim.cfg import RobotCfg, SolverCfg
    from embodichain.lab.sim.engine.api import EnvIndex
    from embodichain.lab.sim.objects.arms.arm_solver import ArmSolver
    from embodichain.utils.array_types import Floats

__all__ = ["Robot"]


@with_missing_members
class Robot(Articulation):
    """An articulation with drives, control parts and inverse kinematics.

    Methods of kinematics take a control part, or None for the whole robot, whose k joints are the
    columns of ``get_qpos(name)``. The tool is the tool point that `solver_cfg` gives the part, else
    the farthest link that all its joints move. Poses are in the environment's frame: x, y, z, qw,
    qx, qy, qz or 4x4 matrices. They compute with the model's geometry, without contacts, and do not
    change the simulation.
    """

    cfg: RobotCfg

    @cached_property
    def _arms(self) -> dict[str | None, ArmSolver]:
        return {}

    def destroy(self) -> None:
        """Release the engine and the file's model; names and limits remain."""
        self._arms.clear()
        super().destroy()

    def _repr_facts(self) -> dict[str, Any]:
        """Return the joints, the number of links, and how many joints each control part has."""
        parts = {part: len(names) for part, names in self.control_parts.items()}
        return {**super()._repr_facts(), "control_parts": parts}

    @property
    def control_parts(self) -> dict[str, list[str]]:
        """Joint names of each control part."""
        names = self.parsed.joint_names
        parts = {part: [names[i] for i in ids] for part, ids in self.parsed.control_parts.items()}
        return Named("control part", parts)

    def get_proprioception(self) -> TensorMapping:
        """Joint positions, velocities and efforts: ``qpos``, ``qvel``, ``qf``, (N, D) each."""
        return TensorMapping(
            {
                "qpos": to_tensor(self.read_qpos()),
                "qvel": to_tensor(self.read_qvel()),
                "qf": to_tensor(self.read_efforts()),
            }
        )

    # -- kinematics ----------------------------------------------------------------------------

    def get_solver(self, name: str | None = None) -> ArmSolver:
        """The kinematics of a control part's tool.

        Raises:
            ValueError: If there is no such part, or not exactly one link that can be its tool.
            ConfigError: If its joints do not move the tool.
        """
        arm = self._arms.get(name)
        if arm is None:
            arm = self._make_solver(name)
            self._arms[name] = arm
        return arm

    def _make_solver(self, name: str | None) -> ArmSolver:
        from embodichain.lab.sim.objects.arms.arm_solver import ArmSolver, tool_bodies

        joints = self.get_joint_ids(name, remove_mimic=True)
        self.index  # noqa: B018  (compiles)
        tool = self.parsed.tools.get(name or "default")
        bodies = [self.body_of(tool)] if tool else tool_bodies(self, joints)
        if len(bodies) != 1:
            link_of_body = dict(zip(self.index.body_ids.tolist(), self.link_names, strict=False))
            links = [link_of_body[body] for body in bodies]
            part = f"part {name!r}" if name else "the whole robot"
            raise ValueError(
                f"{self.uid}: {part} suggests {', '.join(links) or 'no link'} as the tool: "
                "declare solver_cfg: {PART: {end_link_name: LINK}}"
            )
        return ArmSolver(self, joints, bodies[0], self.solver_cfg(name))

    def solver_cfg(self, name: str | None = None) -> SolverCfg:
        """Settings of a control part's inverse kinematics, or the default ones."""
        from embodichain.lab.sim.cfg import SolverCfg

        by_part = self.cfg.solver_cfg or {}
        if isinstance(by_part, SolverCfg):
            return by_part
        return by_part.get(name or "default") or SolverCfg()

    def compute_fk(
        self, qpos: Any, name: str | None = None, to_matrix: bool = False, env_ids: Any = None
    ) -> torch.Tensor:
        """Pose of the tool at joint positions.

        Args:
            qpos: (n, k) rad or m, or (k,) for all n environments. Joints of the chain that are not
                in the part have their present positions.
            name: The control part.
            to_matrix: Whether to return matrices.
            env_ids: The n environments; None is all N.

        Returns:
            (n, 7), or (n, 4, 4).
        """
        solver = self.get_solver(name)
        all_qpos, ids = self._with_part(qpos, name, env_ids, "qpos")
        pose = np.concatenate(solver.forward(all_qpos, ids), axis=1)
        return to_tensor(pose_to_matrix(pose) if to_matrix else pose)

    def compute_ik(
        self,
        pose: Any,
        joint_seed: Any = None,
        name: str | None = None,
        env_ids: Any = None,
        return_all_solutions: bool = False,
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Joint positions that move the tool to a pose.

        Arms with the geometry of the UR family are solved in closed form, and the solution nearest
        to the seed is returned; others by damped least squares from the seed, then from other
        points between the limits.

        Args:
            pose: (n, 7) or (n, 4, 4) target.
            joint_seed: (n, k) or (k,) initial positions; None is the present ones.
            name: The control part.
            env_ids: The n environments; None is all N.
            return_all_solutions: Return all of them, those nearest to the seed first: the S = 8 of
                the closed form, else the distinct ones among the results of S = 1 + `num_samples`
                searches. S is fixed; where there are fewer, the rest has no success.

        Returns:
            (n,) bool success, and (n, k) joint positions within the limits; those of a pose that is
            not reached are the nearest that were found. With all solutions (n, S) and (n, S, k).
        """
        solver = self.get_solver(name)
        target, ids = self._pose_rows(pose, env_ids, "pose")
        seed, _ = self._with_part(joint_seed, name, env_ids, "joint_seed")
        joints = self._joints(None, name)
        pos = target[:, :3]
        quat = target[:, 3:]
        if return_all_solutions:
            solutions, exist = solver.solutions(seed, pos, quat, ids)
            of_part = np.moveaxis(solutions[..., joints], 0, 1)
            return torch.from_numpy(exist.T.copy()), to_tensor(of_part)
        solution, reached = solver.inverse(seed, pos, quat, ids)
        return torch.from_numpy(reached), to_tensor(solution[:, joints])

    def compute_batch_fk(
        self, qpos: Any, name: str | None = None, to_matrix: bool = False, env_ids: Any = None
    ) -> torch.Tensor:
        """`compute_fk` of m positions in each environment: (n, m, k) -> (n, m, 7 or 4, 4)."""
        solver = self.get_solver(name)
        ids, part_qpos = self._flatten_batch(qpos, 1, env_ids, "qpos")
        all_qpos = self._fill_joints(part_qpos, name, ids)
        pose = np.concatenate(solver.forward(all_qpos, ids), axis=1)
        if to_matrix:
            pose = pose_to_matrix(pose)
        return to_tensor(pose.reshape(*np.shape(qpos)[:2], *pose.shape[1:]))

    def compute_batch_ik(
        self, pose: Any, joint_seed: Any = None, name: str | None = None, env_ids: Any = None
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """`compute_ik` of m poses in each environment: (n, m, 7 or 4, 4) -> (n, m), (n, m, k).

        ``joint_seed`` is (n, m, k), or None for the present positions.
        """
        solver = self.get_solver(name)
        are_matrices = len(np.shape(pose)) == 4
        ids, target = self._flatten_batch(pose, 2 if are_matrices else 1, env_ids, "pose")
        if are_matrices:
            target = matrix_to_pose(target)
        quat = normalize_quat(target[:, 3:])
        seed = None
        if joint_seed is not None:
            _, seed = self._flatten_batch(joint_seed, 1, env_ids, "joint_seed")
        all_qpos = self._fill_joints(seed, name, ids)
        solution, reached = solver.inverse(all_qpos, target[:, :3], quat, ids)
        of_part = solution[:, self._joints(None, name)]
        n, m = np.shape(pose)[:2]
        return torch.from_numpy(reached.reshape(n, m)), to_tensor(
            of_part.reshape(n, m, of_part.shape[1])
        )

    def compute_jacobian(
        self, qpos: Any = None, name: str | None = None, env_ids: Any = None
    ) -> torch.Tensor:
        """(n, 6, k) linear velocity of the tool, then angular velocity, per joint velocity.

        Environment's axes; columns of joints that do not move the tool are 0. Arguments are those
        of `compute_fk`; None is the present positions.
        """
        solver = self.get_solver(name)
        all_qpos, ids = self._with_part(qpos, name, env_ids, "qpos")
        jacobian = np.zeros((len(all_qpos), 6, self.dof))
        jacobian[..., solver.moving] = solver.jacobian(all_qpos, ids)
        return to_tensor(jacobian[..., self._joints(None, name)])

    def get_control_part_base_pose(
        self, name: str | None = None, env_ids: Any = None, to_matrix: bool = False
    ) -> torch.Tensor:
        """Pose of the part's `root_link_name`, else of the robot's root: (n, 7) or (n, 4, 4)."""
        self.get_joint_ids(name)  # raises for a part that does not exist
        link = self.solver_cfg(name).root_link_name or self.root_link_name
        return self.get_link_pose(link, env_ids, to_matrix)

    def _with_part(
        self, qpos: Any, name: str | None, env_ids: Any, what: str
    ) -> tuple[Floats, EnvIndex | None]:
        """(n, D) present positions, with those of a part replaced."""
        ids = as_env_ids(env_ids, self.num_instances)
        all_qpos = self.read_qpos()[self._rows(env_ids)].copy()
        if qpos is not None:
            joints = self._joints(None, name)
            values, _ = self._checked(qpos, len(joints), env_ids, what, shared=True)
            all_qpos[:, joints] = values
        return all_qpos, ids

    def _flatten_batch(
        self, values: Any, inner: int, env_ids: Any, what: str
    ) -> tuple[EnvIndex, Floats]:
        """Environments (n m,) and values (n m, ...) of an array (n, m, ...).

        Args:
            values: The array.
            inner: How many axes follow the first two.
            env_ids: The n environments; None is all N.
            what: What it is, for messages.
        """
        ids = as_env_ids(env_ids, self.num_instances)
        if ids is None:
            ids = np.arange(self.num_instances)
        shape = np.shape(values)
        if len(shape) != 2 + inner or shape[0] != len(ids):
            raise ValueError(
                f"{self.uid}: {what} must have {2 + inner} axes, {len(ids)} environments first, "
                f"got {shape}"
            )
        width = int(np.prod(shape[2:]))
        count = shape[0] * shape[1]
        flat = as_rows(values.reshape(count, width), count, width, f"{self.uid}: {what}")
        return np.repeat(ids, shape[1]), flat.reshape(count, *shape[2:])

    def _fill_joints(self, qpos: Floats | None, name: str | None, ids: EnvIndex) -> Floats:
        """(n, D) present positions of environments, with those (n, k) of a part replaced."""
        all_qpos = self.read_qpos()[ids]
        if qpos is not None:
            joints = self._joints(None, name)
            if qpos.shape[1] != len(joints):
                raise ValueError(f"{self.uid}: expected {len(joints)} joints, got {qpos.shape}")
            all_qpos[:, joints] = qpos
        return all_qpos
