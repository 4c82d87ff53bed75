"""Each episode of a log has what was drawn for it, whoever resets the environments."""

import json

import numpy as np
import pytest
import torch
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

import embodichain
from embodichain import recording
from embodichain.cli import main
from embodichain.lab.gym.envs.observers import EventRecord
from embodichain.recording import McapRecorder, RecordOptions, verify
from embodichain.recording.format.draws import EpisodeDraws
from embodichain.recording.format.log_error import DamageError
from embodichain.recording.format.messages.schema import message_class
from embodichain.recording.read.episodes import decode_ends
from tests.helpers.warp_scene import RANDOMIZED
from tests.recording.runs import messages
from tests.recording.scene import SmallEnv

TASK = [
    "variation=[friction,delay,pushes]",
    "+task.events.weight={func: randomize, mode: startup, params: {of: {uid: cube}, "
    "mass: [0.5, 2.0], operation: scale}}",
    "task.max_episode_steps=5",
]


class _Seen(recording.write.recorder.StepObserver):
    """Remembers the last draws of each environment, one environment at a time."""

    def __init__(self, env):
        self.mode = env.metadata["autoreset_mode"]
        self.now = [{} for _ in range(env.num_envs)]
        self.next = [{} for _ in range(env.num_envs)]
        self.ended = {}

    def on_event(self, env, event):
        if event.mode not in ("startup", "reset", "delay"):
            return
        ids = range(env.num_envs) if event.env_ids is None else event.env_ids.tolist()
        for row, env_id in enumerate(ids):
            for name, values in event.drawn.items():
                key = f"{event.term}.{name}"
                self.next[env_id][key] = np.ravel(values[row]).astype(float).tolist()

    def begin(self):
        """What was drawn between two steps is of the running episodes."""
        self.now = [dict(drawn) for drawn in self.next]

    def on_step(self, env, step):
        for i in np.flatnonzero(step.terminated | step.truncated).tolist():
            self.ended[i, int(step.episode_ids[i])] = self.now[i]
        self.begin()


def play(path, mode="SameStep", options=None, lines=TASK):
    """A log of `push_cube`, and what was drawn for each episode that ended in it."""
    env = embodichain.make("push_cube", num_envs=3, overrides=lines, seed=3)
    env.metadata = {
        **env.metadata,
        "autoreset_mode": type(env.metadata["autoreset_mode"])(mode),
    }
    env.add_observer(McapRecorder(path, env, options=options))
    seen = _Seen(env)
    env.add_observer(seen)
    env.reset()
    startup = env.startup_draws
    seen.begin()
    for step in range(14):
        _, _, terminated, truncated, _ = env.step(torch.zeros(env.action_space.shape))
        done = terminated | truncated
        if step == 2:
            env.reset(options={"env_ids": [1]})  # within an episode
            seen.begin()
        elif mode == "Disabled" and done.any():
            env.reset(options={"reset_mask": done})
            seen.begin()
    env.close()
    for (env_id, _), drawn in seen.ended.items():
        for term, values in startup.items():
            for name, numbers in values.items():
                drawn[f"{term}.{name}"] = np.ravel(numbers[env_id]).tolist()
    return seen.ended


@pytest.mark.parametrize("mode", ["SameStep", "NextStep", "Disabled"])
def test_every_ended_episode_has_its_own_draws(tmp_path, mode):
    path = tmp_path / "log.mcap"
    ended = play(path, mode)
    with recording.open(path) as log:
        episodes = log.episodes
        modes = {event.mode for event in log.events()}
    drawn = {(e.env, e.episode): e.drawn for e in episodes if e.drawn}
    assert len(drawn) > 5 and drawn == ended
    assert len(drawn) < len(episodes)  # of those that the log cuts it is not known
    names = set(drawn[0, 0])
    assert {"place_goal.position", "friction_cube.log_friction", "weight.mass"} <= names
    assert {"actions.arm.delay", "observations.qpos.delay"} <= names
    assert not any("push" in name.partition(".")[0] for name in names)  # they are in the steps
    assert len({tuple(d["place_goal.position"]) for d in drawn.values()}) == len(drawn)
    assert len({tuple(d["weight.mass"]) for d in drawn.values()}) == 3  # one an environment
    assert "delay" not in modes
    assert verify(path).ok


def test_a_seed_makes_startup_events_draw_again(tmp_path):
    env = embodichain.make("push_cube", num_envs=2, overrides=TASK)
    env.add_observer(McapRecorder(tmp_path / "log.mcap", env))
    masses = []
    for seed in (1, 2):
        env.reset(seed=seed)
        masses.append(env.startup_draws["weight"]["mass"].tolist())
        for _ in range(5):
            env.step(torch.zeros(env.action_space.shape))
    env.close()
    with recording.open(tmp_path / "log.mcap") as log:
        of_first = [e.drawn["weight.mass"] for e in log.episodes if e.env == 0 and e.drawn]
    assert masses[0] != masses[1]
    assert of_first == [masses[0][0], masses[1][0]]


@pytest.mark.unmeasured
@pytest.mark.slow
def test_draws_on_a_device_are_those_of_the_host(tmp_path):
    lines = [
        *RANDOMIZED,
        "variation=[delay]",
        "+task.events.weight={func: randomize, mode: startup, params: {of: {uid: cart_pole}, "
        "mass: [0.5, 2.0], operation: scale}}",
    ]
    found = {}
    for arrays in ("device", "host"):
        path = tmp_path / f"{arrays}.mcap"
        with embodichain.make("cart_pole", 4, [*lines, f"sim.warp.arrays={arrays}"]) as env:
            env.add_observer(McapRecorder(path, env))
            env.reset()
            for step in range(18):
                if step == 4:
                    env.reset(options={"reset_ids": [1]})
                env.step(torch.zeros(4, 1, device=env.device))
        with recording.open(path) as log:
            found[arrays] = {(e.env, e.episode): e.drawn for e in log.episodes if e.drawn}
    assert len(found["host"]) > 6 and found["device"] == found["host"]
    names = {"weight.mass", "mass.mass", "observations.qpos.delay", "actions.force.delay"}
    assert names <= set(found["host"][0, 0])
    assert "damping.joint_damping" not in found["host"][0, 0]  # at intervals


def test_strength_gives_the_result(tmp_path):
    lines = ["variation=[friction]", "task.max_episode_steps=3"]
    default = embodichain.make("push_cube", num_envs=1).sim.scene.model
    (geom,) = np.flatnonzero(default.geom_bodyid == default.body("cube").id)
    for strength in (0, 0.5, 1):
        path = tmp_path / f"{strength}.mcap"
        play(path, lines=[*lines, f"task.variations.friction.strength={strength}"])
        with recording.open(path) as log:
            drawn = log.episodes[0].drawn
            writes = [write for write in log.writes() if write.field == "geom_friction"]
        (factor,) = np.exp(drawn["friction_cube.log_friction"])
        expected = default.geom_friction[geom, 0] * factor**strength
        assert writes[0].values[0].tolist() == pytest.approx([expected])
        if strength != 1:
            assert drawn["friction_cube.friction"] == writes[0].values[0].tolist()


@pytest.mark.parametrize("options", [RecordOptions(state="none"), RecordOptions(every=2)])
def test_episodes_without_steps_have_their_draws(tmp_path, options):
    path = tmp_path / "log.mcap"
    ended = play(path, options=options)
    with recording.open(path) as log:
        found = {(e.env, e.episode): e.drawn for e in log.episodes if e.terminated or e.truncated}
    assert found == ended


def test_a_part_that_another_recorder_begins_goes_on(tmp_path):
    env = SmallEnv()
    first = McapRecorder(tmp_path / "log.mcap", env)
    env.add_observer(first)
    env.reset()
    for _ in range(5):
        env.step()
    place = first.begin_part()
    env.observers.remove(first)
    # As after a crash: the file that the first one began is renamed by its owner.
    (tmp_path / "log_0001.mcap").unlink()
    env.add_observer(McapRecorder(tmp_path / "log.mcap", env, place=place))
    for _ in range(10):
        env.step()
    env.close()
    found = [
        e for _, data in messages(tmp_path / "log_0001.mcap", "/episode") for e in decode_ends(data)
    ]
    assert len(found) >= 3
    assert all(list(e.drawn) == ["mass.scale"] and len(e.drawn["mass.scale"]) == 1 for e in found)
    assert len({e.drawn["mass.scale"][0] for e in found}) == len(found)


def test_other_libraries_and_replay_show_them(record, capsys):
    path = record(steps=20)
    with recording.open(path) as log:
        drawn = {(e.env, e.episode): e.drawn for e in log.episodes if e.drawn}
    assert main(["replay", str(path), "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["episodes"]
    assert {(row["env"], row["episode"]): row["drawn"] for row in rows} == drawn
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for *_, message in reader.iter_decoded_messages(topics=["/episode"]):
            assert list(message.draw) == ["mass.scale"]
            expected = [
                drawn[key]["mass.scale"][0]
                for key in zip(message.env_ids, message.episode_id, strict=True)
            ]
            assert list(message.drawn) == expected


def test_a_log_without_draws_reads_as_before(record):
    path = record(steps=20)
    (_, data), *_ = messages(path, "/episode")
    message = message_class("Episodes").FromString(data)
    for name in ("draw", "draw_width", "drawn", "was_drawn"):
        message.ClearField(name)
    (episode, *_) = decode_ends(message.SerializeToString())
    assert episode.drawn == {} and episode.rewards == decode_ends(data)[0].rewards


@pytest.mark.parametrize("field", ["draw", "draw_width", "drawn", "was_drawn"])
def test_draws_that_do_not_fit_are_damage(record, field):
    (_, data), *_ = messages(record(steps=20), "/episode")
    message = message_class("Episodes").FromString(data)
    message.ClearField(field)
    with pytest.raises(DamageError, match="draws"):
        decode_ends(message.SerializeToString())


def test_a_draw_that_was_not_made_again_is_not_of_the_next_episode():
    draws = EpisodeDraws(2)
    for drawn in ({"a": np.ones((2, 3)), "b": np.zeros(2)}, {"a": np.ones((2, 2))}):
        draws.add(EventRecord("event", "reset", None, drawn))
        draws.end_reset()
    draws.add(EventRecord("event", "interval", None, {"c": np.ones(2)}))
    found = draws.of_ended(np.array([1]), were_reset=False)
    made = dict(zip(zip(found.names, found.widths, strict=True), found.was_made[0], strict=True))
    assert made == {("event.a", 3): False, ("event.b", 1): False, ("event.a", 2): True}
