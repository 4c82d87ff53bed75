import numpy as np
import pytest
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms

from embodichain.recording.foxglove.messages import timestamp
from embodichain.recording.foxglove.template import STAMP, Template, mark


def message(values, stamp):
    """Two frames; the second has a fixed rotation."""
    found = FrameTransforms()
    for name, (x, y) in zip("ab", values, strict=True):
        frame = found.transforms.add(child_frame_id=name)
        frame.timestamp.CopyFrom(stamp)
        frame.translation.x, frame.rotation.w = x, y
    found.transforms[1].translation.z = 0.25
    return found


@pytest.mark.parametrize("time_ns", [0, 5, 999_999_999, 1_795_000_000_123_456_789])
def test_a_filled_template_is_the_message_with_its_numbers(time_ns):
    template = Template(
        message([(mark(0), mark(1)), (mark(2), mark(3))], STAMP).SerializeToString(), 4
    )
    values = np.array([[0.0, -1.5], [np.pi, 1e300]])
    filled = FrameTransforms.FromString(template.fill(values, time_ns))
    assert filled == message(values.tolist(), timestamp(time_ns))
    again = FrameTransforms.FromString(template.fill(-values, time_ns))  # nothing is left over
    assert again == message((-values).tolist(), timestamp(time_ns))


def test_a_missing_mark_is_refused():
    with pytest.raises(ValueError, match="not found"):
        Template(message([(mark(0), mark(1)), (0, 0)], STAMP).SerializeToString(), 3)


def test_messages_are_filled_together_with_values_in_another_order():
    data = message([(mark(0), mark(1)), (mark(2), mark(3))], STAMP).SerializeToString()
    template = Template(data, 4, copies=3, order=np.array([3, 0, 2, 1]))
    values = np.arange(12.0).reshape(3, 4)
    filled = template.fill_all(values, 7)
    assert len(filled) == 3
    for one, (d, a, c, b) in zip(filled, values.tolist(), strict=True):
        assert FrameTransforms.FromString(one) == message([(a, b), (c, d)], timestamp(7))
