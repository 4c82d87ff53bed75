import numpy as np
import pytest
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms

from embodichain.recording.foxglove.messages import timestamp
from embodichain.recording.foxglove.template import STAMP, Template, mark, stamps


def message(values, stamp):
    """Two frames; the second has a fixed rotation."""
    found = FrameTransforms()
    for name, (x, y) in zip("ab", values, strict=True):
        frame = found.transforms.add(child_frame_id=name)
        frame.timestamp.CopyFrom(stamp)
        frame.translation.x, frame.rotation.w = x, y
    found.transforms[1].translation.z = 0.25
    return found


def test_filled_templates_are_the_messages_with_their_numbers_and_times():
    template = Template(
        message([(mark(0), mark(1)), (mark(2), mark(3))], STAMP).SerializeToString(), 4
    )
    times = [0, 5, 999_999_999, 1_795_000_000_123_456_789, 2**63 - 1]
    values = np.outer([1.0, -1.0, 0.5, 2.0, 3.0], [0.0, -1.5, np.pi, 1e300])
    for one, numbers, time_ns in zip(
        template.table(values, stamps(times)), values, times, strict=True
    ):
        filled = FrameTransforms.FromString(one.tobytes())
        assert filled == message(numbers.reshape(2, 2).tolist(), timestamp(time_ns))


def test_a_missing_mark_is_refused():
    with pytest.raises(ValueError, match="not found"):
        Template(message([(mark(0), mark(1)), (0, 0)], STAMP).SerializeToString(), 3)


def test_values_may_come_in_another_order():
    data = message([(mark(0), mark(1)), (mark(2), mark(3))], STAMP).SerializeToString()
    template = Template(data, 4, order=np.array([3, 0, 2, 1]))
    values = np.arange(12.0).reshape(3, 4)
    filled = template.table(values, stamps([7] * 3))
    for one, (d, a, c, b) in zip(filled, values.tolist(), strict=True):
        assert FrameTransforms.FromString(one.tobytes()) == message([(a, b), (c, d)], timestamp(7))
