"""A training's numbers in Weights & Biases, offline: into files, which are read back."""

import importlib.util
import json

import pytest

from embodichain.config import resolve
from embodichain.learning.training import train_logs
from embodichain.learning.training.train import check_training, train
from embodichain.utils.errors import ConfigError, EmbodichainError
from tests.helpers.extras import needs

pytestmark = [needs("wandb"), pytest.mark.slow]

TINY = (
    *("task=reach", "task.max_episode_steps=5", "num_envs=4", "sim.num_threads=1", "seed=1"),
    *("algo.n_steps=8", "algo.batch_size=16", "algo.n_epochs=1", "total_timesteps=64"),
)


@pytest.fixture(autouse=True)
def alone(monkeypatch, tmp_path):
    """No network, and no settings of whoever runs the tests."""
    for name in ("WANDB_API_KEY", "WANDB_MODE", "WANDB_PROJECT"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("WANDB_ERROR_REPORTING", "false")
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("WANDB_BASE_URL", "http://127.0.0.1:9")


def records(folder):
    """What the run wrote, in order."""
    import wandb
    from wandb.proto import wandb_internal_pb2
    from wandb.sdk.internal.datastore import DataStore

    wandb.teardown()  # as at the end of a process: the service has written everything
    (path,) = folder.glob("wandb/offline-run-*/run-*.wandb")
    store = DataStore()
    store.open_for_scan(str(path))
    while (data := store.scan_data()) is not None:
        record = wandb_internal_pb2.Record()
        record.ParseFromString(data)
        yield record


def test_every_row_is_in_the_run(tmp_path):
    own = ("wandb.mode=offline", "wandb.project=arms", "wandb.tags=[a, b]")
    train(resolve([*TINY, *own], "train"), tmp_path)
    found = list(records(tmp_path))
    (run,) = [r.run for r in found if r.WhichOneof("record_type") == "run"]
    assert (run.project, run.display_name, list(run.tags)) == ("arms", tmp_path.name, ["a", "b"])
    config = {item.key: json.loads(item.value_json) for item in run.config.update}
    assert config["num_envs"] == 4 and config["task"]["max_episode_steps"] == 5
    rows = []
    for record in found:
        if record.WhichOneof("record_type") == "history":
            items = record.history.item
            rows.append({i.key or "/".join(i.nested_key): json.loads(i.value_json) for i in items})
    assert [row["_step"] for row in rows] == [32, 64]
    assert rows[1]["time/total_timesteps"] == 64
    assert rows[1]["Episode_Termination/time_out"] == 1.0
    assert rows[0]["Episode_Reward/distance"] < 5 and 0 < rows[0]["time/physics_fraction"] < 1
    (end,) = [r.exit for r in found if r.WhichOneof("record_type") == "exit"]
    assert end.exit_code == 0


def test_the_environment_variable_turns_online_into_offline(tmp_path, monkeypatch):
    monkeypatch.setenv("WANDB_MODE", "offline")
    cfg = resolve([*TINY, "wandb.mode=online", "wandb.name=mine"], "train").root.wandb
    with (
        pytest.raises(RuntimeError, match="broken"),
        train_logs.wandb_writers(cfg, tmp_path, {"seed": 1}),
    ):
        raise RuntimeError("broken")
    found = list(records(tmp_path))
    assert [r.run.display_name for r in found if r.WhichOneof("record_type") == "run"] == ["mine"]
    assert [r.exit.exit_code for r in found if r.WhichOneof("record_type") == "exit"] == [1]


def test_without_a_login_online_is_one_clear_error(tmp_path):
    cfg = resolve([*TINY, "wandb.mode=online"], "train").root.wandb
    with (
        pytest.raises(EmbodichainError, match=r"Weights & Biases: .*wandb\.mode=offline"),
        train_logs.wandb_writers(cfg, tmp_path, {}),
    ):
        pass


def test_a_missing_package_is_named_before_anything_runs(monkeypatch):
    resolved = resolve([*TINY, "wandb.mode=offline"], "train")
    find = importlib.util.find_spec
    # As if the package were not installed.
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name, *a: None if name == "wandb" else find(name, *a)
    )
    with pytest.raises(ConfigError, match=r"wandb\.mode: .*pip install 'embodichain\[wandb\]'"):
        check_training(resolved)


def test_nothing_happens_unless_it_is_asked_for(tmp_path):
    with train_logs.wandb_writers(resolve([*TINY], "train").root.wandb, tmp_path, {}) as writers:
        assert writers == ()
    assert not (tmp_path / "wandb").exists()
