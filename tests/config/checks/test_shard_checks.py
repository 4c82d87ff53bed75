"""What `sim.backend=ray` does not do is refused by name, before a cluster is needed."""

import pytest

from embodichain.config import compose, validate
from embodichain.config.environments.ray_shards import shard_config
from embodichain.config.resolved import resolve
from embodichain.lab.gym.envs.managers.term import Term
from embodichain.utils.errors import ConfigError

RAY = ["task=cart_pole", "sim.backend=ray"]


class Success(Term):
    """A curriculum that may depend on all environments."""

    def __init__(self, env: object) -> None:
        pass

    def __call__(self, env: object, env_ids: object) -> float:
        return 0.0


def problems(*lines: str, verb: str = "run") -> list[str]:
    return [f"{p.path}: {p.message}" for p in validate(compose(list(lines), verb), verb)]  # type: ignore[arg-type]


def test_what_runs_is_allowed() -> None:
    weight = "{func: modify_reward_weight, params: {term_name: alive, weight: 2.0, num_steps: 9}}"
    assert problems(*RAY, "num_envs=8", "sim.shards=4", f"+task.curriculum.a={weight}") == []
    assert problems(*RAY, "num_envs=8", "sim.shards=8", verb="train") == []
    assert problems("task=cart_pole", "num_envs=2", "sim.first_env=6") == []


@pytest.mark.parametrize(
    ("lines", "expected"),
    [
        (["sim.shards=3", "num_envs=2"], "sim.shards: 3 shards need as many environments"),
        (["viewer=web"], "viewer: sim.backend=ray has no live viewer"),
        (["record.every=2"], "record.every: sim.backend=ray records every episode"),
        (["policy=hold"], "policy: hold reads the simulation, which is in the shards"),
        (["sim.engine=warp"], "sim.backend: ray: shards run on the CPU with engine mujoco"),
        (["dataset=here"], "dataset: sim.backend=ray learns from its own steps"),
        (
            ["+task.events.a={func: reset_joints, mode: interval, is_global: true,"
             " params: {of: {uid: cart_pole}}}"],
            "task.events.a.is_global: must be false with sim.backend=ray",
        ),
        (
            ["+task.events.film={func: record_camera_data, mode: interval}"],
            "task.events.film.func: not with sim.backend=ray: it names its videos",
        ),
        (
            [f"+task.curriculum.own={{func: '{__name__}:Success'}}"],
            "may depend on all environments; a class that does not has whole_batch = ''",
        ),
    ],
)  # fmt: skip
def test_what_does_not_is_refused_by_name(lines: list[str], expected: str) -> None:
    found = problems(*RAY, *lines)
    assert any(expected in line for line in found), found


def test_keys_of_ray_are_refused_in_one_process() -> None:
    for line in ("sim.shards=2", "sim.ray.cpus=2", "sim.ray.address=auto"):
        (found,) = problems("task=cart_pole", line)
        assert f"{line.rpartition('.')[0].partition('.ray')[0]}" in found
        assert "is for sim.backend=ray; one process has threads" in found
    expected = "sim.backend: ray: a collection is one log; collect runs in one process"
    assert expected in problems(*RAY, verb="collect")


def test_a_shard_is_an_experiment_of_its_own() -> None:
    """Its config runs in one process: environments of the batch by their numbers."""
    lines = [*RAY, "num_envs=10", "sim.shards=3", "sim.first_env=20", "sim.ray.cpus=2"]
    lines += ["record.view_envs=[0,5,7]", "seed=3"]
    batch = resolve(lines)
    mine = shard_config(batch, 4, 3)
    assert (mine.root.num_envs, mine.root.sim.first_env) == (3, 24)
    assert mine.root.sim.backend == "local" and mine.root.sim.num_threads == 2
    assert mine.root.record.view_envs == [1]
    again = resolve([f"{key}={value}" for key, value in {
        "task": "cart_pole", "num_envs": 3, "sim.first_env": 24, "sim.num_threads": 2,
        "record.view_envs": "[1]", "seed": 3,
    }.items()])  # fmt: skip
    assert mine.tree == again.changed(video=False).tree
    images = "record.images={cameras: [default], envs: [1, 5], format: png}"
    shards = [shard_config(resolve([*lines, images]), *part) for part in ((0, 4), (4, 3), (7, 3))]
    drawn = [shard.root.record.images for shard in shards]
    assert [one and one.envs for one in drawn] == [[1], [1], None]
    silent = resolve([*RAY, "num_envs=4", "sim.shards=2", "record=none"])
    assert shard_config(silent, 2, 2).root.record.format == "none"
    with pytest.raises(ConfigError):
        resolve([*lines, "viewer=native"])
