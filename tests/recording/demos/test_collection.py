"""The lists of a collection, and which attempts belong to it."""

import os
import random
from pathlib import Path

import pytest

from embodichain.recording.demos.attempts import Attempts
from embodichain.recording.demos.collection import (
    FAILURES,
    SUCCESSES,
    CollectedEpisode,
    CollectionWriter,
    is_collection,
    read_collection,
)
from embodichain.utils.errors import ConfigError


def ended(attempt: int, failure: str | None = None) -> CollectedEpisode:
    return CollectedEpisode(
        attempt, "rollout.mcap", 1, 2, 30, 4, -0.5, success=failure is None, failure=failure
    )


def test_what_is_added_is_read_in_the_order_of_attempts(tmp_path: Path) -> None:
    assert not is_collection(tmp_path)
    with CollectionWriter(tmp_path) as writer:
        writer.add([ended(3), ended(1, "step 2: dropped")])
        writer.add([ended(0)])
    assert is_collection(tmp_path)
    assert read_collection(tmp_path) == [ended(0), ended(3)]
    whole = [ended(0), ended(1, "step 2: dropped"), ended(3)]
    assert read_collection(tmp_path, failures=True) == whole


def test_one_process_at_a_time_and_again_later(tmp_path: Path) -> None:
    said = rf"another process is collecting into it \(process {os.getpid()} on "
    with CollectionWriter(tmp_path), pytest.raises(ConfigError, match=said):
        CollectionWriter(tmp_path)
    with CollectionWriter(tmp_path) as writer:
        writer.add([ended(0)])
    assert read_collection(tmp_path) == [ended(0)]


def test_half_a_line_is_not_an_episode(tmp_path: Path) -> None:
    with CollectionWriter(tmp_path) as writer:
        writer.add([ended(0)])
    with (tmp_path / SUCCESSES).open("a") as stream:
        stream.write('{"attempt": 1, "lo')
    assert read_collection(tmp_path) == [ended(0)]
    with CollectionWriter(tmp_path) as writer:
        writer.add([ended(1)])
    assert read_collection(tmp_path) == [ended(0), ended(1)]


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("nonsense", "is not an episode of a collection"),
        ("[1, 2]", "it needs the keys attempt, env"),
        ('{"attempt": 1}', "it needs the keys attempt, env"),
    ],
)
def test_a_damaged_line_is_named(tmp_path: Path, line: str, says: str) -> None:
    with CollectionWriter(tmp_path) as writer:
        writer.add([ended(0), ended(1, "dropped")])
    with (tmp_path / FAILURES).open("a") as stream:
        stream.write(line + "\n")
    assert read_collection(tmp_path) == [ended(0)]
    with pytest.raises(ConfigError, match=rf"{FAILURES}:2.*{says}"):
        read_collection(tmp_path, failures=True)


def test_a_wrong_value_is_named(tmp_path: Path) -> None:
    with CollectionWriter(tmp_path) as writer:
        writer.add([ended(0)])
    file = tmp_path / SUCCESSES
    file.write_text(file.read_text().replace('"env": 1', '"env": "one"'))
    with pytest.raises(ConfigError, match=rf"{SUCCESSES}:1: env must not be 'one'"):
        read_collection(tmp_path)


def test_another_folder_is_no_collection(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="is not a collection: it has no successes.jsonl"):
        read_collection(tmp_path)


def played(wanted: int, places: int, stop: int, order: random.Random) -> tuple[set[int], set[int]]:
    """The attempts of a collection, of which a third succeed, interrupted every `stop` ends."""
    outcome = [random.Random(n).random() < 0.3 for n in range(400)]
    kept: tuple[set[int], set[int]] = set(), set()
    while True:
        attempts = Attempts(wanted, kept[1], kept[0])
        running = [attempts.begin() for _ in range(places)]
        waiting: list[int] = []
        for _ in range(stop):
            if attempts.complete:
                return kept
            number = running.pop(order.randrange(len(running)))
            attempts.end(number, outcome[number])
            waiting.append(number)
            for one in [n for n in waiting if attempts.is_needed(n)]:
                kept[outcome[one]].add(one)
                waiting.remove(one)
            running.append(attempts.begin())


def test_a_collection_is_the_same_in_every_order_and_after_interruptions() -> None:
    alone = played(20, 1, 1000, random.Random(0))
    failed, succeeded = alone
    assert len(succeeded) == 20 and failed | succeeded == set(range(max(succeeded) + 1))
    for places, stop in ((4, 1000), (32, 1000), (32, 40), (5, 7)):
        assert played(20, places, stop, random.Random(places)) == alone
