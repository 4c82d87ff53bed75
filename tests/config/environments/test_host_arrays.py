"""`sim.warp.arrays`: chosen before a job, and what needs arrays of the host."""

import json
import logging

import pytest
import yaml

import embodichain
from embodichain.cli import main
from embodichain.config.environments.factory import with_warp_values
from embodichain.config.environments.host_arrays import why_host, why_not_device, with_arrays
from embodichain.config.rerun import resolve_run
from embodichain.config.resolved import dump_yaml, resolve
from embodichain.utils.errors import ConfigError

pytestmark = [pytest.mark.unmeasured, pytest.mark.slow]

WARP = ("sim.engine=warp", "sim.warp.nconmax=16", "sim.warp.njmax=16", "seed=1")
ALONE = ("record=none", "viewer=none")


def resolved(*lines, task="cart_pole", verb="run"):
    return resolve([f"task={task}", *WARP, *lines], verb)


def chosen(*lines, verb="run", **kwargs):
    """The chosen place, and the notes about it."""
    found = with_warp_values(resolved(*lines, verb=verb), verb, **kwargs)
    return found.tree["sim"]["warp"]["arrays"], [note.message for note in found.notes]


def test_a_task_that_runs_on_device_arrays_gets_them():
    assert chosen() == ("device", [])  # with a log, too
    assert chosen(verb="train") == ("device", [])


READS_HOST = """
import numpy as np

class Reads:
    def __init__(self, env):
        self.env = env

    def __call__(self, env, obs, action, info):
        return np.asarray(env.sim.engine.state("qpos"))[:, 0]
"""


def test_a_term_that_reads_the_host_is_named(tmp_path, monkeypatch):
    folder = tmp_path / "envs" / "mdp"
    folder.mkdir(parents=True)
    (folder / "reads_host.py").write_text(READS_HOST)
    monkeypatch.syspath_prepend(folder)
    term = '+task.rewards.mine={func: "reads_host:Reads", weight: 1.0}'
    place, notes = chosen(*ALONE, term)
    assert place == "host" and len(notes) == 1
    assert notes[0].startswith("host, because Reads.__call__ in reads_host.py: an array of the dev")
    assert f"{folder}/reads_host.py:9: " in notes[0]
    with pytest.raises(ConfigError, match=r"sim\.warp\.arrays: device: Reads\.__call__ in reads_"):
        chosen(*ALONE, term, "sim.warp.arrays=device")


NEEDS = {
    "images": (
        {"record": {"images": {"cameras": ["default"]}}},
        "record.images: pictures are drawn on the host",
    ),
    "viewer": (
        {"record": {"format": "none"}, "viewer": {"name": "web"}},
        "viewer=web shows arrays of the host",
    ),
    "policy": (
        {"record": {"format": "none"}, "policy": "teleop"},
        "policy=teleop plans with arrays of the host",
    ),
}


@pytest.mark.parametrize("what", NEEDS)
def test_what_needs_the_host_is_said_before_the_run(what):
    values, reason = NEEDS[what]
    found = resolved().changed(**values)
    assert why_not_device(found.root, "run") == [reason]
    host = with_warp_values(found, "run")
    assert host.tree["sim"]["warp"]["arrays"] == "host"
    assert [note.message for note in host.notes] == [f"host, because {reason}"]
    with pytest.raises(ConfigError) as refused:
        with_warp_values(with_arrays(found, "device"), "run")
    problems = [(problem.path, problem.message) for problem in refused.value.problems]
    assert problems == [("sim.warp.arrays", f"device: {reason}")]


def test_jobs_need_what_their_verb_uses():
    logged = resolved().root
    assert why_not_device(logged, "collect") == ["collect chooses episodes by arrays of the host"]
    assert all(why_not_device(logged, verb) == [] for verb in ("run", "train", None))
    pictures = {"images": {"cameras": ["default"]}}
    for record in (pictures, {"format": "none", **pictures}):
        filmed = resolved().changed(record=record).root
        assert bool(why_not_device(filmed, "run")) == ("format" not in record)
        assert why_not_device(filmed, "train") == []
    own = resolved(*ALONE).changed(policy="my_policies:act").root
    assert why_not_device(own, "run") == why_host(own, "train") == []
    assert why_host(own, "run") == ["policy=my_policies:act may read arrays of the host"]
    learned = resolved().changed(policy="outputs/latest/checkpoints/final.zip").root
    assert why_host(learned, "run") == []
    seen = resolved("task.sensors.side.observe=true", task="reach_vision").root
    assert why_not_device(seen, "train") == []


def test_the_host_can_be_asked_for_and_others_have_no_choice():
    assert chosen(*ALONE, "sim.warp.arrays=host") == ("host", [])
    plain = resolve(["task=cart_pole", "sim.warp.arrays=host"])
    assert with_warp_values(plain, "run") is plain and with_arrays(plain, "device") is plain
    with pytest.raises(ConfigError, match=r"sim\.warp\.arrays: is for sim\.engine=warp"):
        resolve(["task=cart_pole", "sim.warp.arrays=device"])
    with pytest.raises(ConfigError, match=r"sim\.warp\.arrays"):
        resolved("sim.warp.arrays=gpu")


def test_an_earlier_run_is_chosen_for_anew(tmp_path):
    """Evaluating or playing a policy needs other arrays than its training did."""
    made = with_arrays(resolved(), "device")
    (tmp_path / "config.yaml").write_text(dump_yaml(made.tree))
    assert resolve_run(tmp_path).tree["sim"]["warp"]["arrays"] == "auto"
    again = resolve_run(tmp_path, ["sim.warp.arrays=host"]).tree["sim"]["warp"]
    assert dict(again) == {"nconmax": 16, "njmax": 16, "arrays": "host"}
    older = yaml.safe_load(dump_yaml(made.tree))
    del older["sim"]["warp"]
    (tmp_path / "config.yaml").write_text(yaml.safe_dump(older))
    assert with_arrays(resolve_run(tmp_path), "host").root.sim.warp.arrays == "host"


def test_make_chooses_too(caplog):
    with embodichain.make("cart_pole", 2, WARP) as env:
        assert env.arrays.on_device
    caplog.set_level(logging.INFO)
    with embodichain.make("cart_pole", 2, WARP, autoreset_mode="NEXT_STEP") as env:
        assert not env.arrays.on_device
    assert "sim.warp.arrays: host, because" in caplog.text
    assert "steps of some environments, as of autoreset mode NEXT_STEP" in caplog.text


def test_gymnasiums_arrays_are_on_the_host():
    gym = pytest.importorskip("gymnasium")
    for env in (
        gym.make("embodichain/cart_pole-v0", overrides=WARP),
        gym.make_vec("embodichain/cart_pole-v0", num_envs=2, overrides=WARP),
    ):
        env.reset(seed=1)
        env.step(env.action_space.sample())
        env.close()


def test_validate_says_the_same(capsys):
    lines = ("task=cart_pole", *WARP, "viewer=web")
    assert main(["validate", *lines, "--json"]) == 0
    notes = json.loads(capsys.readouterr().out)["notes"]
    reason = "viewer=web shows arrays of the host"
    assert [(n["path"], n["message"]) for n in notes] == [
        ("sim.warp.arrays", f"host, because {reason}")
    ]
    assert main(["validate", *lines, "sim.warp.arrays=device", "--json"]) == 2
    (mistake,) = json.loads(capsys.readouterr().out)["mistakes"]
    assert (mistake["path"], mistake["message"]) == ("sim.warp.arrays", f"device: {reason}")
    assert main(["validate", *lines[:-1], "sim.warp.arrays=device", "--json"]) == 0
    assert "notes" not in json.loads(capsys.readouterr().out)


FAILS = """
def fails(env, obs, action, info):
    if env.arrays.on_device:
        raise RuntimeError("tensors of different devices")
    return env.elapsed_steps * 1.0
"""


def test_any_failure_of_the_trial_is_a_reason(tmp_path, monkeypatch):
    (tmp_path / "failing_reward.py").write_text(FAILS)
    monkeypatch.syspath_prepend(tmp_path)
    term = '+task.rewards.mine={func: "failing_reward:fails", weight: 1.0}'
    assert chosen(*ALONE, term) == ("host", ["host, because tensors of different devices"])
    with pytest.raises(RuntimeError, match="tensors of different devices"):
        chosen(*ALONE, term, "sim.warp.arrays=device")
