"""The URDFs of example-robot-data 6.0 and what the compiler makes of each.

Names are what `get_data_path` takes; numbers are degrees of freedom with the base fixed.
"""

from __future__ import annotations

INERTIA = "masses or inertias that no body can have are repaired"
SHELL = "has no volume: taken as a shell"
COLOUR = "what they colour is drawn grey"
STL = "not a binary STL file of at most 200,000 faces: converted"
EMPTY = "joints whose lower equals upper move without limits"
"""What a note says of a repair."""

LOADABLE: dict[str, int] = {
    "a1_description/urdf/a1.urdf": 12,
    "alex_description/urdf/alex_nub_hands.urdf": 19,
    "alex_description/urdf/alex_psyonic_hands.urdf": 39,
    "alex_description/urdf/alex_sake_hands.urdf": 23,
    "alexander_description/urdf/alexander_v1.lowerBodyOnly.urdf": 13,
    "allegro_hand_description/urdf/allegro_left_hand.urdf": 16,
    "allegro_hand_description/urdf/allegro_right_hand.urdf": 16,
    "anymal_b_simple_description/robots/anymal-kinova.urdf": 18,
    "anymal_b_simple_description/robots/anymal.urdf": 12,
    "anymal_c_simple_description/urdf/anymal.urdf": 12,
    "asr_twodof_description/urdf/TwoDofs.urdf": 2,
    "b1_description/urdf/b1-z1.urdf": 19,
    "b1_description/urdf/b1.urdf": 12,
    "baxter_description/urdf/baxter.urdf": 19,
    "bolt_description/robots/bolt.urdf": 6,
    "borinot_description/urdf/borinot_flying_arm_2.urdf": 2,
    "centauro_description/urdf/centauro.urdf": 39,
    "double_pendulum_description/urdf/double_pendulum.urdf": 2,
    "double_pendulum_description/urdf/double_pendulum_continuous.urdf": 2,
    "double_pendulum_description/urdf/double_pendulum_simple.urdf": 2,
    "finger_edu_description/robots/finger_edu.urdf": 3,
    "g1_description/urdf/g1_29dof_rev_1_0.urdf": 29,
    "g1_description/urdf/g1_29dof_with_hand_rev_1_0.urdf": 43,
    "go1_description/urdf/go1.urdf": 12,
    "go2_description/urdf/go2.urdf": 12,
    "hector_description/robots/quadrotor_base.urdf": 0,
    "hextilt_description/urdf/hextilt_flying_arm_5.urdf": 5,
    "human_description/robots/human.urdf": 36,
    "hyq_description/robots/hyq_no_sensors.urdf": 12,
    "icub_description/robots/icub.urdf": 32,
    "icub_description/robots/icub_reduced.urdf": 29,
    "iris_description/robots/iris.urdf": 4,
    "iris_description/robots/iris_simple.urdf": 0,
    "kinova_description/robots/kinova.urdf": 6,
    "laikago_description/urdf/laikago.urdf": 12,
    "panda_description/urdf/panda.urdf": 9,
    "panda_description/urdf/panda_collision.urdf": 9,
    "pr2_description/urdf/pr2.urdf": 30,
    "quadruped_description/urdf/quadruped.urdf": 8,
    "romeo_description/urdf/romeo.urdf": 55,
    "romeo_description/urdf/romeo_small.urdf": 31,
    "simple_humanoid_description/urdf/simple_humanoid.urdf": 29,
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
    "tiago_description/robots/tiago.urdf": 48,
    "tiago_description/robots/tiago_dual.urdf": 101,
    "tiago_description/robots/tiago_no_hand.urdf": 12,
    "tiago_pro_description/robots/tiago_pro.urdf": 33,
    "ur_description/urdf/ur10_joint_limited_robot.urdf": 6,
    "ur_description/urdf/ur10_robot.urdf": 6,
    "ur_description/urdf/ur3_gripper.urdf": 6,
    "ur_description/urdf/ur3_joint_limited_robot.urdf": 6,
    "ur_description/urdf/ur3_robot.urdf": 6,
    "ur_description/urdf/ur5_gripper.urdf": 6,
    "ur_description/urdf/ur5_joint_limited_robot.urdf": 6,
    "ur_description/urdf/ur5_robot.urdf": 6,
    "xarm_description/urdf/xarm7.urdf": 7,
    "z1_description/urdf/z1.urdf": 7,
}

REPAIRED: dict[str, tuple[str, ...]] = {
    "alex_description/urdf/alex_nub_hands.urdf": (SHELL,),
    "alex_description/urdf/alex_psyonic_hands.urdf": (INERTIA,),
    "allegro_hand_description/urdf/allegro_left_hand.urdf": (INERTIA,),
    "allegro_hand_description/urdf/allegro_right_hand.urdf": (INERTIA,),
    "anymal_b_simple_description/robots/anymal-kinova.urdf": (
        COLOUR,
        INERTIA,
    ),
    "anymal_b_simple_description/robots/anymal.urdf": (
        COLOUR,
        INERTIA,
    ),
    "anymal_c_simple_description/urdf/anymal.urdf": (INERTIA,),
    "b1_description/urdf/b1-z1.urdf": (INERTIA,),
    "b1_description/urdf/b1.urdf": (INERTIA,),
    "centauro_description/urdf/centauro.urdf": (EMPTY,),
    "double_pendulum_description/urdf/double_pendulum.urdf": (EMPTY,),
    "double_pendulum_description/urdf/double_pendulum_simple.urdf": (EMPTY,),
    "finger_edu_description/robots/finger_edu.urdf": (INERTIA,),
    "go1_description/urdf/go1.urdf": (INERTIA,),
    "human_description/robots/human.urdf": (INERTIA,),
    "hyq_description/robots/hyq_no_sensors.urdf": (INERTIA,),
    "icub_description/robots/icub.urdf": (INERTIA,),
    "icub_description/robots/icub_reduced.urdf": (INERTIA,),
    "pr2_description/urdf/pr2.urdf": (INERTIA,),
    "quadruped_description/urdf/quadruped.urdf": (EMPTY,),
    "romeo_description/urdf/romeo.urdf": (INERTIA,),
    "romeo_description/urdf/romeo_small.urdf": (INERTIA,),
    "simple_humanoid_description/urdf/simple_humanoid.urdf": (STL,),
    "tiago_description/robots/tiago.urdf": (INERTIA,),
    "tiago_description/robots/tiago_dual.urdf": (INERTIA,),
    "tiago_description/robots/tiago_no_hand.urdf": (INERTIA,),
}
"""What is said of a robot that loads; of the others nothing."""

NOT_LOADABLE: dict[str, str] = {
    "romeo_description/urdf/romeo_laas_small.urdf": "mesh files are missing",
    "ur_description/urdf/ur3.urdf": "the robot has no <link>",
}
"""What the error says."""
