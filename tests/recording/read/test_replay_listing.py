import json

import pytest

import embodichain.recording as recording
from embodichain.cli import main


@pytest.mark.parametrize(
    ("options", "first", "stop", "env"),
    [
        (["--from", "10"], 10, 99, None),
        (["--to", "8"], 0, 8, None),
        (["--from", "9", "--to", "15", "--env", "1"], 9, 15, 1),
        (["--from", "40"], 40, 99, None),
    ],
)
def test_replay_lists_episodes_with_a_step_in_the_range(record, capsys, options, first, stop, env):
    path = record(steps=30)
    with recording.open(path) as log:
        expected = {
            (e.env, e.episode, e.last_step)
            for e in log.episodes
            if (e.terminated or e.truncated)
            and e.last_step >= first
            and e.first_step < stop
            and env in (None, e.env)
        }
    assert main(["replay", str(path), "--json", *options]) == 0
    listed = json.loads(capsys.readouterr().out)["episodes"]
    assert {(e["env"], e["episode"], e["last_step"]) for e in listed} == expected
    assert len(listed) == len(expected)


@pytest.mark.parametrize("first_step", ["3", "0"])
def test_a_range_is_not_for_verify(record, capsys, first_step):
    assert main(["replay", str(record()), "--verify", "--from", first_step]) == 2
    assert "--verify needs every step before" in capsys.readouterr().err
