"""Settling, detaching, grids, anchors and registries, on scenes worked by hand."""

import numpy as np
import pytest

from embodichain.lab.gym.envs.cfg import EventCfg
from embodichain.utils.errors import ConfigError
from tests.helpers.ur10_task import CUBE_POS, GOAL_POS
from tests.lab.gym.envs.mdp.test_events import build, poses

CUBE = {"entity_cfg": {"uid": "cube"}}


def event(func: str, mode: str = "reset", **params) -> EventCfg:
    return EventCfg(func=func, mode=mode, params=params)


def drop(height: float = 0.1) -> EventCfg:
    box = [[0, 0, height], [0, 0, height]]
    return event("randomize_rigid_object_pose", **CUBE, position_range=box)


def settle(**params) -> EventCfg:
    return event("wait_for_dynamic_objects_to_settle", **params)


# -- settling ------------------------------------------------------------------------------------


def test_objects_have_come_to_rest(make) -> None:
    env = make(events={"drop": drop(), "settle": settle()})
    env.reset()
    cube = env.sim.get_asset("cube")
    speeds = np.concatenate(cube.read_velocity(), axis=1)
    assert (np.linalg.norm(speeds[:, :3], axis=1) <= 0.03).all()
    assert np.allclose(poses(env, "cube")[0][:, 2], 0.05, atol=0.01)  # half its edge of 10 cm
    assert env.elapsed_steps.tolist() == [0, 0, 0]
    assert (env.sim.engine.state("time") > 0.1).all()


def test_environments_settle_by_themselves(make) -> None:
    falls = event("randomize_rigid_object_pose", **CUBE, position_range=[[0, 0, 0], [0, 0, 0.4]])
    env = make(events={"drop": falls, "settle": settle()}, num_envs=8)
    env.reset()
    times = env.sim.engine.state("time")[:, 0]
    assert len(np.unique(times)) > 3, "every environment took the same number of steps"
    before = env.sim.engine.rows[[0, 1, 3, 4, 5, 6, 7]].copy()
    env.reset(options={"reset_ids": [2]})
    assert np.array_equal(env.sim.engine.rows[[0, 1, 3, 4, 5, 6, 7]], before)


@pytest.mark.parametrize("behavior", ["warn", "raise"])
def test_objects_that_do_not_rest_are_named(make, caplog, behavior: str) -> None:
    what = settle(max_steps=12, timeout_behavior=behavior)
    env = make(events={"drop": drop(0.5), "settle": what})
    if behavior == "raise":
        with pytest.raises(TimeoutError, match=r"cube did not come to rest within 12 .* \[0, 1"):
            env.reset()
        return
    env.reset()
    assert "cube did not come to rest within 12 physics steps" in caplog.text
    assert np.allclose(env.sim.engine.state("time"), 0.12)


def test_detached_entities_stay_where_they_are(make) -> None:
    detach = event("set_detached_uids_for_env_reset", "startup", uids=["goal", "goal"])
    env = make(events={"detach": detach})
    env.reset()
    for uid in ("goal", "cube"):
        pose = env.sim.get_asset(uid).get_local_pose()
        pose[:, 2] += 0.3
        env.sim.get_asset(uid).set_local_pose(pose)
    env.reset(options={"reset_ids": [0, 2]})
    raised = GOAL_POS[2] + 0.3
    assert np.allclose(poses(env, "goal")[0][:, 2], raised)
    expected = [CUBE_POS[2], CUBE_POS[2] + 0.3, CUBE_POS[2]]
    assert np.allclose(poses(env, "cube")[0][:, 2], expected)


# -- grids ---------------------------------------------------------------------------------------

GRID = {
    "position_range": [[0.2, -0.3], [0.8, 0.3]],
    "reference_height": 0.06,
    "object_uid_list": ["cube", "goal"],
    "grid_size": [3, 2],
}


def test_objects_get_cells_of_their_own(make) -> None:
    env, _ = build(make, event("planner_grid_cell_sampler", **GRID), num_envs=256)
    cube, goal = poses(env, "cube")[0], poses(env, "goal")[0]
    centres = np.array([[x, y, 0.06] for x in (0.3, 0.5, 0.7) for y in (-0.15, 0.15)])
    cells = []
    for pos in (cube, goal):
        apart = np.abs(pos[:, None] - centres).max(axis=2)
        assert (apart.min(axis=1) < 1e-12).all()
        cells.append(apart.argmin(axis=1))
    assert (cells[0] != cells[1]).all()
    # Each of 6 cells has a chance of 1/6: 256 draws, 4 standard deviations.
    for found in cells:
        counts = np.bincount(found, minlength=6)
        assert (np.abs(counts - 256 / 6) < 4 * np.sqrt(256 * 5 / 36)).all()


# -- anchors -------------------------------------------------------------------------------------


def test_a_table_carries_what_stands_on_it(make) -> None:
    what = event(
        "randomize_anchor_height",
        anchor_uid="goal",
        height_delta_range=[-0.1, 0.3],
        store_key="lift",
    )
    env, drawn = build(make, what, num_envs=64)
    for _ in range(40):
        env.reset()
    lift = drawn.last["height"][:, 0]
    assert np.allclose(poses(env, "goal")[0][:, 2], GOAL_POS[2] + lift, atol=1e-12)
    assert np.allclose(poses(env, "cube")[0][:, 2], CUBE_POS[2] + lift, atol=1e-12)
    assert np.allclose(env.lift.numpy(), lift, atol=1e-7)
    assert lift.min() >= -0.1 and lift.max() <= 0.3
    assert abs(lift.mean() - 0.1) < 4 * 0.4 / np.sqrt(12 * 64)
    env.event_manager.apply("reset", np.array([3]))  # without a reset: nothing adds up
    assert np.isclose(poses(env, "cube")[0][3, 2] - CUBE_POS[2], drawn.last["height"][0, 0])


def test_heights_may_be_a_list_and_objects_may_stay(make) -> None:
    what = event(
        "randomize_anchor_height",
        anchor_uid="goal",
        height_delta_candidates=[-0.2, 0.0, 0.2],
        exclude_uids=["cube"],
    )
    env, _ = build(make, what, num_envs=64)
    lift = poses(env, "goal")[0][:, 2] - GOAL_POS[2]
    assert set(np.round(lift, 12)) == {-0.2, 0.0, 0.2}
    assert (poses(env, "cube")[0][:, 2] == CUBE_POS[2]).all()


@pytest.mark.parametrize(
    ("what", "part"),
    [
        (settle(entity_cfgs=[{"uid": "goal"}]), "'goal' is not dynamic"),
        (settle(min_steps=9, max_steps=3), "is less than min_steps"),
        (event("planner_grid_cell_sampler", **{**GRID, "grid_size": [1, 1]}), "do not fit into"),
        (
            event("planner_grid_cell_sampler", **{**GRID, "object_uid_list": ["cub"]}),
            "Did you mean 'cube'?",
        ),
        (
            event("planner_grid_cell_sampler", **{**GRID, "position_range": [[0, 1], [1, 0]]}),
            "low 1.0 exceeds high 0.0",
        ),
        (event("randomize_anchor_height", anchor_uid="goal"), "give either height_delta_range"),
        (
            event("randomize_anchor_height", anchor_uid="gaol", height_delta_range=[0, 1]),
            "Did you mean 'goal'?",
        ),
    ],
)
def test_wrong_parameters(make, what, part) -> None:
    with pytest.raises(ConfigError) as caught:
        make(events={"e": what})
    assert part in str(caught.value)


# -- registries ----------------------------------------------------------------------------------

GRASP = [0.0, 0.0, 0.05, 1.0, 0.0, 0.0, 0.0]  # 5 cm above the cube's centre


def volume(env, env_ids, handle, scale: float) -> float:
    return scale * 0.001


def registries() -> dict[str, EventCfg]:
    extra = [
        {"name": "grasp_pose_object", "entity_uids": ["cube"], "value": GRASP},
        {"name": "grip", "entity_cfg": {"uid": "cube"}, "value": 0.04},
        {
            "name": "volume",
            "mode": "callable",
            "entity_uids": "all_objects",
            "func_name": "tests.lab.gym.envs.mdp.test_scene_events:volume",
            "func_kwargs": {"scale": 2.0},
        },
        {
            "name": "mass",
            "mode": "callable",
            "entity_uids": ["cube"],
            "func_name": "get_mass",
        },
    ]
    registry = [
        {
            "entity_cfg": {"uid": "cube"},
            "attrs": ["grip", "volume", "mass", "uid"],
            "pose_register_params": {"compute_relative": ["goal"]},
        },
        {
            "entity_cfg": {"uid": "goal"},
            "attrs": ["volume"],
            "prefix": False,
            "pose_register_params": {"to_matrix": False, "compute_relative": False},
        },
    ]
    return {
        "extra": event("prepare_extra_attr", "startup", attrs=extra),
        "cube": event(
            "randomize_rigid_object_pose", **CUBE, position_range=[[-0.1] * 3, [0.1] * 3]
        ),
        "all": event("register_info_to_env", registry=registry, sim_update=False),
    }


def test_attributes_and_poses_are_registered(make) -> None:
    env = make(events=registries())
    env.reset()
    data = env.affordance_datas
    assert data["cube_grip"] == 0.04 and data["cube_uid"] == "cube"
    assert data["cube_volume"] == data["volume"] == 0.002
    assert data["cube_mass"].tolist() == [1.0] * 3
    cube = poses(env, "cube")[0]
    matrix = data["cube_pose"].numpy()
    turned = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]  # the cube starts at a yaw of 90 degrees
    assert np.allclose(matrix[:, :3, :3], turned, atol=1e-6)
    assert np.allclose(matrix[:, :3, 3], cube, atol=1e-6)
    assert np.allclose(data["cube_grasp_pose"][:, :3, 3], np.add(cube, [0, 0, 0.05]), atol=1e-6)
    assert np.allclose(data["cube_grasp_pose_object"][:, :3, 3], [0, 0, 0.05], atol=1e-6)
    apart = GOAL_POS - cube
    seen = np.stack([apart[:, 1], -apart[:, 0], apart[:, 2]], axis=1)
    assert np.allclose(data["goal_pose_cube"][:, :3, 3], seen, atol=1e-6)
    assert np.allclose(data["goal_pose"], [*GOAL_POS, 1, 0, 0, 0], atol=1e-6)


def test_a_partial_reset_registers_its_own_rows(make) -> None:
    env = make(events=registries())
    env.reset()
    before = env.affordance_datas["cube_pose"].clone()
    saved = env.state_dict()
    env.reset(options={"reset_ids": [1]})
    after = env.affordance_datas["cube_pose"]
    assert (before[[0, 2]] == after[[0, 2]]).all() and not (before[1] == after[1]).all()
    env.load_state_dict(saved)
    assert (env.affordance_datas["cube_pose"] == before).all()


def test_poses_of_links_and_single_attributes(make) -> None:
    tool = {"uid": "ur10", "link_names": ["ee_link"]}
    env = make(
        events={
            "tool": event(
                "register_entity_pose", entity_cfg=tool, registration="seen", to_matrix=False
            ),
            "scale": event(
                "register_entity_attrs", **CUBE, registration="seen", attrs=["get_body_scale"]
            ),
        }
    )
    env.reset()
    link = env.robot.get_link_pose("ee_link")
    assert np.allclose(env.seen["ur10_ee_link_pose"], link, atol=1e-6)
    assert env.seen["cube_get_body_scale"].tolist() == [[1.0, 1.0, 1.0]] * 3


def test_an_attribute_that_nobody_made_is_an_error(make) -> None:
    env = make(events={"e": event("register_entity_attrs", **CUBE, attrs=["colour"])})
    with pytest.raises(ValueError, match="'cube' has no attribute 'colour'"):
        env.reset()


@pytest.mark.parametrize(
    ("attr", "part"),
    [
        ({"name": "a", "value": 1}, "give either entity_uids or entity_cfg"),
        ({"name": "a", "entity_uids": ["cube"]}, "a static attribute needs a value"),
        ({"name": "a", "entity_uids": ["cub"], "value": 1}, "Did you mean 'cube'?"),
        (
            {"name": "a", "entity_uids": ["cube"], "mode": "callable", "func_name": "get_mas"},
            "Did you mean 'get_mass'?",
        ),
    ],
)
def test_wrong_attributes(make, attr, part) -> None:
    with pytest.raises(ConfigError) as caught:
        make(events={"e": event("prepare_extra_attr", attrs=[attr])})
    assert part in str(caught.value)


@pytest.mark.parametrize("name", ["sensors", "streams", "no name", "_hidden", "robot"])
def test_registries_take_no_attribute_of_the_environment(make, name: str) -> None:
    what = event("register_entity_pose", **CUBE, registration=name)
    with pytest.raises(ConfigError, match="registration: .* taken by the environment"):
        make(events={"e": what})


def test_a_registry_may_be_declared(make) -> None:
    what = event("register_entity_pose", **CUBE, registration="mine")
    env = make(events={"e": what}, extensions={"mine": {"old": 1}})
    env.reset()
    assert set(env.mine) >= {"old", "cube_pose"}
    with pytest.raises(ConfigError, match=r"env\.mine is a list; a dict is stored there"):
        make(events={"e": what}, extensions={"mine": [1]})
