"""Sensors, cameras, views, tools and attached files at sites and geoms of a robot's file."""

import mujoco
import numpy as np
import pytest

from embodichain.cli.new_task.new_robot import describe_robot
from embodichain.lab.gym.envs.cfg import ObservationCfg, RewardCfg
from embodichain.lab.gym.expert.targets import TargetPoses, check_target
from embodichain.lab.sim.cfg import AttachedFileCfg, AttachmentCfg, RobotCfg, SolverCfg
from embodichain.lab.sim.compiler.robot.articulation import parse_articulation, parse_with_problems
from embodichain.lab.sim.configs.scene_cfg import ViewCfg
from embodichain.lab.sim.sensors import (
    CameraCfg,
    ContactSensorCfg,
    ExtrinsicsCfg,
    ForceTorqueSensorCfg,
    FramePoseSensorCfg,
    HeightScanSensorCfg,
    ImuSensorCfg,
    LinksCfg,
    RayGridCfg,
    RayPatternCfg,
    RaySensorCfg,
)
from embodichain.lab.sim.shapes import SphereCfg
from embodichain.utils.errors import ConfigError
from tests.helpers.framed_robots import ARM, LEGS, quadruped
from tests.lab.gym.references.test_frames import make, of_mujoco, shake  # noqa: F401

FEET = LinksCfg(uid="r", geom_names="[FR][LR]")


def rotation(quat) -> np.ndarray:
    turned = np.zeros(9)
    mujoco.mju_quat2Mat(turned, np.asarray(quat, np.float64))
    return turned.reshape(3, 3)


def test_contacts_of_feet_that_are_geoms(make) -> None:  # noqa: F811
    sensors = {"feet": ContactSensorCfg(of=FEET, against=LinksCfg(uid="default_plane"))}
    rewards = {
        "slide": RewardCfg(func="feet_slide", params={"sensor": "feet"}),
        "gait": RewardCfg(
            func="feet_gait",
            params={"sensor": "feet", "period_s": 0.5, "offsets": {"FR|RL": 0, "FL|RR": 0.5}},
        ),
    }
    env = make(sensors=sensors, rewards=rewards)
    for _ in range(150):
        env.sim.engine.step(4)
    env.sim.engine.forward()  # forces of this state, not of the last step's begin
    engine, sensor = env.sim.engine, env.sensors["feet"]
    assert list(sensor.names) == list(LEGS)
    found, force = sensor.read_found(), sensor.read_force()
    slide = env.reward_manager.terms["slide"]
    expected = np.zeros(3)
    for i in range(3):
        data, model = engine.data_of(i), engine.model
        for j, name in enumerate(LEGS):
            geom = model.geom(f"r/{name}").id
            contacts = [c for c in range(data.ncon) if geom in data.contact[c].geom]
            assert bool(found[i, j]) == bool(contacts)
            wrench, both = np.zeros(6), np.zeros(6)
            total = np.zeros(3)
            for c in contacts:
                mujoco.mj_contactForce(model, data, c, wrench)
                sign = 1.0 if data.contact[c].geom[1] == geom else -1.0
                total += sign * data.contact[c].frame.reshape(3, 3).T @ wrench[:3]
            np.testing.assert_allclose(force[i, j], total, atol=1e-6)
            mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_GEOM, geom, both, 0)
            expected[i] += np.hypot(*both[3:5]) * (np.linalg.norm(force[i, j]) > 1.0)
    assert found.any()
    np.testing.assert_allclose(slide.call(env), expected, atol=1e-9)


def test_contacts_with_geoms_of_another_entity(make) -> None:  # noqa: F811
    sensors = {
        "board": ContactSensorCfg(
            of=LinksCfg(uid="cube"), against=LinksCfg(uid="shelf", geom="board")
        ),
        "other": ContactSensorCfg(
            of=LinksCfg(uid="cube"), against=LinksCfg(uid="crate", geom_names=".*")
        ),
    }
    env = make(sensors=sensors)
    at = np.tile([-1.0, 0.0, 0.0595, 1, 0, 0, 0], (3, 1))
    env.sim.rigid_objects["cube"].write_pose(at[:, :3], at[:, 3:])
    env.sim.engine.step(3)
    assert env.sensors["board"].read_found().all()
    assert not env.sensors["other"].read_found().any()


@pytest.mark.parametrize("offset", [False, True])
@pytest.mark.parametrize(("kind", "name"), [("site", "FL_foot"), ("geom", "FL")])
def test_a_frame_sensor_at_a_site_or_geom(make, kind, name, offset) -> None:  # noqa: F811
    moved = {"pos": (0.1, 0.2, -0.1), "quat": (0.5, 0.5, -0.5, 0.5)} if offset else {}
    cfg = FramePoseSensorCfg(of=LinksCfg(uid="r", **{kind: name}), **moved)
    env = make(sensors={"frame": cfg})
    shake(env)
    sensor = env.sensors["frame"]
    pos, axes, linear, angular = of_mujoco(env, kind, f"r/{name}")
    shift = np.einsum("nij,j->ni", axes, np.asarray(moved.get("pos", (0, 0, 0)), float))
    turn = rotation(moved.get("quat", (1, 0, 0, 0)))
    np.testing.assert_allclose(sensor.read_position(), pos + shift, atol=1e-9)
    expected = linear + np.cross(angular, shift)
    np.testing.assert_allclose(sensor.read_linear_velocity(), expected, atol=1e-9)
    np.testing.assert_allclose(sensor.read_angular_velocity(), angular, atol=1e-9)
    for quat, own in zip(sensor.read_orientation(), axes, strict=True):
        np.testing.assert_allclose(rotation(quat), own @ turn, atol=1e-9)


def test_a_frame_relative_to_a_site(make) -> None:  # noqa: F811
    cfg = FramePoseSensorCfg(
        of=LinksCfg(uid="r", geom="RR"), relative_to=LinksCfg(uid="r", site="imu")
    )
    env = make(sensors={"frame": cfg})
    shake(env)
    pos, *_ = of_mujoco(env, "geom", "r/RR")
    at, axes, *_ = of_mujoco(env, "site", "r/imu")
    expected = np.einsum("nji,nj->ni", axes, pos - at)
    np.testing.assert_allclose(env.sensors["frame"].read_position(), expected, atol=1e-9)


def test_an_imu_and_a_force_at_a_site(make) -> None:  # noqa: F811
    sensors = {
        "imu": ImuSensorCfg(of=LinksCfg(uid="r", site="imu")),
        "knee": ForceTorqueSensorCfg(of=LinksCfg(uid="r", site_names=["FL_foot"])),
        "link": ForceTorqueSensorCfg(of=LinksCfg(uid="r", link_names=["FL_calf"])),
    }
    env = make(sensors=sensors)
    shake(env)
    _, axes, _, angular = of_mujoco(env, "site", "r/imu")
    gyro = np.einsum("nji,nj->ni", axes, angular)
    np.testing.assert_allclose(env.sensors["imu"].read_angular_velocity(), gyro, atol=1e-9)
    # The same force, in other axes; its moment about another point.
    pos, foot, *_ = of_mujoco(env, "site", "r/FL_foot")
    at, calf, *_ = of_mujoco(env, "link", "r/FL_calf")
    env.sim.engine.forward()
    force = np.einsum("nij,nj->ni", foot, env.sensors["knee"].read_force()[:, 0])
    same = np.einsum("nij,nj->ni", calf, env.sensors["link"].read_force()[:, 0])
    np.testing.assert_allclose(force, same, atol=1e-7)
    moment = np.einsum("nij,nj->ni", foot, env.sensors["knee"].read_torque()[:, 0])
    there = np.einsum("nij,nj->ni", calf, env.sensors["link"].read_torque()[:, 0])
    np.testing.assert_allclose(moment, there + np.cross(at - pos, same), atol=1e-7)


@pytest.mark.parametrize(("kind", "name"), [("site", "imu"), ("geom", "FL")])
def test_rays_start_at_a_site_or_geom(make, kind, name) -> None:  # noqa: F811
    where = LinksCfg(uid="r", **{kind: name})
    sensors = {
        "down": RaySensorCfg(
            of=where, alignment="world", pattern=RayPatternCfg(directions=[(0, 0, -1)])
        ),
        "scan": HeightScanSensorCfg(
            of=where,
            hit=["default_plane"],
            pattern=RayPatternCfg(grid=RayGridCfg(size=(0.2, 0.2), resolution=0.1)),
        ),
    }
    env = make(sensors=sensors)
    shake(env, 2)
    height = of_mujoco(env, kind, f"r/{name}")[0][:, 2]
    np.testing.assert_allclose(env.sensors["down"].read_distance()[:, 0], height, atol=1e-6)
    np.testing.assert_allclose(env.sensors["scan"].read_height(), height[:, None] + np.zeros(9))


@pytest.mark.parametrize("parent", [None, "FL_foot", "r/site:FL_foot"])
def test_a_camera_at_a_site(make, parent) -> None:  # noqa: F811
    where = LinksCfg(uid="r", site="FL_foot") if parent is None else LinksCfg()
    pose = {"pos": (0.05, -0.02, 0.1), "quat": (0.5, 0.5, 0.5, 0.5)}
    camera = CameraCfg(width=8, height=8, of=where, extrinsics=ExtrinsicsCfg(parent=parent, **pose))
    env = make(sensors={"eye": camera})
    shake(env)
    pos, axes, *_ = of_mujoco(env, "site", "r/FL_foot")
    at, quat = env.sensors["eye"].read_pose()
    shift = np.einsum("nij,j->ni", axes, np.asarray(pose["pos"]))
    np.testing.assert_allclose(at, pos + shift, atol=1e-9)
    for one, own in zip(quat, axes, strict=True):
        np.testing.assert_allclose(rotation(one), own @ rotation(pose["quat"]), atol=1e-9)


@pytest.mark.parametrize("follow", ["position", "pose"])
def test_a_view_follows_a_site(make, follow) -> None:  # noqa: F811
    view = ViewCfg(eye=(0.3, 0.2, 0.1), body="r/FL_foot", follow=follow)
    env = make(views={"near": view})
    start = of_mujoco(env, "site", "r/FL_foot")
    index = env.sim.engine.model.camera("near").id
    eyes = [env.sim.engine.derived("cam_xpos")[:, index].copy()]
    shake(env)
    now = of_mujoco(env, "site", "r/FL_foot")
    eyes.append(env.sim.engine.derived("cam_xpos")[:, index].copy())
    if follow == "position":
        np.testing.assert_allclose(eyes[1] - now[0], [[0.3, 0.2, 0.1]] * 3, atol=1e-9)
    else:
        local = [
            np.einsum("nji,nj->ni", a, e - p)
            for e, (p, a, *_) in zip(eyes, (start, now), strict=True)
        ]
        np.testing.assert_allclose(local, [[[0.3, 0.2, 0.1]] * 3] * 2, atol=1e-9)


SENSOR_MISTAKES = {
    "site of contacts": (
        ContactSensorCfg(of=LinksCfg(uid="r", site="imu")),
        "a site touches nothing",
    ),
    "against a site": (
        ContactSensorCfg(of=FEET, against=LinksCfg(uid="r", site="imu")),
        r"against\.site_names: a site touches nothing",
    ),
    "unknown geom": (
        ContactSensorCfg(of=LinksCfg(uid="r", geom_names="FX")),
        "no geom of 'r' matches 'FX'",
    ),
    "two kinds": (
        ImuSensorCfg(of=LinksCfg(uid="r", site="imu", geom="FR")),
        "geom: site is given as well",
    ),
    "several": (
        ImuSensorCfg(of=LinksCfg(uid="r", geom_names="F.")),
        "one geom is wanted, these match: FR, FL",
    ),
    "frame twice": (
        FramePoseSensorCfg(of=LinksCfg(uid="r", geom="FR"), site="imu"),
        "site: give a site or geom, not both",
    ),
}


@pytest.mark.parametrize("case", SENSOR_MISTAKES)
def test_mistakes_in_sensors(make, case) -> None:  # noqa: F811
    cfg, message = SENSOR_MISTAKES[case]
    with pytest.raises(ConfigError, match=message):
        make(sensors={"it": cfg})


# -- the robot's own config ------------------------------------------------------------------------


@pytest.fixture
def arm(tmp_path):
    (tmp_path / "arm.xml").write_text(ARM)
    (tmp_path / "hand.xml").write_text(
        "<mujoco><worldbody><body name='palm'><geom name='pad' type='box' size='.02 .02 .02'/>"
        "<site name='pinch' pos='0 0 0.05'/></body></worldbody></mujoco>"
    )

    def build(**kwargs):
        return RobotCfg(uid="arm", fpath=str(tmp_path / "arm.xml"), **kwargs)

    build.hand = str(tmp_path / "hand.xml")
    return build


def at_rest(parsed):
    data = mujoco.MjData(parsed.model)
    mujoco.mj_forward(parsed.model, data)
    return data


def test_a_site_is_the_tool_of_a_part(arm) -> None:
    solver = {"arm": SolverCfg(end_site_name="tcp")}
    parts = {"arm": ["j."]}
    parsed = parse_articulation("arm", arm(control_parts=parts, solver_cfg=solver))
    assert parsed.tools == {"arm": "arm_tcp"}
    data = at_rest(parsed)
    np.testing.assert_allclose(data.body("arm_tcp").xpos, data.site("tcp").xpos, atol=1e-12)
    np.testing.assert_allclose(data.body("arm_tcp").xmat, data.site("tcp").xmat, atol=1e-12)


def test_a_tool_point_in_the_frame_of_a_site(arm) -> None:
    shift = np.eye(4)
    shift[:3, 3] = 0.0, 0.0, 0.1
    solver = SolverCfg(end_site_name="tcp", tcp=shift.tolist())
    data = at_rest(parse_articulation("arm", arm(solver_cfg=solver)))
    axes = data.site("tcp").xmat.reshape(3, 3)
    expected = data.site("tcp").xpos + 0.1 * axes[:, 2]
    np.testing.assert_allclose(data.body("tcp").xpos, expected, atol=1e-12)


def test_a_file_and_a_shape_at_a_site(arm) -> None:
    cfg = arm(
        attach={"hand": AttachedFileCfg(fpath=arm.hand, to="tcp", pos=(0, 0, 0.02))},
        attachments={"ball": AttachmentCfg(site="tcp", shape=SphereCfg(radius=0.01))},
    )
    data = at_rest(parse_articulation("arm", cfg))
    axes = data.site("tcp").xmat.reshape(3, 3)
    np.testing.assert_allclose(data.body("ball").xpos, data.site("tcp").xpos, atol=1e-12)
    expected = data.site("tcp").xpos + 0.02 * axes[:, 2]
    np.testing.assert_allclose(data.body("hand/palm").xpos, expected, atol=1e-12)
    np.testing.assert_allclose(data.body("hand/palm").xmat.reshape(3, 3), axes, atol=1e-12)


def test_a_second_file_at_a_site_of_the_first(arm) -> None:
    one = AttachedFileCfg(fpath=arm.hand, to="hand")
    two = AttachedFileCfg(fpath=arm.hand, to="one/pinch")
    data = at_rest(parse_articulation("arm", arm(attach={"one": one, "two": two})))
    np.testing.assert_allclose(data.body("two/palm").xpos, data.site("one/pinch").xpos, atol=1e-12)


ROBOT_MISTAKES = {
    "unknown site": (
        {"solver_cfg": SolverCfg(end_site_name="tpc")},
        "solver_cfg.default.end_site_name",
        "no site is called 'tpc'",
    ),
    "site as a link": (
        {"solver_cfg": SolverCfg(end_link_name="tcp")},
        "solver_cfg.default.end_link_name",
        "no link is called 'tcp'",
    ),
    "both": (
        {"solver_cfg": SolverCfg(end_link_name="hand", end_site_name="tcp")},
        "solver_cfg.default.end_site_name",
        "end_link_name is given as well",
    ),
    "attached nowhere": (
        {"attach": {"x": AttachedFileCfg(fpath="x.xml", to="tpc")}},
        "attach.x.to",
        "sites: tcp; geoms: ",
    ),
    "shape at two": (
        {"attachments": {"b": AttachmentCfg(link="hand", site="tcp", shape=SphereCfg())}},
        "attachments.b.site",
        "link is given as well",
    ),
    "shape nowhere": (
        {"attachments": {"b": AttachmentCfg(site="tpc", shape=SphereCfg())}},
        "attachments.b.site",
        "no site is called 'tpc'",
    ),
}


@pytest.mark.parametrize("case", ROBOT_MISTAKES)
def test_mistakes_of_a_robot(arm, case) -> None:
    given, path, message = ROBOT_MISTAKES[case]
    _, problems = parse_with_problems("arm", arm(**given))
    assert [p for p in problems if p.path == path and message in p.message], problems


def test_the_feet_of_a_quadruped_are_offered(tmp_path) -> None:
    (tmp_path / "quad.xml").write_text(quadruped())
    parsed = parse_articulation("q", RobotCfg(fpath=str(tmp_path / "quad.xml"), fix_base=False))
    assert set(LEGS) < set(parsed.geom_names)
    assert {f"{name}_foot" for name in LEGS} < set(parsed.site_names)


def test_an_observation_of_a_sensor_at_a_geom(make) -> None:  # noqa: F811
    env = make(
        sensors={"feet": ContactSensorCfg(of=FEET)},
        observations={"it": ObservationCfg(func="contact_found", params={"sensor": "feet"})},
    )
    assert env.get_obs()["it"].shape == (3, 4)


def test_handles_read_sites_and_geoms(make) -> None:  # noqa: F811
    env = make()
    shake(env)
    pos, _, linear, angular = of_mujoco(env, "site", "r/FL_foot")
    np.testing.assert_allclose(env.robot.get_site_pose("FL_foot")[:, :3], pos, atol=1e-6)
    found = env.robot.get_site_vel("FL_foot", [0, 2])
    np.testing.assert_allclose(found, np.hstack([linear, angular])[[0, 2]], atol=1e-5)
    pos, axes, linear, angular = of_mujoco(env, "geom", "r/FL")
    matrix = env.robot.get_geom_pose("FL", to_matrix=True)
    np.testing.assert_allclose(matrix[:, :3, 3], pos, atol=1e-6)
    np.testing.assert_allclose(matrix[:, :3, :3], axes, atol=1e-6)
    both = np.hstack([linear, angular])
    np.testing.assert_allclose(env.robot.get_geom_vel("FL"), both, atol=1e-5)
    with pytest.raises(ValueError, match=r"r has no site 'FL_fot'; .*Did you mean 'FL_foot'"):
        env.robot.get_site_pose("FL_fot")


def test_targets_of_experts_are_sites_and_geoms(make) -> None:  # noqa: F811
    env = make()
    shake(env)
    poses = TargetPoses(env)
    for target, kind, name in (
        ("crate/handle", "site", "scene/handle"),
        ("crate/geom:back", "geom", "scene/back"),
        ("r/FL_foot", "site", "r/FL_foot"),
        ("r/FL_calf", "link", "r/FL_calf"),
    ):
        poses.add(target, "expert.0.to")
        pos, axes, *_ = of_mujoco(env, kind, name)
        at, quat = poses(target)
        np.testing.assert_allclose(at, pos, atol=1e-12)
        for one, own in zip(np.array(quat), axes, strict=True):
            np.testing.assert_allclose(rotation(one), own, atol=1e-12)
    known = env.sim.known
    problems = check_target("crate/hadle", "expert.0.to", known, [])
    assert "no link of 'crate' matches 'hadle'" in problems[0].message
    assert "sites: handle" in problems[0].message
    assert problems[0].hint == "Did you mean 'handle'?"


def test_a_new_task_takes_the_site_as_the_tool(tmp_path) -> None:
    motors = "".join(f'<position joint="j{i}" kp="100" ctrlrange="-3 3"/>' for i in range(1, 7))
    path = tmp_path / "arm.xml"
    path.write_text(ARM.replace("</mujoco>", f"<actuator>{motors}</actuator></mujoco>"))
    words = describe_robot(str(path), python=False).words
    assert words["picked"] == "site: tcp"
    path.write_text(path.read_text().replace('"tcp"', '"marking"'))
    words = describe_robot(str(path), python=False).words
    assert words["picked"] == "link_names: [hand]"
