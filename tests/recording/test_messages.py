"""What we write by hand is what protobuf writes, and what it reads."""

import numpy as np
import pytest

from embodichain.lab.gym.envs.observers import EventRecord
from embodichain.recording import messages as m
from embodichain.recording.schemas import message_class


def joined(parts):
    return b"".join(parts)


def canonical(name, **fields):
    return message_class(name)(**fields).SerializeToString(deterministic=True)


@pytest.mark.parametrize("step", [0, 1, 127, 128, 2**40])
@pytest.mark.parametrize("n", [1, 3])
@pytest.mark.parametrize("ids", [None, np.array([0, 300])])
def test_state(step, n, ids):
    rows = np.random.default_rng(0).normal(size=(n, 5))
    data = joined(m.encode_state(step, rows, 2 * step, 4, ids))
    fields = {} if ids is None else {"env_ids": ids.tolist()}
    assert data == canonical(
        "BatchedState",
        step=step,
        num_envs=n,
        width=5,
        state=rows.ravel().tolist(),
        call=2 * step,
        nstep=4,
        **fields,
    )
    state = m.State.decode(data)
    assert (state.step, state.call, state.nstep) == (step, 2 * step, 4)
    assert state.rows.tobytes() == rows.tobytes()
    assert (state.env_ids is None) if ids is None else (state.env_ids.tolist() == ids.tolist())


def test_the_first_fields_of_a_state_are_the_published_ones():
    fields = {f.name: f.number for f in message_class("BatchedState").DESCRIPTOR.fields}
    assert list(fields.items())[:4] == [
        ("step", 1), ("num_envs", 2), ("width", 3), ("state", 4),
    ]  # fmt: skip


@pytest.mark.parametrize("width", [0, 6])
@pytest.mark.parametrize("failed", [None, np.array([1])])
def test_step(width, failed):
    n, rng = 3, np.random.default_rng(0)
    action, reward = rng.normal(size=(n, width)), rng.normal(size=n).astype(np.float32)
    terminated, truncated = np.array([True, False, False]), np.zeros(n, bool)
    episodes, hashes = np.array([0, -1, 2**40]), rng.integers(0, 2**64, n, np.uint64)
    calls = m.Calls(9, 11, None, hashes, failed)
    data = joined(m.encode_step(9, action, reward, terminated, truncated, episodes, calls))
    fields = {} if failed is None else {"failed": [1]}
    assert data == canonical(
        "Step",
        step=9,
        call=11,
        num_envs=n,
        action_width=width,
        action=action.ravel().tolist(),
        reward=reward.tolist(),
        terminated=b"\1\0\0",
        truncated=b"\0\0\0",
        episode_id=episodes.tolist(),
        hash=hashes.tolist(),
        **fields,
    )
    step = m.StepOutcome.decode(data)
    assert step.action.tobytes() == action.tobytes()
    assert step.reward.tolist() == reward.tolist()
    assert step.terminated.tolist() == terminated.tolist()
    assert step.episode_ids.tolist() == episodes.tolist()
    assert step.physics.hashes.tolist() == hashes.tolist()


def test_call():
    hashes = np.array([1, 2**63], np.uint64)
    data = joined(m.encode_call(m.Calls(3, 4, np.array([0, 7]), hashes, np.array([7]))))
    assert data == canonical(
        "PhysicsCall", step=3, call=4, env_ids=[0, 7], hash=hashes.tolist(), failed=[7]
    )
    assert m.Calls.decode(data).failed.tolist() == [7]


@pytest.mark.parametrize("columns", [None, np.array([2, 0])])
@pytest.mark.parametrize("ids", [None, np.array([5])])
@pytest.mark.parametrize("values", [None, np.arange(6.0).reshape(3, 2)[:, ::-1]])
def test_write(columns, ids, values):
    head = m.write_head("before_physics", "state", "qpos", columns)
    data = joined(m.encode_write(m.stamp(0, 300), head, ids, values))
    fields = {}
    if columns is not None:
        fields["columns"] = columns.tolist()
    if ids is not None:
        fields["env_ids"] = ids.tolist()
    if values is not None:
        fields["values"] = values.ravel().tolist()
    assert data == canonical(
        "Write", call=300, phase="before_physics", op="state", field="qpos", **fields
    )
    write = m.WriteRecord.decode(data)
    assert (write.step, write.call, write.op, write.field) == (0, 300, "state", "qpos")
    assert write.values.tolist() == fields.get("values", [])


def test_event():
    drawn = {"pose": np.arange(6.0).reshape(2, 3), "flag": np.array([True, False])}
    data = joined(m.encode_event(m.stamp(1, 0), EventRecord("a", "reset", np.array([3]), drawn)))
    assert data == canonical(
        "Event",
        step=1,
        term="a",
        mode="reset",
        env_ids=[3],
        drawn=[
            {"name": "pose", "shape": [2, 3], "values": [0, 1, 2, 3, 4, 5]},
            {"name": "flag", "shape": [2], "values": [1, 0]},
        ],
    )


def test_rows_that_are_not_as_many_as_announced_are_refused():
    data = canonical("BatchedState", num_envs=2, width=3, state=[1.0] * 5)
    with pytest.raises(ValueError, match="5 numbers where 2 rows of 3"):
        m.State.decode(data)
