"""Events, commands and actions with arrays on a device do what they do with arrays of the host."""

from collections.abc import Iterator
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import torch
import yaml
from mujoco import batch as mjbatch
from numpy.testing import assert_allclose

import embodichain
from embodichain.lab.gym.envs.base_env import BaseEnv
from embodichain.lab.gym.envs.cfg import ActionTermCfg, EventCfg
from embodichain.lab.gym.envs.managers.manager import build_term
from embodichain.utils.arrays import tensor_of
from embodichain.utils.errors import ConfigError
from tests.helpers.example_scene import write_task
from tests.lab.gym.envs.mdp.test_examples import ENTRIES, example_of

pytestmark = [pytest.mark.unmeasured, pytest.mark.slow]

N, CHOSEN = 4, np.array([1, 2])
SECTIONS = {"event": "events", "command": "commands", "action": "actions"}
EXAMPLES = {
    kind: {e.name: example_of(e, kind) for e in ENTRIES if kind in e.kinds} for kind in SECTIONS
}
STEPS, SEARCH = "physics steps of some environments", "searches for joint positions"
REFUSED = {
    "arrange_objects": ({}, "searches for free places"),
    "place_terrain": ({}, "terms of a terrain"),
    "planner_grid_cell_sampler": ({"physics_update_step": 5}, f"physics_update_step: {STEPS}"),
    "randomize_pose": ({"physics_update_step": 5}, f"physics_update_step: {STEPS}"),
    "randomize_robot_eef_pose": ({}, SEARCH),
    "record_camera_data": ({}, "videos"),
    "register_info_to_env": ({"sim_update": True}, f"sim_update: {STEPS}"),
    "sample_rigid_object_pose_from_workspace": ({}, SEARCH),
    "wait_for_dynamic_objects_to_settle": ({}, STEPS),
}
"""Events that are refused with some parameters, and words of the message."""
NO_FIELD = {"randomize_shape"}
"""Events that write a field that Warp does not have for each world, wherever arrays are."""
LEFT_OUT = {name for name, (given, _) in REFUSED.items() if not given}
EVENTS = EXAMPLES["event"].keys() - LEFT_OUT - NO_FIELD


class Pair(NamedTuple):
    """The same task with arrays of the host and of the device."""

    host: BaseEnv
    device: BaseEnv


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Pair]:
    folder = tmp_path_factory.mktemp("tasks")
    events = {name: term for name, term in EXAMPLES["event"].items() if name not in LEFT_OUT}
    write_task("events", events, folder)
    file = folder / "task" / "everything.yaml"
    tree = yaml.safe_load(file.read_text())
    tree["sensors"] = {n: s for n, s in tree["sensors"].items() if s["sensor_type"] == "camera"}
    tree |= {"commands": EXAMPLES["command"], "actions": EXAMPLES["action"], "rewards": {}}
    file.write_text(yaml.safe_dump(tree, sort_keys=False))
    made = []
    sizes = "sim.warp.nconmax=64", "sim.warp.njmax=256"
    for arrays in ("host", "device"):
        lines = ["seed=1", "sim.engine=warp", f"sim.warp.arrays={arrays}", *sizes]
        made.append(embodichain.make("everything", N, lines, config_dir=folder))
    yield Pair(*made)
    for env in made:
        env.close()


def rows(env: BaseEnv) -> Any:
    engine: Any = env.sim.engine
    return engine.host_rows() if env.arrays.on_device else engine.rows.copy()


def fields(env: BaseEnv) -> dict[str, Any]:
    """The model as physics sees it, and poses of geoms."""
    engine: Any = env.sim.engine
    engine.acceleration("qacc")
    found = {name: env.arrays.host(engine.derived(name)) for name in ("geom_xpos", "geom_xmat")}
    for name in sorted(mjbatch.MODEL_FIELDS):
        values = engine.worlds.own_field(name)
        if values is not None:
            found[name] = values.cpu().numpy()
    return found


def assert_alike(pair: Pair, tolerance: float = 1e-5) -> None:
    """Draws, states and model fields are the same."""
    assert_same_draws(*(env.streams.state_dict()["counters"] for env in pair))
    assert_allclose(rows(pair.device), rows(pair.host), rtol=tolerance, atol=tolerance)
    host, device = map(fields, pair)
    for name, values in host.items():
        here = device[name].reshape(values.shape)
        assert_allclose(here, values, rtol=1e-4, atol=tolerance, err_msg=name)


def assert_same_draws(first: dict[str, Any], second: dict[str, Any]) -> None:
    """Each environment has drawn as many numbers from each stream."""
    assert first.keys() == second.keys()
    for name, drawn in first.items():
        assert np.array_equal(drawn, second[name]), name


def fire(env: BaseEnv, name: str) -> None:
    mode = EXAMPLES["event"][name]["mode"]
    env.event_manager.call_with_draws(name, mode, env.arrays.environments(CHOSEN, N), {})


@pytest.mark.parametrize("name", sorted(EVENTS))
def test_events_draw_and_write_the_same(pair: Pair, name: str) -> None:
    before = [rows(env) for env in pair]
    for env in pair:
        fire(env, name)
        if EXAMPLES["event"][name].get("interval_step") == 1:
            fire(env, name)
    assert_alike(pair)
    for env, old in zip(pair, before, strict=True):
        others = np.setdiff1d(np.arange(N), CHOSEN)
        assert np.array_equal(rows(env)[others], old[others])


LOOKS = ("camera_pose", "camera_fovy", "camera_intrinsics", "light", "texture", "visual_material")


def test_pictures_show_what_events_draw(pair: Pair) -> None:
    """Of the environments that they chose; another renderer draws on the host."""

    def pictures() -> list[Any]:
        return [env.arrays.host(env.get_sensor("front").read("color")).astype(int) for env in pair]

    before = pictures()
    for env in pair:
        for name in LOOKS:
            fire(env, f"randomize_{name}")
    after = pictures()
    for old, new in zip(before, after, strict=True):
        changed = np.abs(new - old).max(axis=(1, 2, 3)) > 8
        assert changed.tolist() == [False, True, True, False]
    # Coarse pixels at edges and of patterns differ.
    assert np.median(np.abs(after[1] - after[0]).max(axis=-1)) < 8


@pytest.mark.parametrize("name", sorted(REFUSED))
def test_events_without_a_form_on_a_device_are_refused(pair: Pair, name: str) -> None:
    given, message = REFUSED[name]
    example = EXAMPLES["event"][name]
    cfg = EventCfg(**example | {"params": example.get("params", {}) | given})
    with pytest.raises(ConfigError, match=message):
        build_term(pair.device, "event", name, cfg, f"events.{name}")


@pytest.mark.parametrize("name", sorted(NO_FIELD))
def test_model_fields_that_all_worlds_share_are_refused(pair: Pair, name: str) -> None:
    for env in pair:
        with pytest.raises(ConfigError, match="cannot differ between environments in MuJoCo Warp"):
            fire(env, name)
            env.sim.engine.derived("xpos")


@pytest.mark.parametrize("name", sorted(EXAMPLES["command"]))
def test_commands_draw_the_same(pair: Pair, name: str) -> None:
    values = []
    for env in pair:
        commands = env.command_manager
        commands.resample(env.arrays.environments(CHOSEN, N))
        commands.step(None)
        metrics: dict[str, torch.Tensor] = {}
        commands.report(metrics)
        values.append({"values": commands.get_command(name), **metrics})
    assert values[0].keys() == values[1].keys()
    for key, value in values[0].items():
        assert_allclose(values[1][key].cpu(), value, rtol=1e-5, atol=1e-5, err_msg=key)


def acted(env: BaseEnv, term: Any, seed: int) -> dict[str, Any]:
    """What an action term writes and returns for a drawn action."""
    assert np.isfinite(env.arrays.host(term.hold())).all()
    share = np.random.default_rng(seed).uniform(0.1, 0.9, (N, len(term.low))).astype(np.float32)
    action = term.low + share * (term.high - term.low)
    term.apply(tensor_of(env.arrays.put(action)))
    term.before_physics()
    metrics = getattr(term, "metrics", dict)()
    return {
        "rows": rows(env),
        "hold": np.broadcast_to(env.arrays.host(term.hold()), action.shape),
        **{key: env.arrays.host(value) for key, value in metrics.items()},
    }


def assert_acts_the_same(pair: Pair, terms: list[Any]) -> None:
    for seed in range(2):
        host, device = (acted(env, term, seed) for env, term in zip(pair, terms, strict=True))
        assert host.keys() == device.keys()
        for key, value in host.items():
            assert_allclose(device[key], value, rtol=1e-4, atol=2e-4, err_msg=key)


@pytest.mark.parametrize("name", sorted(EXAMPLES["action"]))
def test_actions_write_the_same(pair: Pair, name: str) -> None:
    assert_acts_the_same(pair, [env.action_manager.terms[name].instance for env in pair])


UR10, FINGER = {"uid": "ur10"}, {"uid": "panda", "joint_names": "panda_finger_joint1"}
PANDA = {"uid": "panda", "joint_names": "panda_joint.*"}
VARIANTS = {
    "eef_pose": [
        {"of": UR10, "frame": "world", "rotation": "quat", "max_velocity": 0.5},
        {"of": UR10, "rotation": "rpy"},
        {"of": UR10, "rotation": "free", "posture_gain": 0.1},
    ],
    "eef_delta_pose": [
        {"of": UR10, "frame": "world", "rotation": "keep", "reference": "qpos"},
        {"of": UR10, "frame": "base", "rotation": "free", "posture_gain": 0.2},
    ],
    "joint_action": [
        {"of": UR10, "control": "velocity", "scale": 0.3, "clip": [-1, 1]},
        {"of": UR10, "centre": "qpos", "clip": [-1, 1]},
        {"of": {"uid": "go"}, "control": "effort", "scale": 9.0, "clip": [-1, 1]},
    ],
    "operational_space": [
        {"of": PANDA, "command": "pose", "frame": "world", "max_position_error": 0.02},
        {"of": PANDA, "frame": "tool", "rotation": "free", "reference": "target"},
    ],
    "parallel_gripper": [
        {"of": FINGER, "width": [0.0, 0.08], "force": 5.0, "speed": 0.1},
        {"of": FINGER, "command_mode": "binary", "open_command": 0.04, "close_command": 0.0},
    ],
}
"""Action -> parameters by which it computes otherwise than in its example."""


@pytest.mark.parametrize(
    ("name", "params"),
    [(name, params) for name, several in VARIANTS.items() for params in several],
)
def test_actions_with_other_parameters_write_the_same(
    pair: Pair, name: str, params: dict[str, Any]
) -> None:
    cfg = ActionTermCfg(func=name, params=params)
    terms = [build_term(env, "action", name, cfg, f"actions.{name}").instance for env in pair]
    assert_acts_the_same(pair, terms)


def test_impedance_without_decoupling_is_refused(pair: Pair) -> None:
    cfg = ActionTermCfg(func="operational_space", params={"of": PANDA, "decoupling": False})
    with pytest.raises(
        ConfigError, match="actions.arm.params.decoupling: the modes of its dampers"
    ):
        build_term(pair.device, "action", "arm", cfg, "actions.arm")


OFTEN = {"mode": "interval", "interval_range_s": [0.03, 0.07]}
EVERY_STEP = {"mode": "interval", "interval_step": 1}
SPEEDS = {"velocity_range": {"x": [-0.3, 0.3], "yaw": [-0.3, 0.3]}}
ROBOT = {"of": {"uid": "robot"}}
OVER_TIME = {
    "push": {"func": "push_by_setting_velocity", **OFTEN, "params": ROBOT | SPEEDS},
    "push_all": {
        **{"func": "push_by_setting_velocity", **OFTEN, "is_global": True},
        "params": ROBOT | SPEEDS,
    },
    "push_later": {
        **{"func": "push_articulation_by_setting_velocity", **EVERY_STEP},
        "params": {**ROBOT, **SPEEDS, "interval_range_s": [0.03, 0.07]},
    },
    "impulse": {
        **{"func": "apply_body_impulse", **EVERY_STEP},
        "params": {
            **{**ROBOT, "force_range": [-20, 20], "torque_range": [-1, 1]},
            **{"duration_s": [0.03, 0.05], "cooldown_s": [0.03, 0.05]},
        },
    },
    "randomize": {
        **{"func": "randomize", "mode": "reset"},
        "params": {**ROBOT, "mass": [0.8, 1.2], "operation": "scale", "stiffness": [0.9, 1.1]},
    },
}


def walked(folder: Path, arrays: str) -> dict[str, Any]:
    """What 14 steps of a walking robot give, with episodes of 6 steps."""
    lines = ["seed=4", "sim.engine=warp", f"sim.warp.arrays={arrays}"]
    lines += ["sim.warp.nconmax=64", "sim.warp.njmax=256"]
    env = embodichain.make("walk", N, lines, config_dir=folder)
    rng, found = np.random.default_rng(0), []
    try:
        env.reset()
        for _ in range(14):
            action = rng.uniform(-1, 1, (N, 12)).astype(np.float32)
            _, reward, _, truncated, _ = env.step(torch.from_numpy(action))
            command = env.command_manager.get_command("velocity")
            found.append((rows(env)[:, :37], reward, truncated, command))
        names = "rows", "reward", "truncated", "command"
        columns = (np.stack([np.asarray(v) for v in part]) for part in zip(*found, strict=True))
        return {**dict(zip(names, columns, strict=True)), "streams": env.streams.state_dict()}
    finally:
        env.close()


def test_intervals_delays_and_noise_are_the_same_over_several_episodes(tmp_path: Path) -> None:
    file = resources.files("embodichain") / "conf" / "task" / "quadruped_velocity.yaml"
    tree = yaml.safe_load(file.read_text())
    tree["max_episode_steps"] = 6
    tree["actions"]["legs"] |= {
        **{"delay": [0, 2], "noise": {"type": "gaussian", "mean": 0.0, "std": 0.1}},
    }
    tree["commands"]["velocity"]["resampling_time_s"] = [0.03, 0.07]
    tree["events"] |= OVER_TIME
    (tmp_path / "task").mkdir()
    (tmp_path / "task" / "walk.yaml").write_text(yaml.safe_dump(tree, sort_keys=False))
    host, device = (walked(tmp_path, arrays) for arrays in ("host", "device"))
    draws = [found.pop("streams")["counters"] for found in (host, device)]
    assert_same_draws(*draws)
    for key, values in host.items():
        assert_allclose(device[key], values, rtol=1e-3, atol=1e-3, err_msg=key)
    assert host["truncated"].sum() == 2 * N
