"""Terms of a terrain: patches of environments, levels, heights; in logs and for any N."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from embodichain.config import resolve
from embodichain.lab.gym.envs.base_env import BaseEnv
from embodichain.lab.gym.envs.cfg import (
    CurriculumCfg,
    EnvCfg,
    EventCfg,
    MetricCfg,
    ObservationCfg,
    TerminationCfg,
)
from embodichain.lab.sim.cfg import RigidObjectCfg
from embodichain.lab.sim.configs.scene_cfg import (
    RoughPatchCfg,
    SceneCfg,
    SlopePatchCfg,
    StairsPatchCfg,
    TerrainCfg,
)
from embodichain.lab.sim.sensors import (
    ContactSensorCfg,
    HeightScanSensorCfg,
    LinksCfg,
    RayGridCfg,
    RayPatternCfg,
)
from embodichain.lab.sim.shapes import SphereCfg
from embodichain.recording import verify
from embodichain.recording.write.recorder import McapRecorder
from embodichain.utils.errors import ConfigError

BALL = {"of": {"uid": "ball"}}
LINK = LinksCfg(uid="ball")


def scan(tilt: float = 0.0, **changes: Any) -> HeightScanSensorCfg:
    grid = RayGridCfg(size=(1.2, 0.6), resolution=0.15, direction=(0.0, tilt, -1.0))
    return HeightScanSensorCfg(entity_cfg=LINK, pattern=RayPatternCfg(grid=grid), **changes)


def task(num_envs: int, **changes: Any) -> EnvCfg:
    """A ball on three kinds of ground at three levels: patches of 4 m."""
    terrain = TerrainCfg(
        patches={
            "rough": RoughPatchCfg(),
            "hill": SlopePatchCfg(slope=(0.2, 0.4), direction="down"),
            "stairs": StairsPatchCfg(),
        },
        levels=3,
        size=4.0,
        border=1.0,
    )
    terms: dict[str, Any] = {
        "events": {"ground": EventCfg("place_terrain", {"max_init_level": 1})},
        "observations": {
            "height": ObservationCfg("height_above_ground", BALL),
            "level": ObservationCfg("terrain_level"),
            "edge": ObservationCfg("terrain_edge_distance", BALL),
        },
        "sensors": {"scan": scan(), "touch": ContactSensorCfg(entity_cfg=LINK)},
        "max_episode_steps": 20,
        **changes,
    }
    ball = RigidObjectCfg(shape=SphereCfg(radius=0.1), init_pos=(0, 0, 0.2))
    return EnvCfg(
        num_envs=num_envs,
        seed=3,
        scene=SceneCfg(terrain=terrain),
        objects={"ball": ball},
        **terms,
    )


@pytest.fixture(scope="module")
def env() -> Iterator[BaseEnv]:
    rays = {"scan": scan(), "rays": scan(1e-12), "touch": ContactSensorCfg(entity_cfg=LINK)}
    built = BaseEnv(task(7, sensors=rays))
    yield built
    built.close()


def put(env: BaseEnv, *places: tuple[float, float, float]) -> None:
    """Place the ball in the first environments, at rest."""
    ball = env.sim.get_rigid_object("ball")
    if ball is None:
        raise RuntimeError("no ball")
    ids = np.arange(len(places))
    ball.write_pose(np.array(places, np.float64), None, ids)


def idle(env: BaseEnv) -> Any:
    return env.step(torch.zeros(env.num_envs, 0))


def test_environments_share_the_patches_evenly(env: BaseEnv) -> None:
    obs, _ = env.reset(seed=1)
    # Three columns: environments 0 to 2 at level 0, 3 to 5 at level 1, then at level 0 again.
    assert obs["level"].reshape(-1).tolist() == [0, 0, 0, 1, 1, 1, 0]
    assert obs["height"].reshape(-1).numpy() == pytest.approx(0.2, abs=1e-6)
    # 3 x 4 m along x and along y, 1 m of border, less half a cell at each end.
    assert obs["edge"].reshape(-1).numpy() == pytest.approx(
        [2.95, 2.95, 2.95, 2.95, 6.95, 2.95, 2.95]
    )


def test_heights_are_those_of_the_ground_below(env: BaseEnv) -> None:
    env.reset(seed=1)
    # Environment 1 is on a hill of slope 0.2, with a flat top of 1.5 m; 4 is on one of slope 0.3.
    put(env, (0, 0, 1), (1.25, 0.2, 1), (0, 0, 1), (0, 0, 1), (0.1, -1.25, 1))
    heights = env.observation_manager.terms["height"].instance()
    assert heights[[1, 4]] == pytest.approx([1 + 0.2 * 0.5, 1 + 0.3 * 0.5], abs=1e-6)


def test_a_scan_of_terrain_alone_equals_rays(env: BaseEnv) -> None:
    """The reference is the sensor with rays, tilted by a billionth of a degree."""
    env.reset(seed=1)
    draws = np.random.default_rng(0)
    for _ in range(3):
        put(env, *(tuple(p) for p in draws.uniform([-7, -7, 0.6], [7, 7, 1], (7, 3))))
        found, cast = (env.sensors[name].read_height() for name in ("scan", "rays"))
        assert found.shape == (7, 45)
        assert found == pytest.approx(cast, abs=1e-9)
        assert found.max() - found.min() > 0.2


def test_the_ball_lands_on_the_ground_and_touches_it(env: BaseEnv) -> None:
    env.reset(seed=1)
    obs = [idle(env)[0] for _ in range(19)][-1]
    # 0.1 m of radius, less what its weight presses it in.
    assert obs["height"].reshape(-1).numpy() == pytest.approx(0.1, abs=2e-3)
    assert env.sensors["touch"].read_found().all()


def levels(**params: Any) -> dict[str, CurriculumCfg]:
    return {"level": CurriculumCfg("terrain_levels", {**BALL, "promote": 1.0, **params})}


def reset_at(env: BaseEnv, *distances: float) -> tuple[list[float], dict[str, float]]:
    """Reset after a step that ends with balls so far away; return levels and values."""
    idle(env)
    put(env, *((d, 0.0, 1.0) for d in distances))
    obs, _ = env.reset()
    return obs["level"].reshape(-1).tolist(), dict(env.curriculum_manager.values)


def test_levels_rise_with_distance_and_fall_without() -> None:
    env = BaseEnv(task(6, curriculum=levels()))
    obs, _ = env.reset(seed=1)
    assert obs["level"].reshape(-1).tolist() == [0, 0, 0, 1, 1, 1]  # no episode has ended
    found, values = reset_at(env, 1.5, 0.7, 0.1, 1.5, 0.7, 0.1)
    assert found == [1, 0, 0, 2, 1, 0]
    assert values == {
        "level/mean": pytest.approx(4 / 6),
        "level/rough": 1.5,
        "level/hill": 0.5,
        "level/stairs": 0.0,
    }
    saved = env.state_dict()
    # Environment 3 is at the highest level: it continues at one that is drawn.
    later = [reset_at(env, *[1.5] * 6)[0] for _ in range(6)]
    assert [found[1] for found in later[:2]] == [1, 2]
    assert len({found[3] for found in later}) > 1
    assert {level for found in later for level in found} == {0, 1, 2}
    env.load_state_dict(saved)
    assert [reset_at(env, *[1.5] * 6)[0] for _ in range(6)] == later
    env.close()


def test_by_success_levels_rise_only_with_it_and_fall_without() -> None:
    """Success is a ball above 0.5 m at the end; one that succeeds near the middle stays."""
    above = MetricCfg("height", BALL, shape={"above": 0.5}, reduce="last")
    env = BaseEnv(task(6, curriculum=levels(by="success"), metrics={"success": above}))
    obs, _ = env.reset(seed=1)
    assert obs["level"].reshape(-1).tolist() == [0, 0, 0, 1, 1, 1]
    places = [(1.5, 1.0), (0.7, 1.0), (1.5, 0.3), (1.5, 1.0), (0.7, 1.0), (1.5, 0.3)]
    put(env, *((d, 0.0, height) for d, height in places))
    idle(env)
    obs, _ = env.reset()
    assert obs["level"].reshape(-1).tolist() == [1, 0, 0, 2, 1, 0]
    env.close()


def test_an_environment_is_the_same_among_others_and_in_its_log(tmp_path: Path) -> None:
    """Environment i does the same for N = 4 and N = 7, and the log replays to the bit."""
    rows: dict[int, list[list[bytes]]] = {}
    for count in (4, 7):
        below = TerminationCfg("terrain_edge_distance", BALL, shape={"below": 1.0}, kind="time_out")
        cfg = task(count, curriculum=levels(), max_episode_steps=5, terminations={"edge": below})
        env = BaseEnv(cfg)
        if count == 7:
            env.add_observer(McapRecorder(tmp_path / "log.mcap", env))
        env.reset(seed=5)
        put(env, *((0.3 * i, 0.1, 1.0) for i in range(4)))
        rows[count] = []
        for _ in range(12):
            obs = idle(env)[0]
            read = [obs[name].numpy() for name in ("height", "level", "edge")]
            read.append(env.sensors["scan"].read_height())
            rows[count].append([values[:4].tobytes() for values in read])
        env.close()
    assert rows[4] == rows[7]
    report = verify(tmp_path / "log.mcap")
    assert report.ok and report.steps == 12, str(report)


def test_a_part_of_a_batch_is_on_the_patches_of_the_whole() -> None:
    cfg = task(3)
    cfg.first_env = 2
    env = BaseEnv(cfg)
    obs, _ = env.reset(seed=1)
    assert obs["level"].reshape(-1).tolist() == [0, 1, 1]  # environments 2, 3 and 4 of 7
    env.close()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"events": {}, "curriculum": levels()}, "one event place_terrain, there are 0"),
        ({"events": {"g": EventCfg("place_terrain", {"max_init_level": 3})}}, "levels are 0 to 2"),
    ],
)
def test_what_does_not_fit_is_refused(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        BaseEnv(task(2, **changes))


@pytest.mark.parametrize(("name", "value"), [("demote", "0.5"), ("command_name", "velocity")])
def test_parameters_of_the_other_rule_are_refused(name: str, value: str) -> None:
    given = f"+task.curriculum.level.params.{name}={value}"
    words = rf"curriculum\.level\.params\.{name}: has no meaning with by: success"
    with pytest.raises(ConfigError, match=words):
        resolve(["task=quadruped_rough", given])


def test_terms_need_a_terrain() -> None:
    cfg = task(2)
    cfg.scene = SceneCfg()
    with pytest.raises(ConfigError, match=r"no scene\.terrain"):
        BaseEnv(cfg)


WIDE = {"x": [-1.9, 1.9], "y": [-1.9, 1.9]}
BOX = [[-1.9, -1.9, 0.0], [1.9, 1.9, 0.0]]
PLACED = {
    "reset_root_state_uniform": {**BALL, "pose_range": WIDE},
    "randomize_pose": {**BALL, "position_range": BOX},
    "randomize_pose ": {
        **BALL,
        "position_range": [[-1.9, -1.9, 0.2], [1.9, 1.9, 0.2]],
        "relative_position": False,
    },
    "randomize_rigid_object_pose": {**BALL, "position_range": BOX},
    "planner_grid_cell_sampler": {
        "position_range": [[-1.9, -1.9], [1.9, 1.9]],
        "reference_height": 0.2,
        "object_uid_list": ["ball"],
        "grid_size": [9, 9],
    },
}


@pytest.mark.parametrize("name", PLACED)
def test_what_is_placed_at_random_is_above_the_ground_of_its_patch(name: str) -> None:
    """The event is declared before `place_terrain`; the reference is a ray that MuJoCo casts."""
    place = EventCfg(name.strip(), PLACED[name])
    env = BaseEnv(
        task(
            9,
            events={"place": place, "ground": EventCfg("place_terrain")},
            sensors={"rays": scan(1e-12)},
        )
    )
    ball = env.sim.get_rigid_object("ball")
    assert ball is not None
    grounds = []
    for seed in range(20):
        obs, _ = env.reset(seed=seed)
        assert obs["height"].reshape(-1).numpy() == pytest.approx(0.2, abs=1e-6)
        pos = ball.read_pose()[0]
        from_above = pos + np.array([0.0, 0.0, 3.0])
        model = env.sim.engine.model
        field = np.arange(model.ngeom) == model.geom("default_plane").id
        down = np.array([[[0.0, 0.0, -1.0]]])
        hits = env.sim.engine.cast_rays(from_above[:, None], down, field)
        assert pytest.approx(hits.distance[:, 0], abs=1e-6) == 3.2
        grounds.append(pos[:, 2] - 0.2)
    heights = np.array(grounds)
    assert heights.max() > 0.2 and heights.min() < -0.05
    # On the platform in the middle heights are those of a plane, to the bit.
    assert (heights == 0.0).any()
    env.close()


def test_what_is_placed_relative_to_another_is_not_raised() -> None:
    goal = RigidObjectCfg(shape=SphereCfg(radius=0.01), body_type="kinematic", init_pos=(1.8, 0, 2))
    near = {**BALL, "relative_to": {"uid": "goal"}, "position_range": [[0, 0, 0.5], [0, 0, 0.5]]}
    cfg = task(
        6, events={"ground": EventCfg("place_terrain"), "near": EventCfg("randomize_pose", near)}
    )
    cfg.objects["goal"] = goal
    env = BaseEnv(cfg)
    env.reset(seed=1)
    ball = env.sim.get_rigid_object("ball")
    assert ball is not None
    assert ball.read_pose()[0] == pytest.approx(np.tile([1.8, 0.0, 2.5], (6, 1)))
    env.close()
