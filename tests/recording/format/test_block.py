"""Runs of control steps, and the messages that hold them."""

import numpy as np
import pytest
import zstandard
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

from embodichain.recording.format.log_error import DamageError
from embodichain.recording.format.messages.block import (
    ArrayKind,
    CallKind,
    pack_steps,
    unpack_steps,
)
from embodichain.recording.format.messages.packing import load, store
from embodichain.recording.format.messages.schema import (
    descriptor_set,
    message_class,
    scalars_class,
    scalars_descriptor_set,
)

N, MOVED, NSTATE = 3, 5, 9
KINDS = [
    CallKind("write", "ctrl", "state", 0, (0, 2), (ArrayKind("values", "<f8", (N, 2)),)),
    CallKind("physics", nstep=4, arrays=(ArrayKind("rows", "<f8", (N, MOVED)),)),
    CallKind(
        "write",
        "row",
        "reset",
        arrays=(ArrayKind("env_ids", "<i8", (2,)), ArrayKind("values", "<f8", (2, NSTATE))),
    ),
    CallKind("write", "", "set_const"),
    CallKind("event", "push", "interval", arrays=(ArrayKind("drawn.force", "<f8", (N, 3)),)),
    CallKind(
        "step",
        arrays=(
            ArrayKind("action", "<f8", (N, 2)),
            ArrayKind("reward", "<f4", (N,)),
            ArrayKind("terminated", "|b1", (N,)),
            ArrayKind("truncated", "|b1", (N,)),
            ArrayKind("episode_ids", "<i8", (N,)),
        ),
    ),
]


def steps(count, actions_differ=False):
    generator = np.random.default_rng(0)
    made = []
    for k in range(count):
        action = generator.normal(size=(N, 2))
        made.append([
            [action],
            [generator.normal(size=(N, MOVED))],
            [np.array([0, 2]), generator.normal(size=(2, NSTATE))],
            [],
            [generator.normal(size=(N, 3))],
            [
                action + actions_differ,
                np.full(N, k, np.float32),
                np.array([False, k == 1, False]),
                np.zeros(N, np.bool_),
                np.arange(N),
            ],
        ])  # fmt: skip
    return made


def pack(first, kinds, made):
    """The message of steps with the same calls."""
    recorded = [
        [(kind, tuple(map(np.asarray, arrays))) for kind, arrays in zip(kinds, step, strict=True)]
        for step in made
    ]
    return b"".join(map(bytes, pack_steps(first, recorded)))


def unpack(data):
    """The only run of a message."""
    (run,) = unpack_steps(data, N, MOVED, NSTATE)
    return run


@pytest.mark.parametrize("count", [1, 7, 200])
def test_a_run_is_read_as_it_was_written(count):
    made = steps(count)
    run = unpack(pack(130, KINDS, made))
    assert (run.first, run.count, run.steps) == (130, count, count)
    assert [call.kind for call in run.calls] == KINDS
    for i, call in enumerate(run.calls):
        assert list(call.arrays) == [array.name for array in KINDS[i].arrays]
        for j, values in enumerate(call.arrays.values()):
            expected = np.stack([step[i][j] for step in made])
            assert values.dtype == expected.dtype and values.tobytes() == expected.tobytes()


def test_a_run_that_ends_within_a_step_has_no_control_steps():
    run = unpack(pack(3, KINDS[:2], [steps(1)[0][:2]]))
    assert (run.first, run.count, run.steps) == (3, 1, 0)


def test_equal_arrays_are_stored_once():
    same, other = (len(pack(0, KINDS, steps(50, differ))) for differ in (False, True))
    assert other - same == pytest.approx(50 * N * 2 * 8, abs=8)


def test_an_array_that_differs_in_few_numbers_from_another_is_read_as_it_was_written():
    made = steps(50)
    for step in made:
        step[5][0] = step[0][0].copy()
        step[5][0][1, 1] = np.nan
    data = pack(0, KINDS, made)
    assert len(data) < len(pack(0, KINDS, steps(50, actions_differ=True))) + 50
    run = unpack(data)
    expected = np.stack([step[5][0] for step in made])
    assert run.calls[5].arrays["action"].tobytes() == expected.tobytes()
    written = run.calls[0].arrays["values"]
    assert written.tobytes() == np.stack([step[0][0] for step in made]).tobytes()
    assert len(zstandard.compress(data)) < len(data) - 50 * N * 2 * 6


def test_equal_bytes_of_another_type_are_another_array():
    types = [("<f8", (12,)), ("|b1", (96,)), ("<i8", (12,)), ("<f8", (12,))]
    places, parts = store([(dtype, [np.zeros(shape, dtype)]) for dtype, shape in types])
    stored = memoryview(b"".join(parts))
    for (dtype, shape), place in zip(types, places, strict=True):
        found = load("a", dtype, shape, place, stored)
        assert found.dtype == dtype and not found.any()
    assert places[0] == places[3]


@pytest.mark.parametrize("special", [0.0, -0.0, np.inf, np.nan, 1e-40, 1e300, 0.1])
def test_float32_values_take_half_the_bytes_and_come_back_as_they_were(special):
    made = steps(50)
    for step in made:
        step[0][0] = step[0][0].astype(np.float32).astype(np.float64)
        step[0][0][2, 1] = special
    data = pack(0, KINDS, made)
    expected = np.stack([step[0][0] for step in made])
    assert unpack(data).calls[0].arrays["values"].tobytes() == expected.tobytes()
    saved = len(pack(0, KINDS, steps(50, actions_differ=True))) - len(data)
    single = special not in (1e-40, 1e300, 0.1)
    assert saved == pytest.approx(50 * N * 2 * 4 if single else 0, abs=30)


def test_the_schema_in_the_file_decodes_a_run():
    files = descriptor_pb2.FileDescriptorSet.FromString(descriptor_set("embodichain.Steps"))
    pool = descriptor_pool.DescriptorPool()
    for file in files.file:
        pool.Add(file)
    cls = message_factory.GetMessageClass(pool.FindMessageTypeByName("embodichain.Steps"))
    made = steps(4)
    message = cls.FromString(pack(9, KINDS, made))
    rows = message.calls[1].arrays[0]
    assert not rows.single and not rows.differs
    found = np.frombuffer(message.data, rows.dtype, 4 * N * MOVED, rows.offset)
    assert found.tolist() == np.stack([step[1][0] for step in made]).ravel().tolist()


def test_the_class_of_scalars_is_that_of_their_schema():
    names = ["reward", "reward_reach"]
    files = descriptor_pb2.FileDescriptorSet.FromString(scalars_descriptor_set("Metrics", names))
    assert [field.name for field in files.file[0].message_type[0].field] == names
    message = scalars_class("Metrics", names)(reward=1.5, reward_reach=-2.0)
    assert type(message).FromString(message.SerializeToString()).reward_reach == -2.0


def with_arrays(kind, **shapes):
    return kind._replace(
        arrays=tuple(a._replace(shape=shapes.get(a.name, a.shape)) for a in kind.arrays)
    )


@pytest.mark.parametrize(
    ("number", "kind", "message"),
    [
        (0, KINDS[0]._replace(kind="look"), "unknown call 'look'"),
        (0, KINDS[0]._replace(mode="forget"), "unknown operation 'forget'"),
        (0, KINDS[0]._replace(columns=(0, 1, 2)), "other columns than values"),
        (0, with_arrays(KINDS[0], values=(6, 1)), "lacks values"),
        (1, with_arrays(KINDS[1], rows=(MOVED, N)), "no result of these environments"),
        (1, KINDS[1]._replace(nstep=2**31), "physics steps at once"),
        (2, KINDS[2]._replace(columns=(1,)), "a reset lacks whole rows"),
        (4, with_arrays(KINDS[4], **{"drawn.force": (2**31, 2**31)}), "is not in the message"),
        (4, KINDS[4]._replace(arrays=(ArrayKind("force", "<f8", (N, 3)),)), "are not draws"),
        (4, KINDS[4]._replace(arrays=(ArrayKind("drawn.x", "<c8", (N, 3)),)), "unknown type"),
        (5, KINDS[5]._replace(arrays=KINDS[5].arrays[:-1]), "lacks actions, rewards or flags"),
    ],
)
def test_what_no_log_says_is_damage(number, kind, message):
    kinds = list(KINDS)
    kinds[number] = kind
    with pytest.raises(DamageError, match=message):
        unpack(pack(5, kinds, steps(2)))


@pytest.mark.parametrize("ids", [[2, 0], [0, 0], [0, N], [-1, 1]])
def test_environments_are_ascending_and_there(ids):
    made = steps(2)
    made[1][2][0] = np.array(ids)
    with pytest.raises(DamageError, match="environments of this log"):
        unpack(pack(5, KINDS, made))


def test_damaged_messages_are_read_or_refused():
    data = pack(5, KINDS, steps(3))
    generator = np.random.default_rng(0)
    head = len(data) - len(steps(3)) * 8
    for cut in range(0, len(data), 7):
        with pytest.raises(DamageError):
            unpack(data[:cut])
    for _ in range(2000):
        changed = bytearray(data)
        changed[generator.integers(head)] = generator.integers(256)
        try:
            run = unpack(bytes(changed))
        except DamageError:
            continue
        assert run.count > 0


def calls_of_each_step(runs):
    """Kind and array bytes of the calls of each step, by its number."""
    return {
        run.first + t: [
            (call.kind, [values[t].tobytes() for values in call.arrays.values()])
            for call in run.calls
        ]
        for run in runs
        for t in range(run.count)
    }


def test_steps_with_other_calls_are_in_one_message():
    write, physics, reset, const, _, step = KINDS
    one = reset._replace(arrays=tuple(a._replace(shape=(1, *a.shape[1:])) for a in reset.arrays))
    usual, with_two = [write, physics, step], [write, physics, reset, const, write, step]
    with_one = [const, write, physics, one, step]
    patterns = [usual, with_one, usual, usual, with_two, with_one, with_two, usual]
    generator = np.random.default_rng(0)

    def made(array):
        if array.name == "env_ids":
            return np.arange(array.shape[0])
        return generator.integers(0, 2, array.shape).astype(array.dtype)

    steps = [[(kind, tuple(map(made, kind.arrays))) for kind in kinds] for kinds in patterns]
    data = b"".join(map(bytes, pack_steps(40, steps)))
    runs = unpack_steps(data, N, MOVED, NSTATE)
    assert [run.first for run in runs] == [40, 41, 42, 44, 45, 46, 47]
    assert all(run.steps == run.count for run in runs)
    assert calls_of_each_step(runs) == {
        40 + t: [(kind, [array.tobytes() for array in arrays]) for kind, arrays in calls]
        for t, calls in enumerate(steps)
    }
    (rewards,) = unpack_steps(data, N, MOVED, NSTATE, lambda kind: kind.kind == "step")
    assert (rewards.first, rewards.steps, len(rewards.calls)) == (40, 8, 1)


@pytest.mark.parametrize("listed", [[1, 0], [0, 0], [2]])
def test_steps_of_a_call_are_ascending_and_in_the_message(listed):
    message = message_class("Steps").FromString(pack(5, KINDS, steps(2)))
    message.calls[3].steps.extend(listed)
    with pytest.raises(DamageError, match="a call is in steps"):
        unpack(message.SerializeToString())
