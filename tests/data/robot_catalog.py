"""The URDFs of example-robot-data 6.0 and what MuJoCo 4.0 makes of each.

Names are what `get_data_path` takes; numbers are degrees of freedom with the base fixed. Compiled
with ``fusestatic="false" discardvisual="false" strippath="false"`` and every mesh resolved by
`resolve_package_uri`. Visual meshes that MuJoCo cannot read were left out, with their geometries.
"""

from __future__ import annotations

# compile as they are
AS_THEY_ARE: dict[str, int] = {
    "a1_description/urdf/a1.urdf": 12,
    "alex_description/urdf/alex_sake_hands.urdf": 23,
    "alexander_description/urdf/alexander_v1.lowerBodyOnly.urdf": 13,
    "asr_twodof_description/urdf/TwoDofs.urdf": 2,
    "bolt_description/robots/bolt.urdf": 6,
    "centauro_description/urdf/centauro.urdf": 39,
    "double_pendulum_description/urdf/double_pendulum.urdf": 2,
    "double_pendulum_description/urdf/double_pendulum_continuous.urdf": 2,
    "double_pendulum_description/urdf/double_pendulum_simple.urdf": 2,
    "g1_description/urdf/g1_29dof_rev_1_0.urdf": 29,
    "g1_description/urdf/g1_29dof_with_hand_rev_1_0.urdf": 43,
    "go2_description/urdf/go2.urdf": 12,
    "hector_description/robots/quadrotor_base.urdf": 0,
    "iris_description/robots/iris.urdf": 4,
    "iris_description/robots/iris_simple.urdf": 0,
    "laikago_description/urdf/laikago.urdf": 12,
    "panda_description/urdf/panda.urdf": 9,
    "panda_description/urdf/panda_collision.urdf": 9,
    "quadruped_description/urdf/quadruped.urdf": 8,
    "simple_humanoid_description/urdf/simple_humanoid_classical.urdf": 29,
    "so_arm_description/urdf/so100.urdf": 6,
    "so_arm_description/urdf/so101.urdf": 6,
    "solo_description/robots/solo.urdf": 8,
    "solo_description/robots/solo12.urdf": 12,
    "talos_data/robots/talos_full_v2.urdf": 44,
    "talos_data/robots/talos_full_v2_box.urdf": 44,
    "talos_data/robots/talos_left_arm.urdf": 7,
    "talos_data/robots/talos_reduced.urdf": 32,
    "talos_data/robots/talos_reduced_box.urdf": 32,
    "talos_data/robots/talos_reduced_corrected.urdf": 32,
    "tiago_pro_description/robots/tiago_pro.urdf": 33,
    "ur_description/urdf/ur10_joint_limited_robot.urdf": 6,
    "ur_description/urdf/ur10_robot.urdf": 6,
    "ur_description/urdf/ur3.urdf": 0,
    "ur_description/urdf/ur3_gripper.urdf": 6,
    "ur_description/urdf/ur3_joint_limited_robot.urdf": 6,
    "ur_description/urdf/ur3_robot.urdf": 6,
    "ur_description/urdf/ur5_gripper.urdf": 6,
    "ur_description/urdf/ur5_joint_limited_robot.urdf": 6,
    "ur_description/urdf/ur5_robot.urdf": 6,
    "xarm_description/urdf/xarm7.urdf": 7,
    "z1_description/urdf/z1.urdf": 7,
}

# compile once the compiler may mend inertias: balanceinertia="true" boundmass="1e-6"
# boundinertia="1e-9". The reason is the first thing MuJoCo says without.
WITH_MENDED_INERTIA: dict[str, tuple[int, str]] = {
    "alex_description/urdf/alex_psyonic_hands.urdf": (39, "inertia must satisfy A + B >= C"),
    "allegro_hand_description/urdf/allegro_left_hand.urdf": (16, "inertia must satisfy A + B >= C"),
    "allegro_hand_description/urdf/allegro_right_hand.urdf": (
        16,
        "inertia must satisfy A + B >= C",
    ),
    "anymal_b_simple_description/robots/anymal.urdf": (
        12,
        "inertia must have positive eigenvalues",
    ),
    "anymal_c_simple_description/urdf/anymal.urdf": (12, "inertia must satisfy A + B >= C"),
    "b1_description/urdf/b1-z1.urdf": (19, "inertia must have positive eigenvalues"),
    "b1_description/urdf/b1.urdf": (12, "inertia must have positive eigenvalues"),
    "finger_edu_description/robots/finger_edu.urdf": (3, "inertia must have positive eigenvalues"),
    "go1_description/urdf/go1.urdf": (12, "inertia must have positive eigenvalues"),
    "human_description/robots/human.urdf": (
        36,
        "mass and inertia of moving bodies must be larger than mjMINVAL",
    ),
    "pr2_description/urdf/pr2.urdf": (30, "inertia must satisfy A + B >= C"),
}

# do not compile: a collision mesh in a format MuJoCo cannot read (COLLADA), or a broken file
NOT_LOADABLE: dict[str, str] = {
    "alex_description/urdf/alex_nub_hands.urdf": "mesh volume is too small",
    "anymal_b_simple_description/robots/anymal-kinova.urdf": "no decoder found for mesh file",
    "baxter_description/urdf/baxter.urdf": "no decoder found for mesh file",
    "borinot_description/urdf/borinot_flying_arm_2.urdf": "no decoder found for mesh file",
    "hextilt_description/urdf/hextilt_flying_arm_5.urdf": "no decoder found for mesh file",
    "hyq_description/robots/hyq_no_sensors.urdf": "no decoder found for mesh file",
    "icub_description/robots/icub.urdf": "no decoder found for mesh file",
    "icub_description/robots/icub_reduced.urdf": "no decoder found for mesh file",
    "kinova_description/robots/kinova.urdf": "no decoder found for mesh file",
    "romeo_description/urdf/romeo.urdf": "no decoder found for mesh file",
    "romeo_description/urdf/romeo_laas_small.urdf": "inertia must have positive eigenvalues",
    "romeo_description/urdf/romeo_small.urdf": "no decoder found for mesh file",
    "simple_humanoid_description/urdf/simple_humanoid.urdf": "number of faces should be between 1 and 200000",
    "tiago_description/robots/tiago.urdf": "no decoder found for mesh file",
    "tiago_description/robots/tiago_dual.urdf": "no decoder found for mesh file",
    "tiago_description/robots/tiago_no_hand.urdf": "no decoder found for mesh file",
}

# of the loadable ones: their visual meshes are COLLADA, so only collision shapes are left to see
VISUALS_UNREADABLE: frozenset[str] = frozenset(
    {
        "a1_description/urdf/a1.urdf",
        "anymal_b_simple_description/robots/anymal.urdf",
        "anymal_c_simple_description/urdf/anymal.urdf",
        "asr_twodof_description/urdf/TwoDofs.urdf",
        "b1_description/urdf/b1-z1.urdf",
        "b1_description/urdf/b1.urdf",
        "go1_description/urdf/go1.urdf",
        "go2_description/urdf/go2.urdf",
        "hector_description/robots/quadrotor_base.urdf",
        "iris_description/robots/iris.urdf",
        "iris_description/robots/iris_simple.urdf",
        "panda_description/urdf/panda.urdf",
        "panda_description/urdf/panda_collision.urdf",
        "ur_description/urdf/ur10_joint_limited_robot.urdf",
        "ur_description/urdf/ur10_robot.urdf",
        "ur_description/urdf/ur3_gripper.urdf",
        "ur_description/urdf/ur3_joint_limited_robot.urdf",
        "ur_description/urdf/ur3_robot.urdf",
        "ur_description/urdf/ur5_gripper.urdf",
        "ur_description/urdf/ur5_joint_limited_robot.urdf",
        "ur_description/urdf/ur5_robot.urdf",
        "z1_description/urdf/z1.urdf",
    }
)

LOADABLE: dict[str, int] = AS_THEY_ARE | {
    name: dofs for name, (dofs, _) in WITH_MENDED_INERTIA.items()
}
