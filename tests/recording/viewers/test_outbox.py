"""What waits for a slow viewer: bounded, in order, and the newest of everything."""

from embodichain.recording.viewers.outbox import Outbox


def rest(outbox):
    """All that waits."""
    found = []
    while (message := outbox.take()) is not None:
        found.append(message)
    return found


def test_messages_come_in_the_order_in_which_they_were_put():
    outbox = Outbox()
    for i in range(5):
        outbox.put(i % 2, b"%d" % i)
    assert rest(outbox) == [b"0", b"1", b"2", b"3", b"4"]
    assert outbox.take() is None and outbox.dropped == 0


def test_the_oldest_that_has_a_successor_is_dropped():
    outbox = Outbox(most=3)
    outbox.put(None, "hello")
    outbox.put("scene", b"s0")
    for i in range(4):
        outbox.put("tf", b"t%d" % i)
    assert rest(outbox) == ["hello", b"s0", b"t3"]
    assert outbox.dropped == 3


def test_bytes_are_bounded_too():
    outbox = Outbox(most_bytes=10)
    for i in range(4):
        outbox.put("tf", b"%d" % i * 4)
    assert rest(outbox) == [b"2222", b"3333"]  # 8 of 10 bytes: a third one would be 12
    outbox.put("scene", bytes(100))  # larger than all together, but the only one
    outbox.put("tf", b"4")
    assert rest(outbox) == [bytes(100), b"4"]


def test_what_nobody_wants_any_more_is_forgotten():
    outbox = Outbox(most_bytes=10)
    outbox.put(1, b"11111")
    outbox.put(2, b"22")
    outbox.forget(1)
    outbox.put(2, b"2222222")  # 9 bytes without what was forgotten
    assert rest(outbox) == [b"22", b"2222222"]
    assert outbox.dropped == 0
