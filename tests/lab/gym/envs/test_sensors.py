"""Sensors of an environment: declared, observed, fresh, the same bytes for any N, in the log."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
import torch

from embodichain.lab.gym.envs.base_env import BaseEnv
from embodichain.lab.gym.envs.cfg import EnvCfg, EventCfg, ObservationCfg
from embodichain.lab.sim.cfg import RigidBodyAttributesCfg, RigidObjectCfg, SimulationManagerCfg
from embodichain.lab.sim.configs.scene_cfg import SceneCfg
from embodichain.lab.sim.sensors import (
    ContactSensorCfg,
    ForceTorqueSensorCfg,
    FramePoseSensorCfg,
    HeightScanSensorCfg,
    ImuSensorCfg,
    JointsCfg,
    JointTorqueSensorCfg,
    LinksCfg,
    RayFanCfg,
    RayGridCfg,
    RayPatternCfg,
    RaySensorCfg,
)
from embodichain.lab.sim.shapes import CubeCfg
from embodichain.recording import verify
from embodichain.recording.write.recorder import McapRecorder
from embodichain.utils.errors import ConfigError
from tests.helpers.ur10_task import HOME, task

G = 9.81
ARM = LinksCfg(uid="ur10")
TOOL = LinksCfg(uid="ur10", link_names="ee_link")
CUBE = LinksCfg(uid="cube")


def sensors(**changes: Any) -> dict[str, Any]:
    return {
        "touch": ContactSensorCfg(of=CUBE),
        "floor": ContactSensorCfg(of=CUBE, against=LinksCfg(uid="default_plane")),
        "arm": ContactSensorCfg(of=ARM, against=CUBE),
        "imu": ImuSensorCfg(of=TOOL, pos=(0.1, 0, 0)),
        **changes,
    }


def spatial() -> dict[str, Any]:
    """Rays, heights and a frame on the tool, torques of joints: some with a rate.

    A control step is 0.04 s, so that 10 Hz is every second or third of them.
    """
    fan = RayPatternCfg(fan=RayFanCfg(horizontal_count=8, vertical_range=(-1, 0), vertical_count=2))
    return {
        "rays": RaySensorCfg(of=TOOL, pattern=fan, data_types=["distance", "normal"]),
        "scan": HeightScanSensorCfg(of=TOOL, rate=10.0),
        "frame": FramePoseSensorCfg(of=CUBE, relative_to=TOOL, rate=10.0),
        "torque": JointTorqueSensorCfg(of=JointsCfg(uid="ur10")),
    }


def config(**sim: Any) -> SimulationManagerCfg:
    return SimulationManagerCfg(headless=True, **{"num_threads": 1, **sim})


def jumps() -> dict[str, EventCfg]:
    """The cube is dropped elsewhere every third step, somewhere else in each environment."""
    params = {"of": {"uid": "cube"}, "position_range": [[-0.3, -0.3, 0], [0.3, 0.3, 0.1]]}
    func = "randomize_rigid_object_pose"
    return {"drop": EventCfg(func=func, mode="interval", interval_step=3, params=params)}


def lift(env: BaseEnv, height: float, env_ids: Any = None) -> None:
    """Put the cube at a height."""
    cube = env.sim.get_rigid_object("cube")
    pose = cube.get_local_pose() if env_ids is None else cube.get_local_pose()[env_ids]
    pose[:, 2] = height
    cube.set_local_pose(pose, env_ids)


def lying() -> RigidObjectCfg:
    """A cube that starts half a millimetre deep in the floor: it touches at once."""
    attrs = RigidBodyAttributesCfg(mass=2.0)
    return RigidObjectCfg(
        shape=CubeCfg(size=[0.1, 0.1, 0.1]), attrs=attrs, init_pos=(0.5, 0.5, 0.0495)
    )


@pytest.fixture
def make() -> Iterator[Callable[..., Any]]:
    built = []

    def build(cls: type[BaseEnv] = BaseEnv, **sections: Any) -> BaseEnv:
        cfg: EnvCfg = task(**{"sensors": sensors(), **sections})
        cfg.objects["cube"] = lying()
        env = cls(cfg)
        built.append(env)
        return env

    yield build
    for env in built:
        env.close()


def action(env: BaseEnv, step: int = 0) -> torch.Tensor:
    """(N, 6) joint targets near home, another wave for each environment."""
    wave = 0.2 * np.sin(0.7 * step + np.arange(env.num_envs)[:, None] + np.arange(6)[None, :])
    return torch.from_numpy((HOME + wave).astype(np.float32))


def readings(env: BaseEnv) -> list[np.ndarray[Any, Any]]:
    """(N, ...) everything the sensors read."""
    if "touch" not in env.sensors:
        found = [(s, name) for s in env.sensors.values() for name in s.reads]
        return [getattr(sensor, f"read_{name}")() for sensor, name in found]
    touch, floor, arm = (env.get_sensor(uid) for uid in ("touch", "floor", "arm"))
    imu = env.get_sensor("imu")
    return [
        touch.read_found(),
        touch.read_force(),
        floor.read_force(),
        arm.read_force(),
        imu.read_acceleration(),
        imu.read_angular_velocity(),
        imu.read_orientation(),
        imu.read_projected_gravity(),
    ]


def same(a: list[np.ndarray[Any, Any]], b: list[np.ndarray[Any, Any]]) -> list[bool]:
    """Whether each pair of readings is equal to the byte."""
    return [x.tobytes() == y.tobytes() for x, y in zip(a, b, strict=True)]


def rows(found: list[np.ndarray[Any, Any]], ids: Any) -> list[np.ndarray[Any, Any]]:
    return [reading[ids] for reading in found]


def test_what_is_declared_is_there_and_observed_only_if_it_says_so(make) -> None:
    env = make()
    obs, _ = env.reset()
    assert list(env.sensors) == ["touch", "floor", "arm", "imu"] and env.has_sensors
    assert len(env.get_sensor("arm").names) == len(env.robot.link_names)
    assert "sensor" not in obs.keys()  # noqa: SIM118  (a TensorDict)
    seen = make(sensors=sensors(touch=ContactSensorCfg(of=CUBE, observe=True)))
    obs, _ = seen.reset()
    for _ in range(60):
        obs, *_ = seen.step(action(seen))
    assert list(obs["sensor"].keys()) == ["touch"]
    force = obs["sensor", "touch", "force"]
    assert force.shape == (3, 1, 3) and force.dtype == torch.float32
    np.testing.assert_allclose(force[:, 0, 2], 2 * G, rtol=1e-3)
    space = seen.single_observation_space["sensor"]["touch"]
    assert space["force"].shape == (1, 3) and space["found"].shape == (1,)


def test_an_overriding_hook_adds_and_loses_nothing(make) -> None:
    class Clock:
        def get_data(self) -> torch.Tensor:
            return torch.full((3, 1), 7.0)

    class Mine(BaseEnv):
        def _setup_sensors(self, **kwargs: Any) -> dict[str, Any]:
            return {"clock": Clock()}

    env = make(Mine)
    obs, _ = env.reset()
    assert list(env.sensors) == ["touch", "floor", "arm", "imu", "clock"]
    assert obs["sensor", "clock"].tolist() == [[7.0]] * 3


def test_a_sensor_that_does_not_exist_is_an_error_that_lists_them(make) -> None:
    with pytest.raises(ConfigError, match=r"no sensor 'tuch'; there are: touch, .* 'touch'\?"):
        make().get_sensor("tuch")


def test_what_a_reset_leaves_alone_is_kept_and_what_it_changes_is_measured(make) -> None:
    env = make(sensors=spatial())
    env.reset()
    first = readings(env)
    lift(env, 3.0)
    env.step(action(env))
    before = readings(env)
    env.reset(options={"reset_ids": [1]})
    now = readings(env)
    assert all(same(rows(now, [1]), rows(first, [1])))
    assert all(same(rows(now, [0, 2]), rows(before, [0, 2])))
    frame = env.get_sensor("frame").read_position()
    env.step(action(env))  # 0.08 s: the next measurement at 10 Hz is due at 0.1 s
    assert env.get_sensor("frame").read_position().tobytes() == frame.tobytes()
    env.step(action(env))
    moved = (env.get_sensor("frame").read_position() != frame).any(axis=1)
    assert moved.tolist() == [True, False, True]  # environment 1 is 0.08 s old


@pytest.mark.parametrize("persistent", [True, False])
def test_after_a_reset_everything_is_that_of_the_new_state(make, persistent) -> None:
    env = make(sim_cfg=config(persistent=persistent))
    env.reset()
    first = readings(env)
    assert env.get_sensor("touch").read_found().all()
    lift(env, 3.0)
    env.step(action(env))
    before = readings(env)
    assert not env.get_sensor("touch").read_found().any()
    env.reset(options={"reset_ids": [1]})
    now = readings(env)
    assert all(same(rows(now, [1]), rows(first, [1])))
    # Nobody else's numbers changed, although a reset computes its own anew.
    assert all(same(rows(now, [0, 2]), rows(before, [0, 2])))
    assert not any(same(rows(now, [1]), rows(before, [1]))[:2])


def test_looking_at_poses_does_not_touch_what_the_last_step_left(make) -> None:
    env = make(sim_cfg=config(persistent=False, num_threads=1))
    env.reset()
    lift(env, 3.0, [1])
    env.step(action(env))
    touch, imu = env.get_sensor("touch"), env.get_sensor("imu")
    imu.read_orientation()
    force, felt = touch.read_force(), imu.read_acceleration()
    assert (force[:, 0, 2] > 0.0).tolist() == [True, False, True]
    lift(env, 2.0)  # every environment is dirty: the next look at a pose computes all of them
    imu.read_orientation()
    assert env.sim.get_rigid_object("cube").get_local_pose()[:, 2].tolist() == [2.0] * 3
    np.testing.assert_array_equal(touch.read_force(), force)
    np.testing.assert_array_equal(imu.read_acceleration(), felt)


@pytest.mark.parametrize("declared", [sensors, spatial])
def test_bytes_do_not_depend_on_the_number_of_environments_or_threads(make, declared) -> None:
    def rollout(num_envs: int, **sim: Any) -> list[list[np.ndarray[Any, Any]]]:
        sections = {"sensors": declared(), "events": jumps(), "max_episode_steps": 7}
        env = make(num_envs=num_envs, sim_cfg=config(**sim), **sections)
        env.reset()
        found = [readings(env)]
        for step in range(16):
            env.step(action(env, step))
            found.append(readings(env))
        return [rows(step, slice(min(num_envs, 2))) for step in found]

    wide = rollout(9)
    assert len({step[0].tobytes() for step in wide}) > 1  # readings change
    for num_envs, sim in (
        (1, {}),
        (2, {"persistent": True}),
        (4, {"num_threads": 2}),
        (9, {"persistent": True, "num_threads": 2}),
    ):
        for step, (a, b) in enumerate(zip(rollout(num_envs, **sim), wide, strict=True)):
            assert all(same(a, rows(b, slice(len(a[0]))))), f"N={num_envs}, {sim}, step {step}"


@pytest.mark.parametrize("declared", [sensors, spatial])
def test_a_restored_environment_senses_on_to_the_byte(make, declared) -> None:
    env = make(events=jumps(), sensors=declared())
    env.reset()
    for step in range(3):
        env.step(action(env, step))
    saved, at = env.state_dict(), readings(env)

    def run() -> list[list[np.ndarray[Any, Any]]]:
        found = []
        for step in range(6):
            env.step(action(env, step))
            found.append(readings(env))
        return found

    first = run()
    env.load_state_dict(saved)
    assert all(same(readings(env), at))
    assert all(all(same(a, b)) for a, b in zip(run(), first, strict=True))


def test_a_log_of_a_scene_with_sensors_verifies(make, tmp_path) -> None:
    observed = {**sensors(touch=ContactSensorCfg(of=CUBE, observe=True)), **spatial()}
    env = make(sensors=observed, events=jumps(), max_episode_steps=5)
    env.add_observer(McapRecorder(tmp_path / "log.mcap", env))
    env.reset()
    for step in range(12):
        env.step(action(env, step))
    env.close()
    report = verify(tmp_path / "log.mcap")
    assert report.ok, str(report)
    assert report.steps == 12


HILLS = """
<mujoco>
  <asset>
    <hfield name="hills" nrow="3" ncol="3" size="2 2 1 .1" elevation="0 0 0 1 1 1 0 0 0"/>
  </asset>
  <worldbody><geom name="hills" type="hfield" hfield="hills"/></worldbody>
</mujoco>
"""


def test_heights_above_a_terrain(tmp_path) -> None:
    """A ridge along x that is 1 m high and falls to 0 within 2 m along y."""
    (tmp_path / "hills.xml").write_text(HILLS)
    probe = RigidObjectCfg(
        shape=CubeCfg(size=[0.1, 0.1, 0.1]), body_type="kinematic", init_pos=(0, 0, 3)
    )
    grid = RayPatternCfg(grid=RayGridCfg(size=(0.0, 2.0), resolution=0.5))
    scan = HeightScanSensorCfg(of=LinksCfg(uid="probe"), pattern=grid, observe=True)
    cfg = EnvCfg(
        num_envs=2,
        sim_cfg=config(),
        scene=SceneCfg(fpath=str(tmp_path / "hills.xml")),
        objects={"probe": probe},
        sensors={"scan": scan},
    )
    env = BaseEnv(cfg)
    obs, _ = env.reset()
    heights = [3.0 - (1.0 - abs(y) / 2.0) for y in (-1.0, -0.5, 0.0, 0.5, 1.0)]
    np.testing.assert_allclose(obs["sensor", "scan", "height"], [heights] * 2, atol=1e-6)
    env.close()


def test_a_scene_without_sensors_computes_none(make) -> None:
    env = make(sensors={})
    env.reset()
    assert not env.has_sensors and env.sim.engine.model.nsensor == 0


def test_wrong_sensors_are_all_named(make) -> None:
    wrong = {
        "touch": ContactSensorCfg(of=LinksCfg(uid="cub")),
        "cube": ContactSensorCfg(of=CUBE),
        "imu": ImuSensorCfg(of=LinksCfg(uid="ur10", link_names="wrist.*"), uid="other"),
    }
    with pytest.raises(ConfigError) as error:
        make(sensors=wrong)
    assert [p.path for p in error.value.problems] == [
        "sensors.touch.of.uid",
        "sensors.cube",
        "sensors.imu.uid",
        "sensors.imu.of.link_names",
    ]


def test_an_observed_reading_can_be_modified(make) -> None:
    imu = ImuSensorCfg(of=LinksCfg(uid="ur10", link_names="ee_link"), observe=True)
    entries = [f"sensor/imu/{name}" for name in imu.readings()]
    terms = {
        f"m{i}": ObservationCfg(func=halve, mode="modify", name=name)
        for i, name in enumerate(entries)
    }
    env = make(sensors=sensors(imu=imu), observations=terms)
    obs, _ = env.reset()
    data = env.get_sensor("imu").get_data()
    assert tuple(data) == imu.readings() == tuple(obs["sensor", "imu"].keys())
    for name, value in data.items():
        assert torch.equal(obs["sensor", "imu", name], value / 2)
    with pytest.raises(ConfigError, match=r"before it: .*sensor/imu/orientation.*Did you mean"):
        wrong = ObservationCfg(func=halve, mode="modify", name="sensor/imu/acelleration")
        make(sensors=sensors(imu=imu), observations={"m": wrong})


@pytest.mark.parametrize("uid", ["touch", "imu", "wrench"])
def test_readings_are_what_a_sensor_gives(make, uid) -> None:
    wrench = ForceTorqueSensorCfg(of=LinksCfg(uid="ur10", link_names="ee_link"))
    sensor = make(sensors=sensors(wrench=wrench)).get_sensor(uid)
    data = sensor.get_data()
    assert tuple(data) == sensor.cfg.readings()
    assert {(v.dtype, v.shape[0]) for v in data.values()} == {(torch.float32, 3)}


def halve(env: Any, data: torch.Tensor) -> torch.Tensor:
    return data / 2
