"""Sites and geoms in references: every quantity is MuJoCo's own of that site or geom."""

import mujoco
import numpy as np
import pytest

from embodichain.lab.gym.envs.base_env import BaseEnv
from embodichain.lab.gym.envs.cfg import (
    ActionTermCfg,
    EnvCfg,
    EventCfg,
    ObservationCfg,
    SceneEntityCfg,
)
from embodichain.lab.sim.cfg import (
    JointDrivePropertiesCfg,
    RigidObjectCfg,
    RobotCfg,
    SimulationManagerCfg,
    WarpCfg,
)
from embodichain.lab.sim.configs.scene_cfg import GroundCfg, SceneCfg
from embodichain.lab.sim.shapes import CubeCfg
from embodichain.utils.errors import ConfigError
from tests.helpers.framed_robots import ARM, LEGS, WORLD, quadruped

_OBJECTS = {
    "link": mujoco.mjtObj.mjOBJ_XBODY,
    "site": mujoco.mjtObj.mjOBJ_SITE,
    "geom": mujoco.mjtObj.mjOBJ_GEOM,
}


@pytest.fixture
def make(tmp_path):
    built = []

    def build(text=None, **sections):
        (tmp_path / "robot.xml").write_text(quadruped() if text is None else text)
        (tmp_path / "world.xml").write_text(WORLD)
        robot = sections.pop("robot", {})
        floating = {} if text else {"fix_base": False}
        cfg = EnvCfg(
            **{
                "num_envs": 3,
                "seed": 3,
                "sim_cfg": SimulationManagerCfg(headless=True, num_threads=1),
                "robot": RobotCfg(
                    uid="r", fpath=str(tmp_path / "robot.xml"), **{**floating, **robot}
                ),
                "scene": SceneCfg(fpath=str(tmp_path / "world.xml"), ground=GroundCfg()),
                "objects": {
                    "cube": RigidObjectCfg(shape=CubeCfg(size=[0.1] * 3), init_pos=(1, 0, 0.2))
                },
                **sections,
            }
        )
        env = BaseEnv(cfg)
        built.append(env)
        env.reset(seed=5)
        return env

    yield build
    for env in built:
        env.close()


def shake(env, steps=8) -> None:
    """Move everything, differently in every environment."""
    draw = np.random.default_rng(1)
    engine = env.sim.engine
    engine.write("qvel", draw.uniform(-1.5, 1.5, engine.state("qvel").shape))
    for _ in range(steps):
        engine.step(2)


def of_mujoco(env, kind: str, name: str):
    """Position, rotation, linear and angular velocity (world axes) of a frame, by MuJoCo."""
    found = []
    for i in range(env.num_envs):
        data = env.sim.engine.data_of(i)
        model = env.sim.engine.model_of(i)
        number = mujoco.mj_name2id(model, _KINDS[kind], name)
        assert number >= 0, name
        fields = {"link": ("xpos", "xmat"), "site": ("site_xpos", "site_xmat")}
        pos, mat = fields.get(kind, ("geom_xpos", "geom_xmat"))
        both = np.zeros(6)
        mujoco.mj_objectVelocity(model, data, _OBJECTS[kind], number, both, 0)
        turned = getattr(data, mat)[number].reshape(3, 3).copy()
        found.append((getattr(data, pos)[number].copy(), turned, both[3:], both[:3]))
    return tuple(np.array(part) for part in zip(*found, strict=True))


_KINDS = {
    "link": mujoco.mjtObj.mjOBJ_BODY,
    "site": mujoco.mjtObj.mjOBJ_SITE,
    "geom": mujoco.mjtObj.mjOBJ_GEOM,
}
FRAMES = [
    ({"uid": "r", "site": "imu"}, "site", "r/imu"),
    ({"uid": "r", "site_names": "FL_foot"}, "site", "r/FL_foot"),
    ({"uid": "r", "geom": "RR"}, "geom", "r/RR"),
    ({"uid": "r", "geom_names": ["FR_upper"]}, "geom", "r/FR_upper"),
    ({"uid": "r", "link": "FL_calf"}, "link", "r/FL_calf"),
    ({"uid": "crate", "site": "handle"}, "site", "scene/handle"),
    ({"uid": "crate", "geom": "back"}, "geom", "scene/back"),
    ({"uid": "shelf", "site": "slot"}, "site", "scene/slot"),
    ({"uid": "cube", "geom": "geom"}, "geom", "cube/geom"),
]


@pytest.mark.parametrize(("reference", "kind", "name"), FRAMES, ids=lambda v: str(v))
def test_pose_and_velocity_are_those_of_mujoco(make, reference, kind, name) -> None:
    env = make()
    shake(env)
    found = env.scene_entity(reference)
    pos, axes, linear, angular = of_mujoco(env, kind, name)
    np.testing.assert_allclose(found.position(), pos, atol=1e-12)
    np.testing.assert_allclose(found.axes(), axes, atol=1e-12)
    np.testing.assert_allclose(found.linear_velocity(), linear, atol=1e-12)
    np.testing.assert_allclose(found.angular_velocity(), angular, atol=1e-12)
    own = np.einsum("nji,nj->ni", axes, linear)
    np.testing.assert_allclose(found.linear_velocity("body"), own, atol=1e-12)
    quat = np.array(found.orientation())
    for one, matrix in zip(quat, axes, strict=True):
        turned = np.zeros(9)
        mujoco.mju_quat2Mat(turned, one)
        np.testing.assert_allclose(turned.reshape(3, 3), matrix, atol=1e-12)


def test_several_frames_keep_the_entitys_order_or_the_declared_one(make) -> None:
    env = make()
    shake(env)
    feet = env.scene_entity({"uid": "r", "geom_names": "[FR][LR]"})
    assert feet.frame_names == tuple(LEGS)  # the order of the file
    turned = env.scene_entity(
        {"uid": "r", "geom_names": ["RL", "F."], "preserve_order": True},
    )
    assert turned.frame_names == ("RL", "FR", "FL")
    position, _ = turned.link_poses()
    linear, angular = turned.link_velocities()
    for i, name in enumerate(turned.frame_names):
        pos, _, v, w = of_mujoco(env, "geom", f"r/{name}")
        np.testing.assert_allclose(position[:, i], pos, atol=1e-12)
        np.testing.assert_allclose(linear[:, i], v, atol=1e-12)
        np.testing.assert_allclose(angular[:, i], w, atol=1e-12)


def test_poses_relative_to_the_root(make) -> None:
    env = make()
    shake(env)
    reference = {"uid": "r", "site_names": ["FL_foot", "imu"]}
    position, quat = env.scene_entity(reference).link_poses(in_root_frame=True)
    root, turned, *_ = of_mujoco(env, "link", "r/trunk")
    pos, axes, *_ = of_mujoco(env, "site", "r/FL_foot")
    local = np.einsum("nji,nj->ni", turned, pos - root)
    np.testing.assert_allclose(position[:, 1], local, atol=1e-12)
    np.testing.assert_allclose(position[:, 0], [[0.03, -0.02, 0.06]] * 3, atol=1e-12)
    expected = np.array([0.8, 0.1, -0.2, 0.5]) / np.linalg.norm([0.8, 0.1, -0.2, 0.5])
    np.testing.assert_allclose(np.abs(quat[:, 0] @ expected), 1.0, atol=1e-12)


WRONG = {
    "unknown site": ({"site": "ium"}, r"site: no site of 'r' matches 'ium'; .* mean 'imu'"),
    "other kind": ({"site": "FR"}, r"site: no site of 'r' matches 'FR'.*A geom is called so"),
    "link is a site": (
        {"link_names": ["imu"]},
        r"link_names.*A site is called so: write site: imu",
    ),
    "two kinds": ({"site": "imu", "geom": "FR"}, r"geom: site is given as well"),
    "both forms": ({"site": "imu", "site_names": ["imu"]}, r"site: site_names is given as well"),
    "several": ({"geom": "F."}, r"geom: one geom is wanted, these match: FR, FL"),
    "no sites": ({"uid": "cube", "site": "x"}, r"site: no site of 'cube' matches 'x'; .*: none"),
    "joint of a site": ({"uid": "cube", "joint_names": "a"}, "without joints"),
    "bad regex": ({"geom_names": "("}, "malformed regex"),
    "empty": ({"geom_names": []}, "geom_names: names no geom"),
}


@pytest.mark.parametrize("case", WRONG)
def test_mistakes_list_what_exists(make, case) -> None:
    given, message = WRONG[case]
    with pytest.raises(ConfigError, match=message):
        make().scene_entity({"uid": "r", **given})


def observed(func: str, of: dict, **params):
    return ObservationCfg(func=func, params={"of": of, **params})


def test_quantities_of_a_site_and_a_geom(make) -> None:
    tool, foot = {"uid": "r", "site": "FR_foot"}, {"uid": "r", "geom": "FR"}
    env = make(
        observations={
            "height": observed("height", tool),
            "pose": observed("link_pose", {"uid": "r", "site_names": ".._foot"}),
            "distance": ObservationCfg(func="distance", params={"from": tool, "to": foot}),
            "relative": ObservationCfg(
                func="relative_pose", params={"from": {"uid": "cube"}, "to": tool}
            ),
            "velocity": observed("velocity", foot),
        }
    )
    shake(env)
    obs = env.get_obs()
    pos, axes, *_ = of_mujoco(env, "site", "r/FR_foot")
    at, _, linear, angular = of_mujoco(env, "geom", "r/FR")
    np.testing.assert_allclose(obs["height"][:, 0], pos[:, 2], atol=1e-6)
    np.testing.assert_allclose(obs["distance"][:, 0], np.linalg.norm(pos - at, axis=1), atol=1e-6)
    np.testing.assert_allclose(obs["velocity"], np.hstack([linear, angular]), atol=1e-5)
    assert obs["pose"].shape == (3, 4, 7)
    np.testing.assert_allclose(obs["pose"][:, 0, :3], pos, atol=1e-6)
    cube, turned, *_ = of_mujoco(env, "link", "cube")
    local = np.einsum("nji,nj->ni", turned, pos - cube)
    np.testing.assert_allclose(obs["relative"][:, :3], local, atol=1e-6)


REFUSED = {
    "joint_position": ("observations", {"of": {"uid": "r", "site": "imu"}}),
    "randomize_mass": ("events", {"of": {"uid": "r", "site": "imu"}, "mass": [0.5, 1.0]}),
    "randomize_scale": ("events", {"of": {"uid": "cube", "geom": "geom"}, "scale": [1.0, 1.1]}),
    "push_by_setting_velocity": (
        "events",
        {"of": {"uid": "r", "geom": "FR"}, "velocity_range": {"x": [0, 1]}},
    ),
    "randomize_friction": ("events", {"of": {"uid": "r", "site": "imu"}, "friction": [0.5, 1.0]}),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_kind_without_meaning_is_refused(make, case) -> None:
    section, params = REFUSED[case]
    func = "randomize" if case.startswith("randomize") else case
    term = EventCfg(func=func, params=params) if section == "events" else None
    term = term or ObservationCfg(func=func, params=params)
    message = r"\.(site|geom): (links are wanted here|only '\w+' itself counts)"
    with pytest.raises(ConfigError, match=message):
        make(**{section: {"it": term}})


def test_friction_of_one_foot(make) -> None:
    params = {"of": {"uid": "r", "geom_names": ["FR", "RL"]}, "friction": [0.2, 0.4]}
    env = make(events={"feet": EventCfg(func="randomize", params=params, mode="reset")})
    model = env.sim.engine.model
    changed = [env.sim.engine.model_of(i).geom_friction[:, 0] for i in range(3)]
    differ = np.flatnonzero((np.array(changed) != model.geom_friction[:, 0]).any(axis=0))
    assert {model.geom(int(g)).name for g in differ} == {"r/FR", "r/RL"}


def test_a_force_at_a_site_has_its_moment_about_the_centre_of_mass(make) -> None:
    params = {"of": {"uid": "r", "site": "FR_foot"}, "force_range": [-5, 5]}
    env = make(
        events={"push": EventCfg(func="apply_external_force_torque", params=params, mode="reset")}
    )
    engine = env.sim.engine
    body = int(engine.model.site("r/FR_foot").bodyid[0])
    applied = engine.state("xfrc_applied").reshape(3, -1, 6)
    assert (np.delete(applied, body, axis=1) == 0).all()
    for i in range(3):
        data = engine.data_of(i)
        arm = data.site("r/FR_foot").xpos - data.xipos[body]
        force, torque = applied[i, body, :3], applied[i, body, 3:]
        assert (force != 0).all()
        np.testing.assert_allclose(torque, np.cross(arm, force), atol=1e-12)


def test_randomized_places_are_read_as_they_are(make) -> None:
    env = make()
    engine = env.sim.engine
    site, geom = (int(engine.model.site("r/imu").id), int(engine.model.geom("r/FR").id))
    of_site = env.scene_entity({"uid": "r", "site": "imu"})
    of_geom = env.scene_entity({"uid": "r", "geom": "FR"})
    of_site.position(), of_geom.position()  # derived now, stale after the writes below
    draw = np.random.default_rng(2)
    turns = draw.normal(size=(3, 4))
    turns /= np.linalg.norm(turns, axis=1, keepdims=True)
    engine.write_model("site_pos", draw.uniform(-1, 1, (3, 3)), None, np.arange(3) + 3 * site)
    engine.write_model("site_quat", turns, None, np.arange(4) + 4 * site)
    engine.write_model("geom_pos", draw.uniform(-1, 1, (3, 3)), None, np.arange(3) + 3 * geom)
    for entity, kind, name in ((of_site, "site", "r/imu"), (of_geom, "geom", "r/FR")):
        pos, axes, linear, _ = of_mujoco(env, kind, name)
        np.testing.assert_allclose(entity.position(), pos, atol=1e-12)
        np.testing.assert_allclose(entity.axes(), axes, atol=1e-12)
        np.testing.assert_allclose(entity.linear_velocity(), linear, atol=1e-12)
        for quat, matrix in zip(np.array(entity.orientation()), axes, strict=True):
            turned = np.zeros(9)
            mujoco.mju_quat2Mat(turned, quat)
            np.testing.assert_allclose(turned.reshape(3, 3), matrix, atol=1e-9)


def test_a_robots_own_function_takes_a_site(make) -> None:
    def above(env, obs, of: SceneEntityCfg):
        return of.position()[:, 2:]

    term = ObservationCfg(func=above, params={"of": {"uid": "r", "site": "imu"}})
    env = make(observations={"it": term})
    np.testing.assert_allclose(
        env.get_obs()["it"], of_mujoco(env, "site", "r/imu")[0][:, 2:], atol=1e-6
    )


def test_an_action_moves_a_site_as_the_tool(make) -> None:
    action = {
        "of": {"uid": "r", "site": "tcp"},
        "frame": "world",
        "rotation": "command",
        "scale": [0.05] * 3 + [0.1] * 3,
    }
    drives = JointDrivePropertiesCfg(stiffness=500.0, damping=50.0)
    qpos = [0.2, -0.6, 1.2, 0.1, -0.3, 0.2]
    robot = {"init_qpos": qpos, "gravcomp": 1.0, "drive_pros": drives}
    env = make(ARM, robot=robot, actions={"arm": ActionTermCfg("eef_delta_pose", params=action)})
    solver = env.action_manager.terms["arm"].instance.solver
    pos, quat = solver.forward(env.robot.read_qpos())
    at, axes, *_ = of_mujoco(env, "site", "r/tcp")
    np.testing.assert_allclose(pos, at, atol=1e-12)
    goal = pos + np.array([0.03, -0.02, 0.04])
    found, solved = solver.inverse(env.robot.read_qpos(), goal, quat)
    assert solved.all()
    env.robot.write_qpos(found[:, : env.robot.dof], None, None)
    now, turned, *_ = of_mujoco(env, "site", "r/tcp")
    np.testing.assert_allclose(now, goal, atol=2e-5)
    np.testing.assert_allclose(turned, axes, atol=2e-5)


@pytest.mark.parametrize("arrays", ["host", "device"])
def test_the_same_on_warp(make, arrays) -> None:
    pytest.importorskip("mujoco_warp")
    warp = WarpCfg(arrays=arrays)
    sim = SimulationManagerCfg(headless=True, engine="warp", sim_device="cpu", warp=warp)
    params = {"of": {"uid": "r", "geom": "FR"}, "force_range": [-5, 5]}
    env = make(
        sim_cfg=sim,
        scene=SceneCfg(),
        events={"push": EventCfg(func="apply_external_force_torque", params=params, mode="reset")},
    )
    engine = env.sim.engine
    for _ in range(8):
        engine.step(2)
    for reference, kind, name in FRAMES[:4]:
        found = env.scene_entity(reference)
        pos, axes, linear, angular = of_mujoco(env, kind, name)
        host = env.arrays.host
        np.testing.assert_allclose(host(found.position()), pos, atol=1e-5)
        np.testing.assert_allclose(host(found.axes()), axes, atol=1e-5)
        np.testing.assert_allclose(host(found.linear_velocity()), linear, atol=1e-4)
        np.testing.assert_allclose(host(found.angular_velocity()), angular, atol=1e-4)
        quat = host(found.orientation())
        assert quat.shape == (3, 4)
