"""`sim.backend=ray` on three nodes, of which two are killed while it runs."""

import json
import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from embodichain import recording
from embodichain.cli import main
from embodichain.config import resolve
from embodichain.learning.training.train import train
from embodichain.utils.errors import ConfigError
from tests.helpers.ray_cluster import ray_cluster

pytestmark = [pytest.mark.unmeasured, pytest.mark.timeout(600), pytest.mark.cluster]

TRAINING = [
    *("task=cart_pole", "num_envs=6", "seed=4", "total_timesteps=576", "eval.episodes=0"),
    *("algo.n_steps=32", "algo.batch_size=96", "algo.n_epochs=2", "sim.num_threads=1"),
]
SHARDS = ["sim.backend=ray", "sim.shards=3", "sim.ray.save_every=20"]


class Nodes:
    """Nodes of a cluster, which can be killed."""

    def __init__(self, cluster: Any, nodes: list[Any]) -> None:
        self.cluster, self._nodes = cluster, nodes

    @property
    def address(self) -> str:
        return str(self.cluster.address)

    def kill(self, name: str) -> None:
        """Kill the node of a shard, with all of its processes, as a power cut does."""
        identifier = name.rpartition("/")[2]
        found = [node for node in self._nodes if node.node_id.startswith(identifier)]
        self._nodes.remove(found[0])
        raylet = found[0].all_processes["raylet"][0].process.pid
        for task in Path(f"/proc/{raylet}/task").iterdir():
            for child in (task / "children").read_text().split():
                os.kill(int(child), signal.SIGKILL)
        self.cluster.remove_node(found[0], allow_graceful=False)


@pytest.fixture(scope="module")
def nodes() -> Iterator[Nodes]:
    pytest.importorskip("ray")
    with ray_cluster(3, cpus=3) as found:
        yield Nodes(*found)


def trained(folder: Path, extra: list[str], on_step: Any = None) -> tuple[dict[str, Any], Any]:
    """Train; return the policy's parameters, and the environment."""
    folder.mkdir()
    envs: list[Any] = []

    def progress(statistics: Any) -> None:
        if on_step is not None:
            on_step(envs[0], statistics.env_steps // 6)

    train(resolve([*TRAINING, *extra], "train"), folder, progress, envs.append)
    from stable_baselines3 import PPO

    parameters = PPO.load(folder / "checkpoints/final.zip", device="cpu").policy.state_dict()
    return {name: value.numpy().tobytes() for name, value in parameters.items()}, envs[0]


def test_a_training_survives_two_of_three_nodes(nodes: Nodes, tmp_path: Path) -> None:
    """It ends with the bits of a training in one process that nothing disturbs."""

    def kill(env: Any, step: int) -> None:
        if step in (30, 71):
            nodes.kill(env.pool.nodes[1])

    expected, _ = trained(tmp_path / "one", [])
    found, env = trained(tmp_path / "three", [*SHARDS, f"sim.ray.address={nodes.address}"], kill)
    assert found == expected
    told = env.pool.rebuilt
    assert told[0]["shard"] == 1 and len({r["lost_on"] for r in told}) == 2
    assert [r["continued_from_step"] for r in told if r["shard"] == 1] == [20, 60]
    assert all(20 <= r["lost_at_step"] - r["continued_from_step"] + 20 < 40 for r in told)
    curves = [(tmp_path / name / "progress.csv").read_text() for name in ("one", "three")]
    columns = [line.split(",") for line in curves[0].splitlines()]
    timed = [i for i, name in enumerate(columns[0]) if name.startswith("time/")]
    others = [line.split(",") for line in curves[1].splitlines()]
    for mine, other in zip(columns, others, strict=True):
        assert [v for i, v in enumerate(mine) if i not in timed] == [
            v for i, v in enumerate(other) if i not in timed
        ]


def test_a_run_on_what_is_left(nodes: Nodes, capsys: pytest.CaptureFixture[str]) -> None:
    """Its summary, logs and table are those of one process."""
    run = ["run", "task=cart_pole", "num_envs=5", "episodes=2", "seed=1", "--json"]
    run += ["record.view_envs=[4]"]
    rays = ["sim.backend=ray", "sim.shards=2", f"sim.ray.address={nodes.address}"]
    found = []
    for more in ([], rays):
        assert main([*run, *more]) == 0
        found.append(json.loads(capsys.readouterr().out))
    one, two = found
    for name in one.keys() - {"folder", "log", "log_bytes", "seconds", "fps"}:
        assert one[name] == two[name], name
    assert Path(two["log"]).name == "rollout.shards.json"
    assert (Path(one["folder"]) / "scene.png").read_bytes() == (
        Path(two["folder"]) / "scene.png"
    ).read_bytes()
    with recording.open(one["log"]) as whole, recording.open(two["folder"]) as joined:
        a, b = whole.read(), joined.read()
        assert whole.header.view_envs == joined.header.view_envs == [4]
        assert np.array_equal(whole.metrics(4)[0], joined.metrics(4)[0])
    assert all(a[name].tobytes() == b[name].tobytes() for name in a)
    assert main(["replay", two["folder"], "--verify"]) == 0
    assert "of 5 environments are identical to the bit" in capsys.readouterr().out
    assert main(["export", two["folder"], "--format", "csv", "-o", "two.csv"]) == 0
    assert main(["export", one["folder"], "--format", "csv", "-o", "one.csv"]) == 0
    assert Path("two.csv").read_bytes() == Path("one.csv").read_bytes()
    assert main(["view", two["folder"]]) == 0
    assert "environment 4 is in rollout.shard1.mcap" in capsys.readouterr().err


def test_errors_in_a_shard_are_those_of_one_process(nodes: Nodes) -> None:
    import embodichain

    rays = ["sim.backend=ray", f"sim.ray.address={nodes.address}"]
    with pytest.raises(ConfigError, match=r"sim\.shards: 50 shards of 1 cores each need 50, there"):
        embodichain.make("cart_pole", 50, [*rays, "sim.shards=50"])
    env = embodichain.make("cart_pole", 3, [*rays, "sim.shards=2"], seed=1)
    try:
        env.reset()
        with pytest.raises(ValueError, match="unknown work"):
            env.advance(refuse, [(), ()])  # type: ignore[attr-defined]
        env.step(torch.zeros(3, 1))
        with pytest.raises(TypeError, match="render_mode has no form"):
            embodichain.make("cart_pole", 3, rays, render_mode="rgb_array")
    finally:
        env.close()


def refuse(env: Any) -> None:
    raise ValueError("unknown work")
