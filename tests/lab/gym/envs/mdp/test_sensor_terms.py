"""Terms of sensors on cases worked by hand: weights on the floor, steps, slides, turns."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from embodichain.lab.gym.envs.base_env import BaseEnv
from embodichain.lab.gym.envs.cfg import (
    CommandCfg,
    EnvCfg,
    MetricCfg,
    ObservationCfg,
    RewardCfg,
    TerminationCfg,
)
from embodichain.lab.sim.cfg import (
    RigidBodyAttributesCfg,
    RigidObjectCfg,
    RobotCfg,
    SimulationManagerCfg,
)
from embodichain.lab.sim.sensors import (
    CameraCfg,
    ContactSensorCfg,
    ForceTorqueSensorCfg,
    FramePoseSensorCfg,
    HeightScanSensorCfg,
    ImuSensorCfg,
    LinksCfg,
    RayGridCfg,
    RayPatternCfg,
    RaySensorCfg,
)
from embodichain.lab.sim.shapes import CubeCfg
from embodichain.utils.errors import ConfigError
from tests.helpers.judging import ends, move, put, reward

G = 9.81
DT = 0.04  # s a control step


def block(mass: float) -> RigidObjectCfg:
    attrs = RigidBodyAttributesCfg(mass=mass, linear_damping=0.0, angular_damping=0.0)
    shape = CubeCfg(size=[0.1, 0.1, 0.1])
    return RigidObjectCfg(shape=shape, attrs=attrs, init_pos=(0, 0, 0.05))


@pytest.fixture
def make() -> Iterator[Callable[..., Any]]:
    built = []

    def build(**sections: Any) -> BaseEnv:
        cube = LinksCfg(uid="cube")
        base: dict[str, Any] = {
            "num_envs": 2,
            "sim_cfg": SimulationManagerCfg(headless=True, num_threads=1),
            "objects": {"cube": block(2.0)},
            "sensors": {
                "contacts": ContactSensorCfg(entity_cfg=cube),
                "imu": ImuSensorCfg(entity_cfg=cube),
            },
        }
        env = BaseEnv(EnvCfg(**{**base, **sections}))
        built.append(env)
        env.reset()
        return env

    yield build
    for env in built:
        env.close()


def idle(env: BaseEnv, steps: int = 1) -> Any:
    """Step without acting; the last step's results."""
    for _ in range(steps):
        found = env.step(np.zeros((env.num_envs, 0), np.float32))
    return found


def seen(env: BaseEnv, func: str, **params: Any) -> np.ndarray[Any, Any]:
    """An observation's value now."""
    from embodichain.lab.gym.envs.managers import ObservationManager

    manager = ObservationManager(env, {"it": ObservationCfg(func=func, params=params)})
    obs: dict[Any, Any] = {}
    manager.compute(obs)
    found: np.ndarray[Any, Any] = obs["it",].numpy()
    assert found.dtype == np.float32
    return found


def split(env: BaseEnv) -> None:
    """Environment 0's cube rests on the floor, environment 1's is in the air."""
    idle(env, 40)
    up = env.sim.get_rigid_object("cube").get_local_pose()[1:]
    up[:, 2] = 3.0
    env.sim.get_rigid_object("cube").set_local_pose(up, [1])
    idle(env, 4)


def test_contacts_are_observed(make) -> None:
    env = make()
    split(env)
    assert seen(env, "contact_found", sensor="contacts").tolist() == [[1.0], [0.0]]
    # 2 kg weigh 19.62 N
    assert seen(env, "contact_found", sensor="contacts", threshold=19.0).tolist() == [[1], [0]]
    assert seen(env, "contact_found", sensor="contacts", threshold=20.0).tolist() == [[0], [0]]
    force = seen(env, "contact_force", sensor="contacts")
    np.testing.assert_allclose(force, [[[0, 0, 2 * G]], [[0, 0, 0]]], rtol=1e-3, atol=1e-3)
    length = seen(env, "contact_force", sensor="contacts", norm=True)
    np.testing.assert_allclose(length, [[2 * G], [0]], rtol=1e-3)


def test_an_imu_is_observed(make) -> None:
    env = make()
    split(env)
    # environment 1's falls freely
    acceleration = seen(env, "imu_acceleration", sensor="imu")
    np.testing.assert_allclose(acceleration, [[0, 0, G], [0, 0, 0]], atol=1e-3)
    half = float(np.sqrt(0.5))
    put(env, "cube", [0, 0, 3], [half, half, 0, 0])  # a quarter turn about x
    move(env, "cube", angular=[0, 0, 2])
    quarter = [[half, half, 0, 0]] * 2
    np.testing.assert_allclose(seen(env, "imu_orientation", sensor="imu"), quarter, atol=1e-6)
    rates = seen(env, "imu_angular_velocity", sensor="imu")
    np.testing.assert_allclose(rates, [[0, 2, 0]] * 2, atol=1e-6)
    down = seen(env, "imu_projected_gravity", sensor="imu")
    np.testing.assert_allclose(down, [[0, -1, 0]] * 2, atol=1e-6)


def pair(tmp_path: Path, offset: float, **kwargs: Any) -> RobotCfg:
    """Two boxes of 2 kg, a metre apart; the second hangs on the first."""
    box = 'type="box" size=".05 .05 .05" mass="2"'
    path = tmp_path / "pair.xml"
    path.write_text(
        f'''<mujoco><worldbody><body name="base"><geom {box}/>
        <body name="far" pos="1 0 0"><geom pos="{offset} 0 0" {box}/></body>
        </body></worldbody></mujoco>'''
    )
    return RobotCfg(uid="pair", fpath=str(path), **kwargs)


def test_the_force_at_a_joint_is_observed(make, tmp_path) -> None:
    wrench = ForceTorqueSensorCfg(entity_cfg=LinksCfg(uid="pair", link_names="far"))
    env = make(robot=pair(tmp_path, 0.5, init_pos=(0, 0, 2)), sensors={"wrench": wrench})
    found = seen(env, "body_incoming_wrench", sensor="wrench")
    # The base holds 2 kg up, 0.5 m before the link's origin: 2 g, and -0.5 x 2 g about y.
    np.testing.assert_allclose(found, [[0, 0, 2 * G, 0, -G, 0]] * 2, atol=1e-4)


def test_touching_counts_and_costs_what_is_too_much(make) -> None:
    env = make()
    split(env)
    assert reward(env, "undesired_contacts", sensor="contacts") == [1.0, 0.0]
    assert reward(env, "undesired_contacts", sensor="contacts", threshold=20.0) == [0.0, 0.0]
    assert reward(env, "desired_contacts", sensor="contacts") == [0.0, 1.0]
    assert ends(env, "illegal_contact", sensor="contacts", threshold=1.0) == [True, False]
    assert ends(env, "illegal_contact", sensor="contacts", threshold=20.0) == [False, False]
    excess = reward(env, "contact_forces", sensor="contacts", threshold=9.62)
    assert excess == pytest.approx([10.0, 0.0], rel=1e-3)


def test_several_links_add_up(make, tmp_path) -> None:
    env = make(
        robot=pair(tmp_path, 0.0, fix_base=False, init_pos=(0, 3, 0.05)),
        sensors={"contacts": ContactSensorCfg(entity_cfg=LinksCfg(uid="pair"))},
    )
    idle(env, 40)
    assert reward(env, "undesired_contacts", sensor="contacts") == [2.0, 2.0]
    excess = reward(env, "contact_forces", sensor="contacts", threshold=9.62)
    assert excess == pytest.approx([20.0, 20.0], rel=1e-3)


def test_landing_pays_for_the_time_in_the_air(make) -> None:
    params = {"sensor": "contacts", "threshold": 0.1}
    env = make(rewards={"air": RewardCfg(func="feet_air_time", params=params)})
    idle(env, 20)
    paid = []
    for step in range(12):
        # Environment 0's cube is held up for 5 control steps, environment 1's for 1.
        high = [1.0 if step < 5 else 0.05, 1.0 if step < 1 else 0.05]
        put(env, "cube", [[0, 0, z] for z in high])
        env.sim.get_rigid_object("cube").clear_dynamics()
        paid.append(idle(env)[4]["rewards"]["air"].tolist())
    found = np.asarray(paid)
    # In the air for 5 steps and landing in the 6th: 6 x 0.04 s - 0.1 s; 2 x 0.04 s - 0.1 s.
    wanted = np.zeros((12, 2))
    wanted[5, 0], wanted[1, 1] = 6 * DT - 0.1, 2 * DT - 0.1
    np.testing.assert_allclose(found, wanted, atol=1e-6)


def test_a_new_episode_starts_the_clock_anew(make) -> None:
    params = {"sensor": "contacts", "threshold": 0.0}
    env = make(rewards={"air": RewardCfg(func="feet_air_time", params=params)})
    idle(env, 20)
    put(env, "cube", [0, 0, 3.0])
    idle(env, 4)  # both have been in the air for four steps
    env.reset(options={"reset_ids": [1]})  # environment 1's cube is on the floor again
    put(env, "cube", [0, 0, 0.05])
    env.sim.get_rigid_object("cube").clear_dynamics()
    paid = idle(env)[4]["rewards"]["air"].tolist()
    assert paid == pytest.approx([5 * DT, 0.0], abs=1e-6)


def test_standing_still_on_command_pays_nothing(make) -> None:
    def command(speed: float) -> CommandCfg:
        ranges = {"lin_vel_x": [speed] * 2, "lin_vel_y": [0.0, 0.0], "ang_vel_z": [0.0, 0.0]}
        params = {"entity_cfg": {"uid": "cube"}, "ranges": ranges}
        return CommandCfg(func="uniform_velocity", params=params)

    terms = {
        name: RewardCfg(
            func="feet_air_time",
            params={"sensor": "contacts", "threshold": 0.0, "command_name": name},
        )
        for name in ("go", "stay")
    }
    env = make(rewards=terms, commands={"go": command(0.5), "stay": command(0.05)})
    idle(env, 20)
    put(env, "cube", [0, 0, 3.0])
    idle(env)
    put(env, "cube", [0, 0, 0.05])
    env.sim.get_rigid_object("cube").clear_dynamics()
    paid = idle(env)[4]["rewards"]
    assert paid["go"].tolist() == pytest.approx([2 * DT] * 2, abs=1e-6)
    assert paid["stay"].tolist() == [0.0, 0.0]


def test_a_gait_pays_for_height_in_the_swing_and_contact_in_the_stance(make) -> None:
    def command(turn: float) -> CommandCfg:
        ranges = {"lin_vel_x": [0.0, 0.0], "lin_vel_y": [0.0, 0.0], "ang_vel_z": [turn] * 2}
        params = {"entity_cfg": {"uid": "cube"}, "ranges": ranges}
        return CommandCfg(func="uniform_velocity", params=params)

    # A period of four control steps; the cube's origin is at 0.05 m while it lies on the floor.
    gait = {"sensor": "contacts", "period_s": 4 * DT, "offsets": [0.0], "rest_height": 0.05}
    gait |= {"height": 0.1, "width": 0.1}
    found = {"always": gait, "go": {**gait, "command_name": "go"}}
    found |= {"stay": {**gait, "command_name": "stay"}}
    terms = {name: RewardCfg(func="feet_gait", params=params) for name, params in found.items()}
    env = make(rewards=terms, commands={"go": command(0.5), "stay": command(0.05)})
    env.reset(seed=0)
    rows = []
    for step in range(1, 5):
        # Environment 1's cube is in the air, at twice the height of the swing, in steps 1 and 3.
        put(env, "cube", [[0, 0, 0.05], [0, 0, 0.25 if step % 2 else 0.05]])
        env.sim.get_rigid_object("cube").clear_dynamics()
        rows.append({name: value.tolist() for name, value in idle(env)[4]["rewards"].items()})
    # sin(2 pi k / 4) is 1, 0, -1, 0: in the middle of the swing, between, in the stance, between.
    for name in ("always", "go"):
        values = np.asarray([row[name] for row in rows])
        np.testing.assert_allclose(values[:, 0], [np.exp(-1), 1, 1, 1], atol=0.01)
        fallen = 0.5 * G * DT**2
        wanted = [np.exp(-(((0.2 - fallen - 0.1) / 0.1) ** 2)), 0.0]
        np.testing.assert_allclose(values[[0, 2], 1], wanted, atol=0.02)
    assert [row["stay"] for row in rows] == [[1, 0], [1, 1], [1, 0], [1, 1]]


def test_a_gait_has_a_phase_for_each_foot(make) -> None:
    params = {"sensor": "contacts", "period_s": 0.5, "offsets": [0.0, 0.5]}
    with pytest.raises(ConfigError, match=r"offsets: 2 offsets for 1 feet: cube"):
        make(rewards={"gait": RewardCfg(func="feet_gait", params=params)})


def test_feet_slide_by_their_speed_in_the_plane_while_they_touch(make) -> None:
    env = make()
    split(env)
    move(env, "cube", linear=[0.3, 0.4, 0.7])
    # environment 1's does not touch; the contact is that of the last step, the speed is now
    assert reward(env, "feet_slide", sensor="contacts") == pytest.approx([0.5, 0.0], abs=1e-9)
    assert reward(env, "feet_slide", sensor="contacts", threshold=20.0) == [0.0, 0.0]


@pytest.mark.parametrize(
    ("section", "cfg", "message"),
    [
        (
            "rewards",
            RewardCfg(func="undesired_contacts", params={"sensor": "contcts"}),
            r"no sensor (is called )?'contcts'; .*contacts.*Did you mean 'contacts'\?",
        ),
        (
            "observations",
            ObservationCfg(func="imu_acceleration", params={"sensor": "contacts"}),
            "'contacts' is not a sensor of type imu; imu sensors: imu",
        ),
        (
            "terminations",
            TerminationCfg(func="illegal_contact", params={"sensor": "imu"}),
            "'imu' is not a sensor of type contact; contact sensors: contacts",
        ),
        (
            "metrics",
            MetricCfg(func="contact_forces", params={"sensor": "contacts", "threshold": -1.0}),
            "at least 0",
        ),
    ],
)
def test_a_wrong_sensor_is_named_where_it_stands(make, section, cfg, message) -> None:
    with pytest.raises(ConfigError, match=message) as error:
        make(**{section: {"it": cfg}})
    key = "threshold" if "threshold" in cfg.params else "sensor"
    assert [p.path for p in error.value.problems] == [f"{section}.it.params.{key}"]


def spatial() -> dict[str, Any]:
    """Sensors on the cube: a frame, two rays (up and down), a height scan of three points."""
    cube = LinksCfg(uid="cube")
    grid = RayGridCfg(size=(0.2, 0.0), resolution=0.1)
    up_and_down = RayPatternCfg(directions=[(0, 0, 1), (0, 0, -1)])
    return {
        "frame": FramePoseSensorCfg(entity_cfg=cube),
        "rays": RaySensorCfg(entity_cfg=cube, pattern=up_and_down, max_range=2.0, observe=True),
        "scan": HeightScanSensorCfg(entity_cfg=cube, pattern=RayPatternCfg(grid=grid)),
    }


def test_heights_distances_and_poses_are_observed(make) -> None:
    def of(sensor: str, **params: Any) -> ObservationCfg:
        return ObservationCfg(func="sensor_reading", params={"sensor": sensor, **params})

    scan = ObservationCfg(func="height_scan", params={"sensor": "scan", "offset": 0.3})
    terms = {"scan": scan, "rays": of("rays"), "where": of("frame", reading="position")}
    env = make(sensors=spatial(), observations=terms)
    env.reset()
    put(env, "cube", [[0, 0, 0.5], [0, 0, 1.0]])
    obs = env.get_obs()
    np.testing.assert_allclose(obs["scan"], [[0.2] * 3, [0.7] * 3], atol=1e-6)
    np.testing.assert_allclose(obs["rays"], [[2.0, 0.5], [2.0, 1.0]], atol=1e-6)
    np.testing.assert_allclose(obs["where"], [[0, 0, 0.5], [0, 0, 1.0]], atol=1e-6)
    observed = obs["sensor"]["rays"]["distance"]
    np.testing.assert_allclose(observed, [[2.0, 0.5], [2.0, 1.0]], atol=1e-6)


def test_a_reading_is_a_reward(make) -> None:
    params = {"sensor": "rays", "reading": "distance"}
    terms = {"near": RewardCfg(func="sensor_reading", shape="l1", params=params)}
    env = make(sensors=spatial(), rewards=terms)
    env.reset()
    _, value, *_ = env.step(np.zeros((env.num_envs, 0), np.float32))
    # nothing above the cube within 2 m, the floor 5 cm below its middle
    np.testing.assert_allclose(value, 2.0 + 0.05, atol=1e-3)


@pytest.mark.parametrize(
    ("func", "params", "path", "match"),
    [
        ("sensor_reading", {"sensor": "ray"}, "sensor", "Did you mean 'rays'"),
        ("sensor_reading", {"sensor": "rays", "reading": "normal"}, "reading", "has: distance"),
        ("sensor_reading", {"sensor": "frame", "reading": "positon"}, "reading", "'position'"),
        ("sensor_reading", {"sensor": "eye"}, "sensor", "'eye' is a camera"),
        ("height_scan", {"sensor": "rays"}, "sensor", "is not a sensor of type height_scan"),
    ],
)
def test_a_wrong_reading_is_refused(make, func, params, path, match) -> None:
    sensors = {**spatial(), "eye": CameraCfg(width=8, height=8)}
    with pytest.raises(ConfigError, match=match) as error:
        make(sensors=sensors, observations={"o": ObservationCfg(func=func, params=params)})
    assert [p.path for p in error.value.problems] == [f"observations.o.params.{path}"]
