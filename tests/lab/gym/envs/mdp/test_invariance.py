"""Every registered term gives environment i the same bytes whatever the number of environments is.

One task declares every built-in term at least once; a term that is registered and not in it fails
the test, so that new terms are added here.
"""

import numpy as np
import pytest
import torch

from embodichain.lab.gym.envs.cfg import (
    EventCfg,
    MetricCfg,
    RewardCfg,
    TerminationCfg,
)
from embodichain.lab.gym.envs.managers import TERMS
from embodichain.lab.gym.envs.managers.terms.aliases import AliasSpec
from embodichain.lab.gym.envs.managers.terms.registry import VALUE_KINDS
from tests.helpers import acting_terms, judge_terms, randomizers, sensor_terms, spatial_events
from tests.helpers.acting_terms import ACTIONS

pytestmark = [pytest.mark.unmeasured, pytest.mark.slow]

ARM = {"entity_cfg": {"uid": "ur10"}}
CUBE = {"entity_cfg": {"uid": "cube"}}
GOAL = {"entity_cfg": {"uid": "goal"}}
TOOL = {"uid": "ur10", "link_names": ["ee_link"]}
PAIR = {"source_entity_cfg": TOOL, "target_entity_cfg": {"uid": "goal"}}
BOX = [[-0.2, -0.2, -0.2], [0.2, 0.2, 0.2]]

EVENTS = {
    **judge_terms.EVENTS,
    **spatial_events.EVENTS,
    "place": EventCfg(
        func="randomize_rigid_object_pose",
        params={**CUBE, "position_range": BOX, "rotation_range": [[-99] * 3, [99] * 3]},
    ),
    "goal": EventCfg(
        func="randomize_rigid_object_pose",
        mode="interval",
        interval_range_s=[0.04, 0.2],
        params={**GOAL, "position_range": BOX, "relative_to": TOOL},
    ),
    "qpos": EventCfg(func="randomize_robot_qpos", params={**ARM, "qpos_range": [-0.1, 0.1]}),
}
OBSERVATIONS = {**acting_terms.OBSERVATIONS, **sensor_terms.OBSERVATIONS}
REWARDS = {**judge_terms.REWARDS, **sensor_terms.REWARDS}
TERMINATIONS = {**judge_terms.TERMINATIONS, **sensor_terms.TERMINATIONS}
METRICS = TERMINATIONS  # rewards are evaluated as such: managers call both in the same way


def sections() -> dict:
    return {
        "actions": ACTIONS,
        "commands": judge_terms.COMMANDS,
        "events": EVENTS,
        "sensors": sensor_terms.SENSORS,
        "lights": spatial_events.LIGHTS,
        "observations": OBSERVATIONS,
        "rewards": {k: RewardCfg(func=k, params=v, weight=0.3) for k, v in REWARDS.items()},
        "terminations": {k: TerminationCfg(func=k, params=v) for k, v in TERMINATIONS.items()},
        "metrics": {
            **{k: MetricCfg(func=k, params=v, reduce="mean") for k, v in METRICS.items()},
            "success": MetricCfg(
                func="within_distance", reduce="any", params={**PAIR, "threshold": 0.2}
            ),
        },
    }


def rollout(make, num_envs: int) -> list[list[np.ndarray]]:
    """Arrays of the first min(N, 3) environments, step by step."""
    env = make(num_envs=num_envs, max_episode_steps=9, **sections())
    count = min(num_envs, 3)
    obs, _ = env.reset()
    manager = env.observation_manager
    found = [[manager.flatten(obs)[:count].numpy(), env.sim.engine.rows[:count].copy()]]
    for step in range(20):
        if step == 4:  # a partial reset of environment 0
            obs, _ = env.reset(options={"reset_ids": [0]})
        columns = np.arange(env.action_manager.action_dim)
        wave = 0.3 * np.sin(0.7 * step + np.arange(64)[:, None] + columns[None, :])
        wave = wave + env.action_manager.home()
        action = torch.from_numpy(wave[:num_envs].astype(np.float32))
        obs, reward, terminated, truncated, info = env.step(action)
        row = [manager.flatten(obs), reward, terminated, truncated, info["success"]]
        row += [*info["rewards"].values(), *info["episode_sums"].values()]
        row += [*info["metrics"].values(), obs["camera_image"], obs["camera_mask"]]
        found.append([v[:count].numpy() for v in row] + [env.sim.engine.rows[:count].copy()])
    return found


def test_bytes_do_not_depend_on_the_number_of_environments(make) -> None:
    wide = rollout(make, 64)
    assert any(step[2].any() for step in wide[1:]), "no episode ended: the test lost its point"
    for num_envs in (1, 3):
        narrow = rollout(make, num_envs)
        for step, (a, b) in enumerate(zip(narrow, wide, strict=True)):
            for item, (x, y) in enumerate(zip(a, b, strict=True)):
                same = x.tobytes() == y[: len(x)].tobytes()
                assert same, f"N={num_envs}, step {step}, item {item}"


def test_a_restored_environment_continues_to_the_byte(make) -> None:
    env = make(num_envs=3, max_episode_steps=9, **sections())
    env.reset()
    action = torch.from_numpy(np.tile(env.action_manager.home(), (3, 1)).astype(np.float32)) + 0.1

    def run() -> list[bytes]:
        found = []
        for _ in range(12):
            obs, reward, _, _, info = env.step(action)
            row = [env.observation_manager.flatten(obs), reward, *info["metrics"].values()]
            row.append(obs["camera_image"])
            row += list(info["episode_sums"].values())
            found += [v.numpy().tobytes() for v in row] + [env.sim.engine.rows.tobytes()]
        return found

    for _ in range(4):
        env.step(action)
    saved = env.state_dict()
    first = run()
    run()
    env.load_state_dict(saved)
    assert run() == first


# Randomizers of model fields have a test like this one of their own, in test_randomizers_exact;
# a film changes nothing, textures are in test_camera_events, shapes in test_shape_events.
# Terms of a terrain: test_terrain. Objects that are arranged: test_arrange_objects.
# The action operational_space, which needs a robot without drives: test_operational_space.
ELSEWHERE = {case.func for case in randomizers.CASES}
ELSEWHERE |= {
    "arrange_objects",
    "record_camera_data",
    "randomize_shape",
    "randomize_texture",
    "place_terrain",
}
TERRAIN = {"height_above_ground", "terrain_edge_distance", "terrain_level"}
USED = {
    "action": {*ACTIONS, "operational_space"},
    "event": {e.func for e in EVENTS.values()} | ELSEWHERE,
    "observation": {*(o.func for o in OBSERVATIONS.values()), "shape_index", *TERRAIN},
    "reward": set(REWARDS),
    "termination": set(TERMINATIONS),
    "metric": set(METRICS),
}


@pytest.mark.parametrize("kind", USED)
def test_every_registered_builtin_term_takes_part(kind) -> None:
    """A term that serves several kinds takes part in one, or by another name."""
    kinds = VALUE_KINDS if kind in VALUE_KINDS else (kind,)
    used = {name for each in kinds for name in USED[each]}
    own = {TERMS[each][name].func for each in kinds for name in USED[each]}
    funcs = {base for func in own for base in getattr(func, "__mro__", (func,))}
    missing = [
        name
        for name, spec in TERMS[kind].items()
        if spec.func.__module__.startswith("embodichain.") and name not in used
        if isinstance(spec, AliasSpec) or spec.func not in funcs
    ]
    assert missing == []
    assert USED[kind] <= set(TERMS[kind])
