"""Every mistake in a task's terms is reported at once, with its path."""

from typing import Any

import numpy as np
import pytest

from embodichain.lab.gym.envs.cfg import (
    ActionTermCfg,
    CommandCfg,
    CurriculumCfg,
    EnvCfg,
    EventCfg,
    MetricCfg,
    NoiseCfg,
    ObservationCfg,
    RewardCfg,
    SceneEntityCfg,
    TerminationCfg,
)
from embodichain.lab.gym.envs.managers.terms.check import SECTIONS, check_params, check_terms
from embodichain.lab.gym.envs.managers.terms.registry import TERMS, describe_term
from embodichain.lab.sim.configs.config_types import config_types

CUBE = {"entity_cfg": {"uid": "cube"}}
PAIR = {"source_entity_cfg": {"uid": "a"}, "target_entity_cfg": {"uid": "b"}}


def problems(**sections) -> list[str]:
    cfg = EnvCfg(**sections)
    return [str(p) for p in (*config_types(EnvCfg).check_instance(cfg), *check_terms(cfg))]


def test_a_correct_task_has_no_problem() -> None:
    box = [[-1, -1, -1], [1, 1, 1]]
    cfg = EnvCfg(
        events={
            "push": EventCfg(
                func="randomize_rigid_object_pose",
                params={**CUBE, "position_range": np.array(box), "relative_position": False},
            )
        },
        actions={"arm": ActionTermCfg(func="joint_position", params={"entity_cfg": {"uid": "r"}})},
        observations={
            "pose": ObservationCfg(func="get_object_pose", params=CUBE),
            "again": ObservationCfg(func=lambda env, data: data, mode="modify", name="pose"),
            "q": ObservationCfg(func=lambda env, data: data, mode="modify", name="robot/qpos"),
        },
        rewards={"near": RewardCfg(func="within_distance", params={**PAIR, "threshold": 0.1})},
        terminations={"t": TerminationCfg(func="time_out", params={"time_limit_s": 1})},
        metrics={"d": MetricCfg(func="distance_between_objects", params=PAIR)},
    )
    assert check_terms(cfg) == []


def test_every_mistake_is_found_at_once() -> None:
    found = problems(
        events={
            "a": EventCfg(func="randomize_rigid_object_poses"),
            "b": EventCfg(
                func="randomize_rigid_object_pose",
                params={"positon_range": [], "rotation_range": [[0, 0, 0], [1, -1, 1]]},
                mode="interval",
                interval_range_s=[2.0, 1.0],
            ),
        },
        rewards={"near": RewardCfg(func="within_distance", params={**PAIR, "threshold": -1.0})},
        commands={"velocity": CommandCfg(func="uniform_velocty")},
    )
    assert len(found) == 7
    assert found[0] == "events.b.interval_range_s: needs 0 < low <= high, got [2.0, 1.0]"
    assert found[1].startswith("events.a.func: unknown event term 'randomize_rigid_object_poses'")
    assert found[1].endswith("Did you mean 'randomize_rigid_object_pose'?")
    assert found[2].startswith("events.b.params.positon_range: unknown parameter of event term")
    assert found[2].endswith("Did you mean 'position_range'?")
    assert "low 0.0 exceeds high -1.0 in column 1" in found[3]
    assert found[4] == (
        "events.b.params.of: missing; event term 'randomize_rigid_object_pose' needs it"
    )
    assert found[6].startswith("rewards.near.params.threshold: must be greater than 0")
    assert found[5].startswith("commands.velocity.func: unknown command term 'uniform_velocty'")


@pytest.mark.parametrize(
    ("params", "path", "part"),
    [
        ({"entity_cfg": "cube"}, "entity_cfg", "got 'cube'"),
        ({"entity_cfg": {"uid": "cube", "link_name": "x"}}, "entity_cfg.link_name", "unknown key"),
        ({"entity_cfg": {"uid": 3}}, "entity_cfg.uid", "expected text, got 3"),
        ({"of": {"uid": 3}}, "of.uid", "expected text, got 3"),
        ({**CUBE, "of": {"uid": "cube"}}, "entity_cfg", "means the same as of: leave one out"),
        ({**CUBE, "to_matrix": "perhaps"}, "to_matrix", "got 'perhaps'"),
    ],
)
def test_types_of_parameters(params, path: str, part: str) -> None:
    found = check_params(TERMS["observation"]["get_object_pose"], params, "params")[1]
    assert [p.path for p in found] == [f"params.{path}"]
    assert part in found[0].message


def test_an_unknown_key_of_an_entity_has_its_closest_match() -> None:
    spec = TERMS["observation"]["get_object_pose"]
    found = check_params(spec, {"entity_cfg": {"uid": "c", "link_name": "x"}}, "params")[1]
    assert found[0].hint == "Did you mean 'link_names'?"


def test_values_are_converted_as_annotated() -> None:
    spec = TERMS["event"]["randomize_rigid_object_pose"]
    values, found = check_params(
        spec, {"entity_cfg": {"uid": "cube"}, "position_range": [[0, 0, 0], [1, 1, 1]]}, "p"
    )
    assert found == []
    assert values["of"] == SceneEntityCfg(uid="cube")
    assert values["position_range"][1] == [1.0, 1.0, 1.0]


def test_open_parameters_and_unknown_types_pass() -> None:
    class Odd:
        pass

    def term(env, env_ids, odd: Odd, plain, **rest):
        pass

    odd = Odd()
    values, found = check_params(
        describe_term("event", term), {"odd": odd, "plain": 3, "more": 1}, "p"
    )
    assert found == []
    assert values == {"odd": odd, "plain": 3, "more": 1}


def test_beside_the_parameters() -> None:
    found = problems(
        observations={
            "a": ObservationCfg(func="last_action", noise=NoiseCfg(), clip=[1.0, -1.0]),
            "b": ObservationCfg(func="last_action", name="x//y"),
            "c": ObservationCfg(func="last_action", name="a"),
            "d": ObservationCfg(func=lambda env, data: data, mode="modify", name="bb"),
        },
        actions={"arm": ActionTermCfg(func=lambda env: None)},
    )
    assert [f.partition(":")[0] for f in found] == [
        "observations.a.clip",
        "observations.b.name",
        "actions.arm.func",
        "observations.a.noise.std",
        "observations.c.name",
        "observations.d.name",
    ]
    assert "must be a subclass of ActionTerm" in found[2]
    assert "nothing to modify is called 'bb'" in found[5]


def test_a_class_that_cannot_be_called() -> None:
    class Lame:
        def __init__(self, env):
            pass

    found = problems(rewards={"r": RewardCfg(func=Lame)})
    assert found == ["rewards.r.func: class 'Lame' must define __call__"]


def test_a_log_imports_nothing() -> None:
    cfg = EnvCfg(rewards={"r": RewardCfg(func="some.module:f")})
    assert "would be imported" in str(check_terms(cfg, allow_import=False)[0])


def test_sections_are_those_of_the_config() -> None:
    assert all(hasattr(EnvCfg(), section) for section in SECTIONS)


@pytest.mark.parametrize(
    ("noise", "expected"),
    [
        (NoiseCfg(std=0.1), []),
        (NoiseCfg(mean=[0.0, 1.0], std=[0.1, 0.2]), []),
        (NoiseCfg(type="uniform", n_min=0.0, n_max=[1.0, 2.0]), []),
        (NoiseCfg(type="constant", bias=1.0, operation="scale"), []),
        (NoiseCfg(type="uniform"), [".low: missing", ".high: missing"]),
        (NoiseCfg(type="uniform", low=1.0, high=0.0), [": low 1.0 exceeds high 0.0"]),
        (NoiseCfg(type="uniform", low=[0.0], high=[1.0, 2.0]), [": low has 1 values, high 2"]),
        (NoiseCfg(type="uniform", low=0.0, n_min=0.0, high=1.0), [".n_min: means the same as low"]),
        (NoiseCfg(type="constant"), [".bias: missing"]),
    ],
)
def test_noise(noise, expected: list[str]) -> None:
    found = problems(observations={"a": ObservationCfg(func="last_action", noise=noise)})
    assert len(found) == len(expected)
    for line, part in zip(found, expected, strict=True):
        assert line.startswith(f"observations.a.noise{part}")


def test_delays_and_groups() -> None:
    found = problems(
        observations={"a": ObservationCfg(func="last_action", delay=[3, 1], group="critic")},
        enable_corruption={"critic": False, "critc": False},
        commands={
            "v": CommandCfg(
                func="uniform_joint_position",
                params={"entity_cfg": {"uid": "r"}},
                resampling_time_s=[0.0, 1.0],
            )
        },
    )
    assert found == [
        "commands.v.resampling_time_s: needs 0 < low <= high, got [0.0, 1.0]",
        "observations.a.delay: needs 0 <= low <= high, got [3, 1]",
        "enable_corruption.critc: no observation is in group 'critc'; there are: critic "
        "Did you mean 'critic'?",
    ]


def test_unknown_commands_are_found_without_building() -> None:
    found = problems(
        commands={
            "velocity": CommandCfg(
                func="uniform_velocity", params={"entity_cfg": {"uid": "r"}, "ranges": {}}
            )
        },
        observations={
            "c": ObservationCfg(func="generated_command", params={"command_name": "velocty"})
        },
    )
    assert found == [
        "observations.c.params.command_name: no command is called 'velocty'; there are: velocity "
        "Did you mean 'velocity'?"
    ]


def test_a_key_of_a_nested_parameter_has_its_closest_match() -> None:
    params = {"entity_cfg": {"uid": "r"}, "ranges": {"lin_vel": [0, 1]}}
    found = problems(commands={"v": CommandCfg(func="uniform_velocity", params=params)})
    assert found == [
        "commands.v.params.ranges.lin_vel: unknown key; allowed: lin_vel_x, lin_vel_y, ang_vel_z, "
        "heading. Did you mean 'lin_vel_x'?"
    ]


WEIGHT = {"term_name": "near", "weight": 2.0, "num_steps": 10}
PARAM = {
    "section": "rewards",
    "term_name": "near",
    "param": "threshold",
    "value": 0.5,
    "num_steps": 10,
}


@pytest.mark.parametrize(
    ("func", "params", "expected"),
    [
        ("modify_reward_weight", WEIGHT, None),
        (
            "modify_reward_weight",
            {**WEIGHT, "term_name": "neer"},
            "term_name: there is no 'neer' in rewards; there are: near Did you mean 'near'?",
        ),
        ("modify_reward_weight", {**WEIGHT, "start_step": 3}, "start_step: has a meaning with"),
        (
            "modify_reward_weight",
            {**WEIGHT, "start_step": 10, "interpolate": True},
            "start_step: must be before num_steps, 10",
        ),
        ("modify_term_param", PARAM, None),
        ("modify_term_param", {**PARAM, "interpolate": True}, None),
        (
            "modify_term_param",
            {**PARAM, "section": "reward"},
            "section: expected one of 'commands', 'events'",
        ),
        ("modify_term_param", {**PARAM, "term_name": "far"}, "term_name: there is no 'far'"),
        ("modify_term_param", {**PARAM, "param": "treshold"}, "param: there is no 'treshold'"),
        (
            "modify_term_param",
            {**PARAM, "value": -1.0},
            "value: threshold: must be greater than 0.0, got -1.0",
        ),
        (
            "modify_term_param",
            {**PARAM, "param": "target_entity_cfg.uid", "value": "c", "interpolate": True},
            "value: cannot go gradually from 'b' to 'c'",
        ),
        ("modify_term_param", {**PARAM, "param": "target_entity_cfg.uid", "value": "c"}, None),
        ("modify_term_param", {**PARAM, "param": "shape"}, "param: there is no 'shape'"),
    ],
)
def test_what_a_curriculum_points_at(func: str, params, expected: str | None) -> None:
    found = problems(
        rewards={"near": RewardCfg(func="within_distance", params={**PAIR, "threshold": 0.1})},
        curriculum={"c": CurriculumCfg(func=func, params=params)},
    )
    if expected is None:
        assert found == []
    else:
        assert len(found) == 1
        assert found[0].startswith(f"curriculum.c.params.{expected}")


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("shape.tanh", 0.05, None),
        ("shape.tanh", -1.0, "value: shape.tanh.std: must be greater than 0.0"),
        ("shape", {"tanh": 0.05}, None),
        ("shape", "l1", "param: the shapes of a term stay the same"),
        ("shape.tan", 1.0, "param: there is no 'tan' in shape; there is: tanh"),
    ],
)
def test_a_curriculum_of_a_shape(name: str, value: Any, expected: str | None) -> None:
    given = {**PARAM, "param": name, "value": value}
    found = problems(
        rewards={"near": RewardCfg(func="distance", params=PAIR, shape={"tanh": 0.1})},
        curriculum={"c": CurriculumCfg(func="modify_term_param", params=given)},
    )
    assert [f.startswith(f"curriculum.c.params.{expected}") for f in found] == (
        [] if expected is None else [True]
    )


class Short:
    """A term whose `__call__` lacks what a reward is given."""

    def __init__(self, env):
        pass

    def __call__(self, env, obs):
        return None


def test_a_class_must_take_what_terms_of_its_kind_are_given() -> None:
    wanted = "__call__ must take (self, env, obs, action, info), it takes (self, env, obs)"
    found = problems(rewards={"r": RewardCfg(func=Short)})
    assert found == [f"rewards.r.func: class 'Short': {wanted}"]
