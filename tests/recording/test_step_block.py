import numpy as np
import pytest
from mcap.reader import make_reader

from embodichain.recording.messages import StepOutcome
from embodichain.recording.schemas import message_class
from embodichain.recording.step_block import decode_steps
from embodichain.recording.wire import WireError


@pytest.fixture
def payloads(record):
    with record(steps=300).open("rb") as stream:
        found = make_reader(stream).iter_messages(topics=["/sim/step"])
        return [memoryview(message.data) for *_, message in found]


def same(decoded, payloads):
    for name, values in decoded.items():
        expected = np.stack([getattr(StepOutcome.decode(p), name) for p in payloads])
        assert values.dtype == expected.dtype
        assert np.array_equal(values, expected), name


def test_many_are_what_each_is(payloads):
    assert len(payloads) == 300
    same(decode_steps(payloads), payloads)


def test_one_of_another_layout_is_still_read(payloads):
    step = message_class("Step").FromString(bytes(payloads[7]))
    odd = step.SerializeToString(deterministic=True)
    fields = message_class("Step")(step=9)  # fields in another order: the last one wins
    payloads[7] = memoryview(fields.SerializeToString() + odd)
    same(decode_steps(payloads), payloads)


def test_other_shapes_and_no_steps_are_errors(payloads):
    step = message_class("Step").FromString(bytes(payloads[3]))
    del step.reward[-1]
    with pytest.raises(WireError, match="environments"):
        decode_steps([*payloads[:3], memoryview(step.SerializeToString())])
    with pytest.raises(WireError):
        decode_steps([memoryview(b"\xff\xff")])
