"""Every mistake in a task's terms is reported at once, with its path."""

import numpy as np
import pytest

from embodichain.lab.gym.envs.cfg import (
    ActionTermCfg,
    EnvCfg,
    EventCfg,
    MetricCfg,
    ObservationCfg,
    RewardCfg,
    SceneEntityCfg,
    TerminationCfg,
)
from embodichain.lab.gym.envs.managers.check import SECTIONS, check_params, check_terms
from embodichain.lab.gym.envs.managers.registry import TERMS, describe_term

CUBE = {"entity_cfg": {"uid": "cube"}}
PAIR = {"source_entity_cfg": {"uid": "a"}, "target_entity_cfg": {"uid": "b"}}


def problems(**sections) -> list[str]:
    return [str(p) for p in check_terms(EnvCfg(**sections))]


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
        commands={"velocity": {}},
    )
    assert len(found) == 7
    assert found[0].startswith("events.a.func: unknown event term 'randomize_rigid_object_poses'")
    assert found[0].endswith("Did you mean 'randomize_rigid_object_pose'?")
    assert found[1] == "events.b.interval_range_s: needs 0 < low <= high, got [2.0, 1.0]"
    assert found[2].startswith("events.b.params.positon_range: unknown parameter of event term")
    assert found[2].endswith("Did you mean 'position_range'?")
    assert "low 0.0 exceeds high -1.0 in column 1" in found[3]
    assert found[4] == (
        "events.b.params.entity_cfg: missing; event term 'randomize_rigid_object_pose' needs it"
    )
    assert found[5].startswith("rewards.near.params.threshold: input should be greater than 0")
    assert found[6] == "commands: not available yet; leave it out"


@pytest.mark.parametrize(
    ("params", "path", "part"),
    [
        ({"entity_cfg": "cube"}, "entity_cfg", "got 'cube'"),
        ({"entity_cfg": {"uid": "cube", "link_name": "x"}}, "entity_cfg.link_name", "unknown key"),
        ({"entity_cfg": {"uid": 3}}, "entity_cfg.uid", "valid string, got 3"),
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
    assert values["entity_cfg"] == SceneEntityCfg(uid="cube")
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
            "a": ObservationCfg(func="last_action", noise={"std": 1}, clip=[1.0, -1.0]),
            "b": ObservationCfg(func="last_action", name="x//y"),
            "c": ObservationCfg(func="last_action", name="a"),
            "d": ObservationCfg(func=lambda env, data: data, mode="modify", name="bb"),
        },
        actions={"arm": ActionTermCfg(func=lambda env: None)},
    )
    assert [f.partition(":")[0] for f in found] == [
        "actions.arm.func",
        "observations.a.noise",
        "observations.a.clip",
        "observations.b.name",
        "observations.c.name",
        "observations.d.name",
    ]
    assert "must be a subclass of ActionTerm" in found[0]
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
