"""A diverging environment ends as such, and does not touch its neighbours."""

import numpy as np
import pytest
import torch

import embodichain
from tests.end_to_end.test_invariance import action_of, tensors

pytestmark = [pytest.mark.unmeasured, pytest.mark.slow]

SICK, STEPS = 1, 6
STATE = [f"{f}={v}" for f in ("qpos", "qvel", "mocap_pos") for v in ("nan", "inf", "1e30")]
# In these, nothing shows it: only the neighbours are compared.
QUIET = {"zero quaternion", "heavy", "mocap_pos=1e30"}


def poison(env, name):
    """Write below the handles, whose own checks raise."""
    engine, where = env.sim.engine, np.array([SICK])
    if name == "zero quaternion":
        cube = env.sim.get_rigid_object("cube")
        start = cube.entity.free_qpos_adr
        if start >= 0:
            engine.write("qpos", 0.0, where, slice(start + 3, start + 7))
        else:
            engine.write("mocap_quat", 0.0, where)
    elif name == "heavy":
        engine.write_model("body_mass", 1e30, where)
    else:
        field, value = name.split("=")
        engine.write(field, float(value), where)


def play(task, name):
    env = embodichain.make(task, num_envs=4, overrides=["seed=3", "sim.num_threads=2"])
    env.reset()
    if name == "heavy" or name is None:  # so that both run on expanded masses
        env.sim.engine.model_field("body_mass")
    out, flags = [], []
    for step in range(STEPS):
        if step == 2 and name not in (None, "action"):
            poison(env, name)
        obs, reward, terminated, truncated, info = env.step(action_of(env, step))
        everything = [*tensors(obs), reward, terminated, truncated, info["elapsed_steps"]]
        rows = [np.ascontiguousarray(t.numpy()).reshape(4, -1).view(np.uint8) for t in everything]
        rows.append(env.sim.engine.rows.copy().view(np.uint8))
        out.append(np.concatenate(rows, axis=1))
        assert all(bool(torch.isfinite(t).all()) for t in tensors(obs) if t.is_floating_point())
        assert torch.isfinite(reward).all()
        if "final_obs" in info:
            assert all(torch.isfinite(t).all() for t in tensors(info["final_obs"]))
        flags.append((info["diverged"].tolist(), terminated.tolist(), reward.tolist()))
    env.close()
    return np.stack(out), flags


@pytest.fixture(scope="module")
def clean():
    return {task: play(task, None)[0] for task in ("random_reach", "push_cube")}


@pytest.mark.parametrize("task", ["random_reach", "push_cube"])
@pytest.mark.parametrize("name", [*STATE, "zero quaternion", "heavy"])
def test_a_poisoned_environment(clean, task, name):
    got, flags = play(task, name)
    healthy = [i for i in range(4) if i != SICK]
    np.testing.assert_array_equal(got[:, healthy], clean[task][:, healthy])
    if name in QUIET:
        return
    seen = [diverged[SICK] for diverged, _, _ in flags]
    # A pose that an event overwrites in every step shows in that step or not at all.
    if task == "random_reach" and name.startswith("mocap"):
        return
    assert seen.index(True) == 2, f"found in step {seen.index(True) if True in seen else None}"
    diverged, terminated, reward = flags[2]
    assert terminated[SICK] and reward[SICK] == 0.0
    assert not any(d for step, _, _ in flags for i, d in enumerate(step) if i != SICK)
    assert not any(seen[3:]), "after its reset it is healthy"


def test_a_nan_action_raises_before_anything_is_written():
    env = embodichain.make("reach", num_envs=3)
    env.reset()
    action = action_of(env, 0)
    action[1, 2] = float("nan")
    before = env.sim.engine.rows.copy()
    with pytest.raises(ValueError, match="finite"):
        env.step(action)
    np.testing.assert_array_equal(env.sim.engine.rows, before)
    env.close()
