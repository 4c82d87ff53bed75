"""`kind_test_words`: what the test of a new task looks at besides its seed, by kind."""

from __future__ import annotations

__all__ = ["kind_test_words"]

_POLICIES = "from embodichain.lab.gym.policies import resolve_policy\n"
_EXPERT = """

def test_the_expert_succeeds(make: Make) -> None:
    env = make(16)
    obs, _ = env.reset(seed=1)
    expert = resolve_policy("expert")
    successes = 0
    for _ in range(env.max_episode_steps):
        obs, _, terminated, truncated, info = env.step(expert(obs, env))
        successes += int((info["success"] & (terminated | truncated)).sum())
    assert successes >= 12
"""
_STANDS = """

def test_it_stands_where_nothing_moves_it(make: Make) -> None:
    env = make(4)
    obs, _ = env.reset(seed=1)
    hold = resolve_policy("hold")
    for _ in range(50):
        obs, _, terminated, _, _ = env.step(hold(obs, env))
        assert not terminated.any()
"""
_AT_GOAL = """

def test_at_the_goal_is_the_best_place(make: Make) -> None:
    env = make(2)
    env.reset(seed=1)
    places = env.robot.get_{frame}_pose("tool")
    places[1, 2] += 1.0
    env.sim.rigid_objects["goal"].set_local_pose(places)
    reward, info = env.step(torch.from_numpy(env.action_manager.hold()).float())[1::3]
    assert reward[0] > reward[1]
    assert info["success"].tolist() == [True, False]
"""


def kind_test_words(kind: str, tool_kind: str) -> dict[str, str]:
    """Return the template's variables of a kind.

    Args:
        kind: The name of the kind.
        tool_kind: Whether the tool is a ``link`` or a ``site``; of no use to a robot that walks.
    """
    if kind == "reach":
        further = _AT_GOAL.format(frame=tool_kind)
        return {"imports": "", "drawn": "to_goal", "further": further.rstrip("\n")}
    if kind == "velocity":
        return {"imports": _POLICIES, "drawn": "qpos", "further": _STANDS.rstrip("\n")}
    return {"imports": _POLICIES, "drawn": "to_goal", "further": _EXPERT.rstrip("\n")}
