"""A thousand resets do not carry anything away, and ranges of nothing change no bit."""

import numpy as np
import pytest

from embodichain.lab.gym.envs.cfg import EventCfg
from tests.helpers.spatial_events import ARM, CUBE, LIGHTS, SMALL, TOOL
from tests.helpers.ur10_task import CUBE_POS, GOAL_POS, HOME

NOTHING = [[0, 0, 0], [0, 0, 0]]
LAMP = {"entity_cfg": {"uid": "lamp"}}
FIELDS = ("cam_pos", "cam_quat", "cam_fovy", "light_pos", "light_dir", "light_diffuse")


def randomizers(box: list, low: float, high: float, one: list, fovy: list) -> dict[str, EventCfg]:
    """Every randomizer that begins at a default; ranges are given.

    Args:
        box: Of positions and angles.
        low, high: Of offsets.
        one: Of factors.
        fovy: Of the camera.
    """
    axes = {axis: [low, high] for axis in ("x", "y", "z", "roll", "pitch", "yaw")}
    declared = {
        "randomize_articulation_root_pose": {
            **ARM,
            "position_range": box,
            "rotation_range": box,
            "relative_rotation": True,
        },
        "reset_root_state_uniform": {**CUBE, "pose_range": axes, "velocity_range": axes},
        "reset_joints_by_scale": {
            "entity_cfg": {"uid": "ur10", "joint_names": "Joint[12]"},
            "position_range": one,
        },
        "reset_joints_by_offset": {
            "entity_cfg": {"uid": "ur10", "joint_names": "Joint[3-6]"},
            "position_range": [low, high],
            "velocity_range": [low, high],
        },
        "randomize_anchor_height": {
            "anchor_uid": "goal",
            "height_delta_range": [low, high],
            "exclude_uids": ["cube"],
        },
        "randomize_light": {
            **LAMP,
            "position_range": box,
            "intensity_range": [low, high],
            "direction_range": box,
        },
        "randomize_camera_pose": {"position_range": box, "rotation_range": box},
        "randomize_camera_fovy": {"fovy_range": fovy},
    }
    return {name: EventCfg(func=name, params=params) for name, params in declared.items()}


def test_nothing_drifts_over_a_thousand_resets(make) -> None:
    events = randomizers(SMALL, -0.05, 0.05, [0.95, 1.05], [30, 50])
    env = make(num_envs=2, events=events, lights=LIGHTS)
    for _ in range(1000):
        env.reset()
    engine, model = env.sim.engine, env.sim.engine.model
    tiny = 0.05 + 1e-9
    cube, goal, arm = (env.sim.get_asset(uid).read_pose() for uid in ("cube", "goal", "ur10"))
    assert (np.abs(cube[0] - CUBE_POS) <= tiny).all()
    assert (np.abs(goal[0] - GOAL_POS) <= [1e-12, 1e-12, tiny]).all()
    assert (np.abs(arm[0] - [0, 0, 1]) <= tiny).all()
    assert (np.abs(np.linalg.norm(arm[1], axis=1) - 1) < 1e-9).all()
    offset = np.abs(env.robot.read_qpos() - HOME)
    assert (offset <= np.maximum(tiny, 0.05 * np.abs(HOME) + 1e-9)).all()
    lamp = model.light("lamp").id
    moved = engine.model_field("light_pos").reshape(2, -1, 3)[:, lamp] - LIGHTS["lamp"].init_pos
    assert (np.abs(moved) <= tiny).all()
    shift = engine.model_field("cam_pos").reshape(2, -1, 3)[:, 0] - model.cam_pos[0]
    assert (np.abs(shift) <= tiny).all()


def test_the_tool_does_not_wander(make) -> None:
    params = {**TOOL, "position_range": SMALL, "rotation_range": SMALL}
    env = make(num_envs=2, events={"e": EventCfg(func="randomize_robot_eef_pose", params=params)})
    body = env.robot.body_of("ee_link")
    home = env.sim.engine.derived("xpos")[:, body].copy()
    for _ in range(200):
        env.reset()
    assert (np.abs(env.sim.engine.derived("xpos")[:, body] - home) <= 0.05 + 5e-4).all()


def test_ranges_of_nothing_change_no_bit(make) -> None:
    plain = make(lights=LIGHTS)
    fovy = float(plain.sim.engine.model.cam_fovy[0])
    events = randomizers(NOTHING, 0.0, 0.0, [1, 1], [fovy, fovy])
    events["tool"] = EventCfg(
        func="randomize_robot_eef_pose",
        params={**TOOL, "position_range": NOTHING, "rotation_range": NOTHING},
    )
    env = make(events=events, lights=LIGHTS)
    for each in (plain, env):
        each.reset()
    assert np.array_equal(env.sim.engine.rows, plain.sim.engine.rows)
    for field in FIELDS:
        compiled = np.asarray(getattr(plain.sim.engine.model, field)).reshape(-1)
        found = env.sim.engine.model_field(field)
        assert np.array_equal(found, np.tile(compiled, (3, 1))), field


@pytest.mark.parametrize("name", list(randomizers(SMALL, 0, 0, [1, 1], [30, 50])))
def test_environments_draw_independently(make, name: str) -> None:
    from tests.lab.gym.envs.mdp.test_events import Drawn

    event = randomizers(SMALL, -0.05, 0.05, [0.95, 1.05], [30, 50])[name]
    env = make(num_envs=64, events={"e": event}, lights=LIGHTS)
    seen = Drawn()
    env.add_observer(seen)
    first = []
    for _ in range(30):
        env.reset()
        values = next(iter(seen.last.values()))
        assert len(np.unique(values[:, 0])) == 64
        first.append(values[:2, 0].copy())
    apart = np.corrcoef(np.array(first).T)[0, 1]
    assert abs(apart) < 4 / np.sqrt(30)
