"""The benchmark scripts run, with sizes that measure nothing."""

import json
import runpy
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

import benchmarks.__main__ as everything
from benchmarks import arms, memory
from benchmarks.__main__ import PAGE
from benchmarks.arms import Arm
from benchmarks.learners import DUMMY, LOOP, OURS, TRAIN
from benchmarks.medians import sure
from benchmarks.plain_task import PlainTask
from benchmarks.rounds import measure
from embodichain.learning import SB3VecEnv

pytestmark = [pytest.mark.unmeasured, pytest.mark.slow]

REPO = Path(__file__).parents[2]


def run_apart(module, *arguments, out):
    """In a process of its own: what starts processes itself, or measures its own."""
    command = [sys.executable, "-m", f"benchmarks.{module}", *arguments, "--out", str(out)]
    done = subprocess.run(command, cwd=REPO, capture_output=True, text=True, timeout=200)
    assert done.returncode == 0, done.stderr
    return done.stdout, json.loads(out.read_text())


@pytest.fixture
def run(monkeypatch, capsys):
    """Executes `python -m benchmarks.MODULE` in this process, where torch is imported already."""
    threads = torch.get_num_threads()

    def execute(module, *arguments, out):
        monkeypatch.setattr(sys, "argv", [module, *arguments, "--out", str(out)])
        runpy.run_module(f"benchmarks.{module}", run_name="__main__", alter_sys=True)
        return capsys.readouterr().out, json.loads(out.read_text())

    yield execute
    torch.set_num_threads(threads)


def test_step_speed(tmp_path):
    table, facts = run_apart(
        "step_speed", "--rounds=1", "--sizes", "1", "--log-sizes", "1", "--seconds=0",
        "--episode=3", out=tmp_path / "raw.json",
    )  # fmt: skip
    arms = {result["name"]: result for result in facts["results"]}
    assert {"random_reach", "random_reach + MCAP", "tutorial's class", "push_cube"} <= arms.keys()
    assert {"gymnasium AsyncVectorEnv", "SB3 SubprocVecEnv"} <= arms.keys()
    assert arms["floor, 2 threads"]["ratios"] == [1.0]
    assert all(result["speeds"][0] > 0 for result in arms.values())
    assert all(f"| {name} |" in table for name in arms)
    assert "host" not in facts["machine"]


def test_small_batches(run, tmp_path):
    table, facts = run(
        "small_batches", "--rounds=1", "--steps=4", "--sizes", "1", "2", "--large=4",
        out=tmp_path / "raw.json",
    )  # fmt: skip
    assert list(facts["sb3"]) == ["1", "2"] and facts["num_envs_large"] == 4
    assert set(facts["beyond_physics"]) == {"reach", "quadruped_velocity", "pick_place"}
    assert "speed over DummyVecEnv" in table and "reach at N=4 over the floor" in table


def test_action_cost(run, tmp_path):
    table, facts = run(
        "action_cost", "--rounds=1", "--calls=4", "--sizes", "1", "3", out=tmp_path / "raw.json"
    )
    assert list(facts["microseconds"]) == ["1", "3"]
    for found in facts["microseconds"].values():
        assert {"eef_delta_pose", "parallel_gripper", "grasped"} <= found.keys()
        assert all(len(rounds) == 1 and rounds[0] > 0 for rounds in found.values())
    assert "| eef_pose, world, rpy |" in table


def test_inverse_kinematics(run, tmp_path):
    table, facts = run("ik", "--poses=20", "--peer=5", out=tmp_path / "raw.json")
    assert [one["closed_form"] for one in facts] == [True, True, False, False, False]
    assert all(one["restarts_success"] >= 0.9 for one in facts)
    # Poses that mink reaches too: the same tool at the same place.
    assert all(one["mink_success"] > 0 and one["position_error"] < 1e-4 for one in facts)
    assert "| panda |" in table and "| ur10, closed form |" in table


def test_log_cost(run, tmp_path):
    table, facts = run(
        "log_cost", "--pairs=3", "--case", "2", "4", "--case", "3", "1", "--seconds=0",
        "--episode=3", out=tmp_path / "raw.json",
    )  # fmt: skip
    cases = [(r["num_envs"], r["physics_steps"], r["resets"]) for r in facts["results"]]
    assert cases == [(n, k, how) for n, k in ((2, 4), (3, 1)) for how in ("lockstep", "staggered")]
    for result in facts["results"]:
        assert len(result["bytes"]) == 3 and min(result["bytes"]) > 0
        for seconds in (result["seconds"], result["cpu_seconds"]):
            assert [len(seconds[name]) for name in ("plain", "logged")] == [3, 3]
            assert min(min(times) for times in seconds.values()) > 0
    assert table.count("| 2 | 4 | ") == table.count("| 3 | 1 | ") == 2


def test_how_sure_a_median_is():
    values = [float(k) for k in range(60)]
    low, high = sure(values)
    # 90 % of 60 fair coins show between 24 and 36 heads.
    assert (low, high) == (23.0, 36.0)
    assert sure([1.0, 2.0, 3.0]) == (1.0, 3.0)


def test_step_profile_accounts_for_every_part(run, tmp_path):
    _, facts = run("step_profile", "--rounds=1", "--sizes", "2", "--seconds=0", out=tmp_path / "p")
    parts = facts["microseconds"]["2"]
    # Every part of random_reach's step is called, so a part that was renamed shows as 0.
    assert parts.pop("commands") == 0  # the task has none, and a step does not ask for them
    assert all(value > 0 for name, value in parts.items() if name != "the rest of step()")


def test_the_page_is_written_from_the_figures_that_there_are(monkeypatch, tmp_path):
    page = tmp_path / "performance.md"
    page.write_text(PAGE.read_text(encoding="utf-8"), encoding="utf-8")
    # The page of the checkout stays as it is.
    monkeypatch.setattr(everything, "PAGE", page)
    monkeypatch.setattr(sys, "argv", ["benchmarks", "--page"])
    everything.main()
    text = page.read_text(encoding="utf-8")
    assert "| rewards | 1.0 |" in text
    assert text == PAGE.read_text(encoding="utf-8")  # the page that is in the repository


def test_randomization(run, tmp_path):
    table, facts = run(
        "randomization", "--rounds=1", "--sizes", "2", "--seconds=0", "--episode=4",
        out=tmp_path / "raw.json",
    )  # fmt: skip
    assert len(facts["results"]) == 4
    assert table.count("| N=2, ") == 2


def test_train(run, tmp_path):
    table, facts = run(
        "train", "--rounds=1", "--seeds=1", "--rollouts=1", "--envs=8", "--limit=64",
        out=tmp_path / "t.json",
    )  # fmt: skip
    speeds = facts["speed"]["steps_per_second"]
    assert set(speeds) == {OURS, TRAIN, DUMMY, LOOP} and all(s[0] > 0 for s in speeds.values())
    for name, parts in facts["speed"]["ms"].items():
        assert parts["update"] > 0 and ("physics" in parts) == (name != DUMMY)
    assert [found["seconds"] for found in facts["solve"]["found"][OURS]] == [None]
    assert table.count(f"| {OURS} |") == 3 and "not in 64 steps" in table


def test_the_plain_task_computes_what_the_yaml_task_does():
    env = arms.make("reach", 3)
    vec = SB3VecEnv(env)
    vec.seed(5)
    obs = vec.reset()
    engine = env.sim.engine
    row, goals = engine.rows[0].copy(), engine.state("mocap_pos").reshape(3, -1, 3).copy()
    plain = [PlainTask(engine.model, row, env.sim_steps_per_control) for _ in range(3)]
    for own, goal in zip(plain, goals, strict=True):
        own.reset(seed=0)
        own.data.mocap_pos[own.goal] = goal[own.goal]  # the same draw
    assert np.array_equal([own._observe(own._to_goal()) for own in plain], obs)
    actions = np.random.default_rng(0).uniform(-1, 1, (100, 3, 6)).astype(np.float32)
    for number, action in enumerate(actions):
        obs, rewards, dones, infos = vec.step(action)
        steps = [own.step(one) for own, one in zip(plain, action, strict=True)]
        found, paid, _, over, told = map(list, zip(*steps, strict=True))
        if number < 99:
            np.testing.assert_allclose(found, obs, atol=1e-6)
        np.testing.assert_allclose(paid, rewards, atol=1e-6)
        assert over == list(dones) == [number == 99] * 3
    assert [t["is_success"] for t in told] == [i["is_success"] for i in infos]
    final = [info["terminal_observation"] for info in infos]
    np.testing.assert_allclose(found, final, atol=1e-6)
    env.close()


def test_memory(tmp_path):
    table, facts = run_apart("memory", "--sizes", "3", out=tmp_path / "m.json")
    for found in facts["bytes"].values():
        assert found["3"]["peak"] > found["3"]["imported"] > 0
    assert table.count("| 3 |") == len(facts["bytes"])


def test_memory_of_an_environment_is_what_others_add_to_the_first_size():
    sizes = {
        "1": {"persistent": True, "running": 100 * 2**20, "peak": 110 * 2**20},
        "5": {"persistent": True, "running": 102 * 2**20, "peak": 120 * 2**20},
    }
    *_, first, second = memory.report({"bytes": {"mine": sizes}}).splitlines()
    assert first.replace(" ", "") == "|mine|1|each|100|110||"
    # 2 MiB more for 4 more of them
    assert second.replace(" ", "") == "|mine|5|each|102|120|512.0|"


@pytest.mark.slow
def test_startup(tmp_path):
    _, facts = run_apart("startup", "--rounds=1", "--cold", out=tmp_path / "s.json")
    assert len(facts["cpu_seconds"]["embodichain run, to its first step"]) == 1


def test_turns_are_whole_episodes_in_changing_order():
    calls = []

    def arm(name):
        return Arm(name, 2, "a", lambda step: calls.append(name), prepare=lambda: calls.append("-"))

    results = measure([arm("a"), arm("b")], rounds=8, seconds=0, episode=30, say=lambda line: None)
    turns = ["".join(turn) for turn in "".join(calls).split("-")[5:]]
    assert sorted(turns) == ["a" * 30] * 8 + ["b" * 30] * 8
    firsts = {turn[0] for turn in turns[::2]}
    assert firsts == {"a", "b"}
    assert results[0].ratios == [1.0] * 8
    assert results[1].ratios == pytest.approx(
        [b / a for a, b in zip(results[0].speeds, results[1].speeds, strict=True)]
    )
