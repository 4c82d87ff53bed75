import numpy as np
import pytest
from google.protobuf.internal.encoder import _VarintBytes
from hypothesis import given
from hypothesis import strategies as st

from embodichain.recording import wire


@given(st.integers(0, 2**64 - 1))
def test_varints_are_protobufs(value):
    assert wire.varint(value) == _VarintBytes(value)
    assert wire.parse(b"\x08" + wire.varint(value)) == {1: [value]}


@given(st.integers(1, 2**30), st.integers(0, 2**50), st.integers(2, 300))
def test_numbers_that_follow_each_other_are_a_table_of_varints(field, first, count):
    found = wire.uints(field, first, count)
    expected = [wire.uint(field, number) for number in range(first, first + count)]
    if len(set(map(len, expected))) > 1:
        assert found is None
    else:
        assert [row.tobytes() for row in found] == expected


def test_arrays_share_the_messages_bytes():
    data = wire.uint(1, 7) + wire.array(16, np.arange(3.0), "<f8")
    fields = wire.parse(data)
    values = wire.unpack(fields, 16, "<f8")
    assert values.tolist() == [0, 1, 2]
    assert values.base is not None
    assert wire.unpack(fields, 3, "<f8").size == 0


def test_defaults_leave_no_bytes():
    assert wire.uint(1, 0) == wire.text(2, "") == wire.array(3, np.empty(0), "<f8") == b""


@pytest.mark.parametrize(
    "data", [b"\x08", b"\x0a\x05ab", b"\x09\x00", b"\x0b\x00", b"\x08" + b"\xff" * 11]
)
def test_other_bytes_are_refused(data):
    with pytest.raises(wire.WireError):
        wire.parse(data)


def test_a_field_of_another_kind_is_refused():
    with pytest.raises(wire.WireError, match="packed array of <f8"):
        wire.unpack(wire.parse(wire.text(1, b"12345")), 1, "<f8")
    with pytest.raises(wire.WireError, match="packed array of <f8"):
        wire.unpack(wire.parse(wire.uint(1, 5)), 1, "<f8")
