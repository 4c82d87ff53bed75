"""Each number of a list goes with the name it was written for; maps cover all columns."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from embodichain.lab.gym.envs.cfg import (
    ActionTermCfg,
    EventCfg,
    MetricCfg,
    NoiseCfg,
    ObservationCfg,
    RewardCfg,
)
from embodichain.lab.sim.cfg import RobotCfg
from embodichain.lab.sim.compiler.alternatives import unmatched_alternatives
from embodichain.lab.sim.configs.drive_cfg import JointDrivePropertiesCfg
from embodichain.lab.sim.sensors import ContactSensorCfg, LinksCfg
from embodichain.utils.errors import ConfigError
from tests.helpers.ur10_task import UR10

SWAPPED = ["Joint2", "Joint1"]


def of(names: Any = None, **more: Any) -> dict[str, Any]:
    return {"uid": "ur10", **({} if names is None else {"joint_names": names}), **more}


def arm(names: Any = None, func: str = "joint_action", **params: Any) -> ActionTermCfg:
    reference = names if isinstance(names, dict) else of(names)
    return ActionTermCfg(func, {"entity_cfg": reference, **params})


def targets(env: Any, action: list[float]) -> list[float]:
    """Targets of Joint1 and Joint2 after a step, if the drives may move as fast as they want."""
    env.reset()
    env.step(torch.tensor([action] * env.num_envs))
    found: list[float] = env.robot.drives.read_target_qpos()[0, :2].tolist()
    return found


def robot(**more: Any) -> RobotCfg:
    return RobotCfg(uid="ur10", fpath=UR10, init_pos=(0, 0, 1), **more)


def problem(make: Any, **sections: Any) -> Any:
    with pytest.raises(ConfigError) as caught:
        make(**sections)
    return caught.value.problems[0]


# -- actions -----------------------------------------------------------------------------------


def test_numbers_of_an_action_go_with_their_names(make: Any) -> None:
    term = arm(SWAPPED, scale=[0.3, 0.1], offset=[0.0, 0.5], clip=[[-1, 1], [-2, 2]])
    env = make(robot=robot(), actions={"arm": term})
    # Columns stay in the robot's order: Joint1 = 0.5 + 0.1 x 1, Joint2 = 0 + 0.3 x -1.
    assert env.action_manager.names == ("arm/Joint1", "arm/Joint2")
    assert targets(env, [1.0, -1.0]) == pytest.approx([0.6, -0.3])
    assert env.action_manager.high.tolist() == [2.0, 1.0]


def test_with_preserve_order_the_columns_are_as_written(make: Any) -> None:
    reference = of(SWAPPED, preserve_order=True)
    term = arm(reference, scale=[0.3, 0.1], offset=[0.0, 0.5], clip=[[-1, 1], [-2, 2]])
    env = make(robot=robot(), actions={"arm": term})
    assert env.action_manager.names == ("arm/Joint2", "arm/Joint1")
    assert targets(env, [1.0, -1.0]) == pytest.approx([0.4, 0.3])
    assert env.action_manager.high.tolist() == [1.0, 2.0]


def test_numbers_go_with_joint_ids(make: Any) -> None:
    term = arm(of(joint_ids=[1, 0]), scale=[0.3, 0.1], clip=[-1, 1])
    env = make(robot=robot(), actions={"arm": term})
    assert env.action_manager.names == ("arm/Joint2", "arm/Joint1")  # as before: ids are an order
    assert targets(env, [1.0, 1.0]) == pytest.approx([0.1, 0.3])


def test_a_list_without_names_is_in_the_robots_order(make: Any) -> None:
    term = arm(scale=[0.1, 0.2, 0.3, 0.4, 0.5, 0.6], clip=[-1, 1])
    env = make(robot=robot(), actions={"arm": term})
    assert targets(env, [1.0] * 6) == pytest.approx([0.1, 0.2])


@pytest.mark.parametrize("ordered", [False, True])
@pytest.mark.parametrize(
    ("key", "value", "written"),
    [
        ("scale", [0.3, 0.1], "scale: {Joint1: 0.3, Joint2: 0.1}"),
        ("offset", [0, 0.1], "offset: {Joint1: 0, Joint2: 0.1}"),
        ("clip", [[-1, 1], [-2, 2]], "clip: {Joint1: [-1, 1], Joint2: [-2, 2]}"),
        ("scale", [0.3, 0.1, 1], "scale: {Joint1: ..., Joint2: ...}"),
    ],
)
def test_a_list_beside_a_regex_of_several_names_is_refused(
    make: Any, key: str, value: Any, written: str, ordered: bool
) -> None:
    term = arm(of(["Joint[12]"], preserve_order=ordered), **{key: value})
    found = problem(make, actions={"arm": term})
    assert found.path == f"actions.arm.params.{key}"
    assert "'Joint[12]' matches several: Joint1, Joint2" in found.message
    assert written in found.hint


def test_a_regex_of_one_name_is_a_name(make: Any) -> None:
    term = arm([".*2", ".*1"], scale=[0.3, 0.1], clip=[-1, 1])
    env = make(robot=robot(), actions={"arm": term})
    assert targets(env, [1.0, 1.0]) == pytest.approx([0.1, 0.3])


def test_a_joint_named_twice_has_no_two_numbers(make: Any) -> None:
    found = problem(make, actions={"arm": arm(["Joint1", "Joint1"], scale=[0.3, 0.1])})
    assert "several numbers for Joint1" in found.message
    found = problem(make, actions={"arm": arm(SWAPPED, scale=[0.3])})
    assert "one value or 2, one a joint: Joint2, Joint1; got 1" in found.message


def test_parts_in_another_order_than_the_columns_need_a_map(make: Any) -> None:
    parts = {"turned": ["Joint2", "Joint1"], "first": ["Joint[12]"]}
    term = arm(of(control_parts="first"), scale=[0.1, 0.3], clip=[-1, 1])
    env = make(robot=robot(control_parts=parts), actions={"arm": term})
    assert targets(env, [1.0, 1.0]) == pytest.approx([0.1, 0.3])
    term = arm(of(control_parts="turned"), scale=[0.3, 0.1])
    found = problem(make, robot=robot(control_parts=parts), actions={"arm": term})
    assert "the order of a list is not clear" in found.message
    assert "scale: {Joint1: 0.3, Joint2: 0.1}" in found.hint


def test_names_of_terms_that_stand_for_others(make: Any) -> None:
    term = arm(SWAPPED, "relative_joint_position", scale=[0.3, 0.1])
    env = make(robot=robot(), actions={"arm": term})
    env.reset()
    env.step(torch.tensor([[1.0, 1.0]] * env.num_envs))
    found = env.robot.drives.read_target_qpos()[0, :2]
    assert found.tolist() == pytest.approx([0.1, 0.3], abs=1e-6)


def test_speeds_of_the_joints_that_move_a_tool(make: Any) -> None:
    names = [f"Joint{i}" for i in (6, 5, 4, 3, 2, 1)]
    speeds = [0.6, 0.5, 0.4, 0.3, 0.2, 0.1]
    env = make(actions={"arm": arm(names, "eef_delta_pose", max_velocity=speeds)})
    term = env.action_manager.terms["arm"].instance
    # The term's limits in its own order; what they do is tested in test_eef_actions.py.
    assert (term._largest_change / env.step_dt).tolist() == pytest.approx(
        [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]
    )


# -- maps --------------------------------------------------------------------------------------


@pytest.mark.parametrize("key", ["scale", "offset"])
def test_maps_cover_all_columns_or_have_a_default(make: Any, key: str) -> None:
    found = problem(make, actions={"arm": arm(**{key: {"Joint[1-5]": 0.5}})})
    assert found.path == f"actions.arm.params.{key}"
    assert found.message == "says nothing about joints: Joint6"
    assert '".*"' in found.hint
    term = arm(scale={"Joint1": 0.5, ".*": 0.25}, clip=[-1, 1])
    env = make(robot=robot(), actions={"arm": term})
    assert targets(env, [1.0] * 6) == pytest.approx([0.5, 0.25])


def test_columns_of_a_tool_are_covered_too(make: Any) -> None:
    found = problem(make, actions={"arm": arm(None, "eef_delta_pose", scale={"[xyz]": 0.01})})
    assert found.message == "says nothing about columns: rx, ry, rz"


def test_a_clip_keeps_the_limits_of_joints_it_does_not_name(make: Any) -> None:
    env = make(actions={"arm": arm(clip={"Joint1": [-0.5, 0.5]})})
    limits = np.asarray(env.robot.parsed.qpos_limits)
    assert env.action_manager.high[0] == 0.5
    assert env.action_manager.high[1:].tolist() == pytest.approx(limits[1:, 1].tolist())


# -- alternatives ------------------------------------------------------------------------------

NAMES = ["FL_hip", "FR_hip", "FL_calf", "bar|r"]


@pytest.mark.parametrize(
    ("pattern", "unmatched"),
    [
        ("FL_hip|FR_hip", []),
        ("FL_hip|FR_hop", ["FR_hop"]),
        ("(FL|RR)_(hip|calf)", ["RR"]),
        ("(?P<side>FL|Q)_hip|(?:FR_hip|z)", ["Q", "z"]),
        ("((a|b)|FL)_hip", ["(a|b)"]),
        ("(?!FR|XX).*", []),
        (r"bar\|r|FL_hip", []),
        ("bar[|]r|[]|]", ["[]|]"]),
        ("FL_hip|", [""]),
    ],
)
def test_alternatives_that_match_nothing(pattern: str, unmatched: list[str]) -> None:
    assert unmatched_alternatives(pattern, NAMES) == unmatched


def test_references_and_maps_name_such_alternatives(make: Any) -> None:
    found = problem(make, actions={"arm": arm("Joint1|Joitn2")})
    assert found.path == "actions.arm.params.entity_cfg.joint_names"
    assert "the alternative 'Joitn2' of 'Joint1|Joitn2'" in found.message
    assert "Joint2" in found.hint
    found = problem(make, actions={"arm": arm(scale={"Joint1|Jo2": 1, ".*": 2})})
    assert found.path == "actions.arm.params.scale.Joint1|Jo2"
    links = {"uid": "ur10", "link_names": "ee_link|ee_lnik"}
    term = ObservationCfg("link_pose", {"of": links})
    assert "'ee_lnik'" in problem(make, observations={"pose": term}).message
    feet = ContactSensorCfg(entity_cfg=LinksCfg("ur10", "(ee|eee)_link"))
    assert "'eee'" in problem(make, sensors={"feet": feet}).message


def test_drives_may_name_joints_that_a_robot_lacks(make: Any) -> None:
    drives = JointDrivePropertiesCfg(stiffness={"Joint1|elbow": 50.0, "Joint[2-6]": 60.0})
    env = make(robot=robot(drive_pros=drives))
    assert env.robot.parsed.stiffness.tolist() == [50.0, 60.0, 60.0, 60.0, 60.0, 60.0]


# -- observations, events, shapes ----------------------------------------------------------------


def test_factors_of_an_observation_go_with_their_names(make: Any) -> None:
    home = robot(init_qpos=[0.5, -1.0, 0, 0, 0, 0])
    cfg = {"of": of(SWAPPED)}
    env = make(
        robot=home,
        observations={
            "listed": ObservationCfg("joint_position", cfg, scale=[10.0, 100.0]),
            "mapped": ObservationCfg("joint_position", cfg, scale={"Joint1": 100.0, ".*": 10.0}),
            "biased": ObservationCfg(
                "joint_position", cfg, noise=NoiseCfg("constant", bias=[10.0, 100.0])
            ),
            "drawn": ObservationCfg(
                "joint_position", cfg, noise=NoiseCfg("gaussian", std={"Joint1": 0.0, ".*": 1.0})
            ),
        },
    )
    obs, _ = env.reset()
    assert obs["listed"][0].tolist() == [50.0, -10.0]
    assert obs["mapped"][0].tolist() == [50.0, -10.0]
    assert obs["biased"][0].tolist() == [100.5, 9.0]
    assert obs["drawn"][0, 0] == 0.5 and obs["drawn"][0, 1] != -1.0


def test_factors_of_contacts_go_with_links(make: Any) -> None:
    links = ["ee_link", "forearm_link"]
    env = make(
        sensors={"touch": ContactSensorCfg(entity_cfg=LinksCfg("ur10", links))},
        observations={
            "touch": ObservationCfg(
                "contact_found",
                {"sensor": "touch"},
                noise=NoiseCfg("constant", bias=[1.0, 2.0]),
            )
        },
    )
    assert env.sensors["touch"].names == ("forearm_link", "ee_link")  # the robot's order
    assert env.reset()[0]["touch"][0].tolist() == [2.0, 1.0]


def test_lists_of_an_observation_beside_a_regex_are_refused(make: Any) -> None:
    cfg = {"of": of("Joint[12]")}
    found = problem(make, observations={"q": ObservationCfg("joint_position", cfg, scale=[1, 2])})
    assert found.path == "observations.q.scale"
    assert "scale: {Joint1: 1, Joint2: 2}" in found.hint
    noise = NoiseCfg("gaussian", std=[1, 2])
    found = problem(make, observations={"q": ObservationCfg("joint_position", cfg, noise=noise)})
    assert found.path == "observations.q.noise.std"
    cfg = {"of": of(SWAPPED)}
    term = ObservationCfg("joint_sin_cos", cfg, scale=[1, 2, 3, 4])
    assert "in the order of the columns" in problem(make, observations={"q": term}).message


def test_a_map_must_cover_an_observation_too(make: Any) -> None:
    cfg = {"of": of(SWAPPED)}
    term = ObservationCfg("joint_position", cfg, scale={"Joint1": 2.0})
    found = problem(make, observations={"q": term})
    assert found.path == "observations.q.scale"
    assert found.message == "says nothing about joints: Joint2"
    noise = NoiseCfg("uniform", low={"Joint1": 1.0, ".*": 0.0}, high=0.5)
    found = problem(make, observations={"q": ObservationCfg("joint_position", cfg, noise=noise)})
    assert found.message == "low exceeds high for Joint1"


def test_noise_of_an_action_goes_with_its_names(make: Any) -> None:
    term = arm(SWAPPED, clip=[-1, 1])
    term.noise = NoiseCfg("constant", bias=[0.2, 0.1])
    env = make(robot=robot(), actions={"arm": term})
    assert targets(env, [0.0, 0.0]) == pytest.approx([0.1, 0.2])


def test_positions_of_a_reset_go_with_their_names(make: Any) -> None:
    def start(**params: Any) -> list[float]:
        event = EventCfg("reset_joints", {"of": of(SWAPPED), "operation": "abs", **params})
        env = make(robot=robot(), events={"start": event})
        env.reset()
        found: list[float] = env.robot.get_qpos()[0, :2].tolist()
        return found

    assert start(position_range=[[0.2, 0.1], [0.2, 0.1]]) == pytest.approx([0.1, 0.2])
    by_name = {"Joint1": [0.1, 0.1], ".*": [0.2, 0.2]}
    assert start(position_range=by_name) == pytest.approx([0.1, 0.2])
    event = EventCfg("reset_joints", {"of": of("Joint[12]"), "position_range": [[0, 1], [2, 3]]})
    found = problem(make, events={"start": event})
    assert "position_range: {Joint1: [0, 2], Joint2: [1, 3]}" in found.hint


def test_bounds_of_a_shape_go_with_their_names(make: Any) -> None:
    start = [0.5, -1.0, 0.0, 0.0, 0.0, 0.0]
    home = robot(init_qpos=start)

    def inside(bounds: Any, names: Any) -> bool:
        metric = MetricCfg(
            "joint_position", {"of": of(names)}, shape={"within": {"bounds": bounds}}
        )
        env = make(robot=home, metrics={"inside": metric})
        env.reset()
        info = env.step(torch.tensor([start] * env.num_envs))[4]
        return bool(info["metrics"]["inside"][0])

    assert inside([[-1.1, 0.4], [-0.9, 0.6]], SWAPPED)
    assert not inside([[0.4, -1.1], [0.6, -0.9]], SWAPPED)
    assert inside({"Joint1": [0.4, 0.6], "Joint2": [-1.1, -0.9]}, "Joint[12]")
    metric = MetricCfg(
        "joint_position", {"of": of("Joint[12]")}, shape={"within": [[0, 1], [2, 3]]}
    )
    found = problem(make, metrics={"inside": metric})
    assert found.path == "metrics.inside.shape.within.bounds"


# -- gaits ---------------------------------------------------------------------------------------


def test_offsets_of_a_gait_go_with_the_links_of_the_sensor(make: Any) -> None:
    """At the phase 0.25 a foot should be high, at 0.75 it should stand: here neither does."""

    def gait(links: Any, offsets: Any) -> float:
        sensor = ContactSensorCfg(entity_cfg=LinksCfg("ur10", links))
        params = {"sensor": "feet", "period_s": 1e6, "offsets": offsets, "width": 10.0}
        env = make(
            sensors={"feet": sensor}, rewards={"gait": RewardCfg("feet_gait", params, weight=1.0)}
        )
        env.reset()
        height = env.robot.get_link_pose("ee_link")[0, 2].item()
        assert height != pytest.approx(env.robot.get_link_pose("forearm_link")[0, 2].item())
        return float(env.step(torch.zeros(env.num_envs, 6))[1][0])

    swings = gait(["forearm_link", "ee_link"], [0.25, 0.75])  # the forearm swings
    assert gait(["ee_link", "forearm_link"], [0.75, 0.25]) == swings
    assert gait(["ee_link", "forearm_link"], {"forearm_link": 0.25, "ee.*": 0.75}) == swings
    assert gait(["ee_link", "forearm_link"], [0.25, 0.75]) != swings


def test_offsets_beside_a_regex_are_refused(make: Any) -> None:
    sensor = ContactSensorCfg(entity_cfg=LinksCfg("ur10", ["wrist_[12]_link"]))
    params = {"sensor": "feet", "period_s": 1.0, "offsets": [0, 0.5]}
    found = problem(make, sensors={"feet": sensor}, rewards={"g": RewardCfg("feet_gait", params)})
    assert found.path == "rewards.g.params.offsets"
    assert "offsets: {wrist_1_link: 0, wrist_2_link: 0.5}" in found.hint


# -- actuators -----------------------------------------------------------------------------------

_RIG = """<mujoco><compiler angle="radian"/><worldbody><body name="base"><geom size=".1"/>
<body name="a"><joint name="ja" axis="0 1 0" range="-2 2"/><geom size=".02" pos="0 0 .2"/></body>
<body name="b"><joint name="jb" axis="0 1 0" range="-2 2"/><geom size=".02" pos=".2 0 0"/></body>
</body></worldbody>
<actuator><position name="ma" joint="ja" kp="9" ctrlrange="-2 2"/>
<position name="mb" joint="jb" kp="9" ctrlrange="-2 2"/></actuator></mujoco>"""


def rig(tmp_path: Path) -> RobotCfg:
    path = tmp_path / "rig.xml"
    path.write_text(_RIG)
    return RobotCfg(uid="ur10", fpath=str(path), init_pos=(0, 0, 1))


def test_numbers_go_with_actuators(make: Any, tmp_path: Path) -> None:
    params = {"entity_cfg": of(), "actuator_names": ["mb", "ma"], "scale": [0.3, 0.1]}
    env = make(robot=rig(tmp_path), actions={"ctrl": ActionTermCfg("actuator_ctrl", params)})
    env.reset()
    env.step(torch.tensor([[1.0, 1.0]] * env.num_envs))
    assert env.robot.read_ctrl()[0].tolist() == pytest.approx([0.1, 0.3])
    params = {**params, "actuator_names": "m."}
    actions = {"ctrl": ActionTermCfg("actuator_ctrl", params)}
    found = problem(make, robot=rig(tmp_path), actions=actions)
    assert "scale: {ma: 0.3, mb: 0.1}" in found.hint


def test_ends_of_a_gripper_go_with_their_joints(make: Any, tmp_path: Path) -> None:
    params = {"entity_cfg": of(["jb", "ja"]), "lower_command": 0, "upper_command": [0.4, 0.2]}
    env = make(robot=rig(tmp_path), actions={"grip": ActionTermCfg("parallel_gripper", params)})
    env.reset()
    env.step(torch.tensor([[1.0]] * env.num_envs))
    assert env.robot.read_ctrl()[0].tolist() == pytest.approx([0.2, 0.4])
