"""A recorded trajectory is an environment state again: `env.restore(log, ...)` goes on from it."""

from types import SimpleNamespace

import numpy as np
import pytest

import embodichain
import embodichain.recording as recording
from embodichain.lab.gym.envs.observers import StepObserver
from embodichain.recording import McapRecorder, RecordOptions
from embodichain.utils.errors import ConfigError
from tests.recording.rewrite import rewrite

LENGTH = 8
REACH = [f"task.max_episode_steps={LENGTH}"]
# `smooth` remembers the action before the last, which a log does not say of a term.
PUSH = [*REACH, "~task.rewards.smooth"]
RANDOMIZED = [
    *PUSH,
    "+task.events.mass={func: randomize_rigid_object_mass, mode: reset,"
    " params: {entity_cfg: {uid: cube}, mass_range: [0.5, 2.0]}}",
    "+task.events.strength={func: randomize_actuator_strength, mode: reset,"
    " params: {entity_cfg: {uid: robot}, strength_range: [0.8, 1.1]}}",
]
CASES = {
    "random_reach": ("random_reach", REACH, {}),
    "push_cube": ("push_cube", PUSH, {"state": "keyframes", "keyframe_every": 7}),
    "randomized": ("push_cube", RANDOMIZED, {}),
}


class Rows(StepObserver):
    """What physics received in each control step."""

    def __init__(self):
        self.rows = []

    def on_physics(self, env, event):
        if event.phase == "before" and event.env_ids is None:
            self.rows.append(event.rows.copy())


@pytest.fixture(scope="module", params=CASES)
def case(request, tmp_path_factory):
    """A log of random actions, what was true while it was recorded, and another environment."""
    task, overrides, options = CASES[request.param]
    path = tmp_path_factory.mktemp("log") / "log.mcap"
    env = embodichain.make(task, num_envs=3, overrides=["seed=5", *overrides])
    rows, strength = Rows(), []
    env.add_observer(McapRecorder(path, env, task=task, options=RecordOptions(**options)))
    env.add_observer(rows)
    env.reset()
    env.action_space.seed(1)
    actions, rewards = [], []
    home = env.action_manager.home()
    for _ in range(20):
        strength.append(env.robot.drives.strength[2].copy())
        action = home + 0.1 * (env.action_space.sample() - home)  # gently: nothing may diverge
        actions.append(action.astype(np.float32))
        rewards.append(env.step(actions[-1])[1].tolist())
    env.close()
    other = embodichain.make(task, num_envs=2, overrides=["seed=99", *overrides])
    here = Rows()
    other.add_observer(here)
    other.reset()
    log = recording.open(path)
    yield SimpleNamespace(
        **{"log": log, "env": other, "here": here, "name": request.param, "rows": rows.rows},
        **{"actions": actions, "rewards": rewards, "strength": strength},
    )
    log.close()
    other.close()


@pytest.mark.parametrize(("episode", "step"), [(0, 0), (1, 3), (0, 5), (1, 0)])
def test_recorded_actions_give_recorded_states(case, episode, step):
    compared = np.ones(case.rows[0].shape[1], np.bool_)
    if case.name == "random_reach":  # its marker jumps at random in every step
        compared[slice(*case.log.header.layout["mocap_pos"])] = False
    env = case.env
    _, info = env.restore(case.log, env=2, episode=episode, step=step)
    assert info["elapsed_steps"].tolist() == [step, step]
    assert env.episode_ids.tolist() == [episode, episode]
    first = episode * LENGTH + step
    assert np.allclose(env.robot.drives.strength, case.strength[first], rtol=1e-12)
    for t in range(first, (episode + 1) * LENGTH):
        _, reward, _, truncated, _ = env.step(np.stack([case.actions[t][2]] * 2))
        for row in case.here.rows[-1]:
            assert row[compared].tobytes() == case.rows[t][2, compared].tobytes(), t
        assert reward.tolist() == [case.rewards[t][2]] * 2
    assert truncated.all()


def test_others_stay_as_they_are(case):
    env, action = case.env, case.actions[0][:2]
    env.reset(seed=3)
    expected = [env.step(action) for _ in range(3)]
    expected_rows = [rows[0].copy() for rows in case.here.rows[-3:]]
    env.reset(seed=3)
    env.step(action)
    before = env.sim.engine.rows[0].copy()
    obs, _ = env.restore(case.log, env=1, episode=1, step=2, env_ids=[1])
    assert env.sim.engine.rows[0].tobytes() == before.tobytes()
    assert (obs["robot"]["qpos"][0] == expected[0][0]["robot"]["qpos"][0]).all()
    assert env.elapsed_steps.tolist() == [1, 2]
    for t in (1, 2):
        _, reward, *_ = env.step(action)
        assert case.here.rows[-1][0].tobytes() == expected_rows[t].tobytes()
        assert reward[0] == expected[t][1][0]


def test_what_is_not_restored_is_said(case):
    _, info = case.env.restore(case.log, env=0, episode=1, step=2)
    expected = ["random streams", "sums of rewards and metrics over the episode"]
    assert info["not_restored"] == expected


def test_a_sensor_with_a_rate_measures_anew(case):
    if case.name != "random_reach":
        pytest.skip("the same for every task")
    of = "entity_cfg: {uid: ur10, link_names: [ee_link]}, alignment: world"
    of += ", pattern: {directions: [[0, 0, -1]]}"
    sensors = f"{{now: {{sensor_type: ray, {of}}}, seldom: {{sensor_type: ray, {of}, rate: 1}}}}"
    env = embodichain.make(
        "random_reach", num_envs=2, overrides=[*REACH, f"+task.sensors={sensors}"]
    )
    env.reset()
    now, seldom = (env.get_sensor(uid).read_distance for uid in ("now", "seldom"))
    np.testing.assert_array_equal(seldom(), now())
    env.step(case.actions[0][:2])
    assert (seldom() != now()).all()
    _, info = env.restore(case.log, env=0, episode=1, step=2)
    assert "sensors.seldom: readings between measurements" in info["not_restored"]
    np.testing.assert_array_equal(seldom(), now())
    env.close()


@pytest.mark.parametrize(
    ("moment", "message"),
    [
        ({"env": 3}, "no environment 3 in the log: there are 0 to 2"),
        ({"episode": 3}, "no episode 3 of environment 0 in the log: there are 0 to 2"),
        ({"episode": 0, "step": 8}, "no step 8 in episode 0 of environment 0: there are 0 to 7"),
        ({"episode": 2, "step": 5}, "no step 5 in episode 2 of environment 0: there are 0 to 4"),
        ({"step": 21}, "no control step 21 in the log: there are 0 to 20"),
    ],
    ids=str,
)
def test_moments_that_are_not_there(case, moment, message):
    with pytest.raises(ConfigError, match=message):
        case.env.restore(case.log, **moment)


def test_the_end_of_the_log(case):
    snapshot = case.log.snapshot(0)
    assert (snapshot.episode, snapshot.elapsed, snapshot.last_action.any()) == (0, 0, False)
    snapshot = case.log.snapshot(1, step=20)
    assert (snapshot.episode, snapshot.elapsed) == (2, 4)
    assert np.array_equal(snapshot.last_action, case.actions[19][1])
    snapshot = case.log.snapshot(1, step=16)  # the second episode ended in step 15
    assert (snapshot.episode, snapshot.elapsed, snapshot.last_action.any()) == (2, 0, False)


def test_another_mujoco_gives_the_row_of_the_step(case, tmp_path):
    def older(name, values):
        return values | ({"mujoco_version": "2.3.7"} if name == "embodichain" else {})

    path = rewrite(case.log.path, tmp_path / "old.mcap", metadata=older)
    with recording.open(path) as log:
        if case.name == "push_cube":
            with pytest.raises(ConfigError, match=r"2\.3\.7"):
                log.snapshot(2, step=9)
            return
        snapshot = log.snapshot(2, step=9)
    controls = np.zeros(len(snapshot.row), np.bool_)
    controls[slice(*case.log.header.layout["ctrl"])] = True  # those of step 8
    assert snapshot.row[~controls].tobytes() == case.rows[9][2, ~controls].tobytes()
    assert snapshot.row[controls].tobytes() == case.rows[8][2, controls].tobytes()
    assert snapshot.notes == ()


def test_a_log_that_begins_within_an_episode_says_so(record):
    with recording.open(record(before=3)) as log:
        notes = log.snapshot(0, step=2).notes
    assert notes == ("the log begins within this episode: its steps before that are not counted",)


def test_another_scene_is_refused(record):
    env = embodichain.make("hold_still", num_envs=1)
    with recording.open(record()) as log, pytest.raises(ConfigError, match="from another scene"):
        env.restore(log, step=3)
    with pytest.raises(TypeError, match=r"embodichain\.recording\.open\('log\.mcap'\)"):
        env.restore("log.mcap")
    env.close()
