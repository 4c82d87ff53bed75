"""Runs of a log by the `mcap` library alone, and logs with something changed in them."""

import math

import numpy as np
from mcap.reader import make_reader

from embodichain.recording.format.header import Header
from embodichain.recording.format.messages.block import unpack_steps
from embodichain.recording.format.messages.schema import START_TOPIC, STEPS_TOPIC, message_class
from tests.recording.rewrite import rewrite


def header_of(path):
    """The metadata of a log."""
    with path.open("rb") as stream:
        found = make_reader(stream).iter_metadata()
        return Header.from_metadata(next(m.metadata for m in found if m.name == "embodichain"))


def unpack(header, data):
    """The runs of a message of a log."""
    return unpack_steps(data, header.num_envs, header.moved_width, header.nstate)


def recorded_steps(found):
    """The calls of each step of some runs, as `pack_steps` takes them; the arrays are copies."""
    return [
        [(c.kind, tuple(v[t].copy() for v in c.arrays.values())) for c in run.calls]
        for run in found
        for t in range(run.count)
    ]


def messages(path, topic):
    """Log time and content of the messages of a topic."""
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        return [(m.log_time, m.data) for _, _, m in reader.iter_messages(topics=[topic])]


def runs(path, topic=STEPS_TOPIC):
    """The runs of a closed log."""
    header = header_of(path)
    return [run for _, data in messages(path, topic) for run in unpack(header, data)]


def starts(path):
    """Control step, rows and model fields of each start of a closed log."""
    found = []
    for run in runs(path, START_TOPIC):
        (call,) = run.calls
        fields = {name: array[0] for name, array in call.arrays.items()}
        found.append((run.first, fields.pop("row"), fields))
    return found


def calls(path, kind=None):
    """(step, kind of the call, arrays of that step) of every call, in order."""
    found = []
    for run in runs(path):
        for k in range(run.count):
            for call in run.calls:
                if kind in (None, call.kind.kind):
                    arrays = {name: values[k] for name, values in call.arrays.items()}
                    found.append((run.first + k, call.kind, arrays))
    return found


def changed(source, target, step, kind, array, change, topic=STEPS_TOPIC, name=""):
    """Write a log anew with an array of one step changed, everywhere it stands in its message.

    Args:
        source: The log.
        target: The new one.
        step: The control step.
        kind: Kind of the call.
        array: Name of the array.
        change: Called with a copy of the array, which it changes.
        topic: Where.
        name: Name of the call, if more than one is of that kind.
    """

    def message(where, data):
        if where != topic:
            return data
        steps = message_class("Steps").FromString(data)
        if not steps.first <= step < steps.first + steps.count:
            return data
        number = step - steps.first
        call = next(
            call
            for call in steps.calls
            if call.kind == kind
            and (not name or call.name == name)
            and (not call.steps or number in call.steps)
        )
        at_step = list(call.steps).index(number) if call.steps else number
        place = next(a for a in call.arrays if a.name == array)
        size = math.prod(place.shape) * np.dtype(place.dtype).itemsize
        at = len(data) - len(steps.data) + place.offset + at_step * size
        before = np.frombuffer(data, place.dtype, math.prod(place.shape), at).reshape(place.shape)
        after = before.copy()
        change(after)
        assert not place.single and not place.differs and before.tobytes() != after.tobytes()
        return data[:at] + after.tobytes() + data[at + before.nbytes :]

    return rewrite(source, target, message=message)


def flip(index, bit=0):
    """A change of one bit of one number of an array."""

    def change(array):
        words = array.view(np.uint64)
        words[index] ^= np.uint64(1 << bit)

    return change
