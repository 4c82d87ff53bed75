"""What `train`, `eval`, `run` and `export` refuse: one clear error, nothing overwritten."""

import hashlib
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
import yaml

from embodichain.cli import main

pytestmark = pytest.mark.slow

TINY = (
    *("task=reach", "num_envs=4", "algo.n_steps=8", "algo.batch_size=16", "seed=5"),
    *("task.max_episode_steps=6", "sim.num_threads=1", "eval.episodes=0"),
)


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """The folder of a training whose observations are normalized."""
    root = tmp_path_factory.mktemp("trained")
    lines = ("total_timesteps=64", "algo.normalize=obs", f"output_dir={root}", "--quiet")
    assert main(["train", *TINY, *lines]) == 0
    return next(path.parent for path in root.glob("*/*/config.yaml"))


@pytest.fixture
def run(trained):
    """A copy of it in the working directory, to be broken."""
    return shutil.copytree(trained, Path("run"))


def files(folder):
    paths = [path for path in Path(folder).rglob("*") if path.is_file()]
    return {path: hashlib.sha256(path.read_bytes()).hexdigest() for path in paths}


def refused(capsys, *arguments):
    before = files(".")
    assert main(list(arguments)) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.count("error: ") == 1 and "Traceback" not in err
    assert before.items() <= files(".").items()  # a new run folder may be there, with its config
    return err


def test_an_algorithm_that_cannot_act_here(capsys):
    err = refused(capsys, "train", *TINY[:1], "algo=dqn")
    assert "algo.name: dqn chooses among discrete actions, a task's are continuous" in err
    lines = ("algo=sac", "algo.target_entropy=many")
    assert "algo.target_entropy" in refused(capsys, "train", *TINY[:1], *lines)
    assert not Path("outputs").exists()


def test_checkpoints_of_another_task_or_shape(run, capsys):
    quiet = ("--quiet", "record=none")
    for arguments in (("run", f"policy={run}"), ("eval", str(run)), ("export", "policy", str(run))):
        extra = quiet if arguments[0] != "export" else ()
        err = refused(capsys, *arguments, "task=cart_pole", *extra)
        assert "has observations (21,), this task has (4,); has actions (6,)" in err
    err = refused(capsys, "train", f"resume={run}", "task=cart_pole")
    assert "task: a resumed training keeps its config" in err
    # The folder's config says another network than its checkpoint has.
    config = run / "config.yaml"
    tree = yaml.safe_load(config.read_text())
    tree["algo"]["policy_kwargs"]["net_arch"] = [8]
    config.write_text(yaml.safe_dump(tree))
    again = ("total_timesteps=128", "allow_changed=true", "--quiet")
    err = refused(capsys, "train", f"resume={run}", *again)  # YAML was dumped in another order
    assert "final.zip does not fit the network of the run's config: " in err


def test_missing_statistics(run, capsys):
    (run / "checkpoints/final.normalize.npz").unlink()
    for arguments in (("run", *TINY[:1], f"policy={run}"), ("eval", str(run))):
        err = refused(capsys, *arguments, "record=none", "--quiet")
        assert "final.normalize.npz is missing: this policy needs the statistics" in err
    err = refused(capsys, "export", "policy", str(run))
    assert "final.normalize.npz is missing" in err
    err = refused(capsys, "train", f"resume={run}", "total_timesteps=128", "--quiet")
    assert "final.normalize.npz is missing" in err


@pytest.mark.parametrize("kind", ["text", "zip", "cut"])
def test_what_is_no_policy(run, capsys, kind):
    final, other = run / "checkpoints/final.zip", Path("other.zip")
    if kind == "text":
        other.write_text("hello")
    elif kind == "zip":
        with zipfile.ZipFile(other, "w") as archive:
            archive.writestr("a.txt", "hello")
    else:
        other.write_bytes(final.read_bytes()[:50_000])
    for arguments in (
        ("run", "policy=other.zip", "record=none", "--quiet"),
        ("eval", "other.zip", "record=none", "--quiet"),
        ("export", "policy", "other.zip"),
    ):
        err = refused(capsys, *arguments, *TINY[:1])
        assert "other.zip is not a policy of Stable-Baselines3: " in err
    assert "is not a training's folder" in refused(capsys, "train", "resume=other.zip")
    other.replace(final)
    Path("run/checkpoints/step_000000000032.zip").unlink()
    err = refused(capsys, "train", f"resume={run}", "total_timesteps=128")
    assert "final.zip is not a policy of Stable-Baselines3: " in err


def command(*arguments, limit=None):
    def fill():  # in the child: writing larger files fails, as with a full disk
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

    return subprocess.run(
        [sys.executable, "-m", "embodichain", *arguments],
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
        preexec_fn=fill if limit is not None else None,
        # What is covered could not be written either, and would say so.
        env={k: v for k, v in os.environ.items() if not k.startswith("COVERAGE")},
    )


def test_a_full_disk_while_training(run, capsys):
    before = files(run)
    lines = ("train", f"resume={run}", "total_timesteps=128", "output_dir=outputs", "--quiet")
    # Networks need 170 kB, the state beside them less.
    done = command(*lines, limit=100_000)
    assert done.returncode == 1 and "Traceback" not in done.stderr
    folder = next(path.parent for path in Path("outputs").rglob("config.yaml"))
    wanted = f"{folder} could not be written: File too large; it has no checkpoint to continue from"
    assert wanted in done.stderr and done.stderr.count("error: ") == 1
    assert not list(folder.rglob("*.zip")) and not list(folder.rglob(".*"))
    assert files(run) == before
    assert main(list(lines)) == 0  # with room again


def test_a_full_disk_after_a_checkpoint_says_how_to_go_on(tmp_path, monkeypatch, capsys):
    from embodichain.learning.training import session

    real = session.save_checkpoint

    def full(model, path, note):
        if path.name == "final.zip":
            raise OSError(28, "No space left on device")
        real(model, path, note)

    # A disk that is full at one file; test_faults.py has real ones for all other calls.
    monkeypatch.setattr(session, "save_checkpoint", full)
    assert main(["train", *TINY, "total_timesteps=64", "--quiet"]) == 1
    err = capsys.readouterr().err
    folder = Path("outputs/latest").resolve()
    assert "could not be written: No space left on device; with room again, `embodichain" in err
    assert "continues from its step_000000000032.zip" in err
    # The disk has room again.
    monkeypatch.setattr(session, "save_checkpoint", real)
    assert main(["train", f"resume={folder}", "--quiet"]) == 0
    summary = json.loads(Path("outputs/latest/summary.json").read_text())
    assert summary["env_steps"] == 64
