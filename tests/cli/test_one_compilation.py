"""Every verb compiles the scene of its config once, in the step between resolving and building."""

from pathlib import Path

import pytest

from embodichain.cli.app import main
from embodichain.lab.gym.envs.scene_setup import declared_scene
from embodichain.lab.sim import scene as scene_module
from embodichain.lab.sim.compiler.robot import articulation

TASK = "task=cart_pole"
CLASS = """
import torch
from embodichain.lab.gym.envs.base_env import BaseEnv
from embodichain.lab.gym.utils.registration import register_env
from embodichain.lab.sim.cfg import RigidObjectCfg


@register_env("OneByOne-v0", override=True)
class Plain(BaseEnv):
    def get_reward(self, obs, action, info):
        return torch.ones(self.num_envs)


@register_env("WithABox-v0", override=True)
class Boxed(BaseEnv):
    def _prepare_scene(self, **kwargs):
        self.sim.add_rigid_object(RigidObjectCfg(uid="box", body_type="static"))
"""


@pytest.fixture
def counts(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> dict[str, int]:
    """Robots' files that were read, and scenes that were compiled, in an empty folder."""
    found = {"files": 0, "scenes": 0}

    def counted(name, function):
        def call(*args, **kwargs):
            found[name] += 1
            return function(*args, **kwargs)

        return call

    for module in (declared_scene, scene_module):
        # Counts calls, which nothing else tells but the time.
        monkeypatch.setattr(module, "compile_scene", counted("scenes", module.compile_scene))
    read = counted("files", articulation.read_robot)
    # Counted like the calls above.
    monkeypatch.setattr(articulation, "read_robot", read)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    return found


@pytest.mark.parametrize(
    "words",
    [
        ["run", TASK, "max_steps=3", "num_envs=2"],
        ["validate", TASK],
        ["show", TASK],
        ["validate", "--train", TASK, "total_timesteps=64"],
        # with the evaluation at its end, of another number of environments
        [
            *("train", TASK, "algo=ppo", "total_timesteps=64", "num_envs=2", "eval.episodes=1"),
            *("algo.n_steps=16", "algo.batch_size=16", "task.max_episode_steps=5"),
        ],
    ],
    ids=["run", "validate", "show", "validate --train", "train"],
)
def test_a_verb_reads_and_compiles_once(words: list[str], counts: dict[str, int]) -> None:
    assert main(words) == 0
    assert counts == {"files": 1, "scenes": 1}


@pytest.mark.parametrize(("name", "files"), [("OneByOne-v0", 1), ("WithABox-v0", 2)])
def test_a_class_is_compiled_once_too(
    name: str, files: int, counts: dict[str, int], tmp_path: Path
) -> None:
    (tmp_path / "my_classes.py").write_text(CLASS, encoding="utf-8")
    words = ["run", TASK, f"+task.id=my_classes:{name}", "max_steps=2", "record=none", "--json"]
    assert main(words) == 0
    # A class that adds entities reads the files itself; the check has read them for their names.
    assert counts == {"files": files, "scenes": 1}


def test_mistakes_that_mujoco_finds_are_in_one_report_with_others(
    counts: dict[str, int], capsys: pytest.CaptureFixture[str]
) -> None:
    tiny = "+task.objects.tiny={shape: {shape_type: Sphere, radius: 1e-6}}"  # lighter than mjMINVAL
    for verb in ("run", "validate"):
        assert main([verb, TASK, tiny, "num_envs=-1"]) == 2
        said = capsys.readouterr().err
        assert "MuJoCo cannot compile the scene" in said
        assert "num_envs" in said
        assert main([verb, TASK, tiny]) == 2
        assert "MuJoCo cannot compile the scene" in capsys.readouterr().err
    assert not Path("outputs").exists()  # nothing was started


def test_make_compiles_once(counts: dict[str, int]) -> None:
    import embodichain

    env = embodichain.make("cart_pole", 2)
    env.close()
    assert counts == {"files": 1, "scenes": 1}


def test_a_sweep_compiles_each_job_before_the_first_one_starts(counts: dict[str, int]) -> None:
    words = ["run", "-m", TASK, "seed=1,2", "max_steps=2", "record=none", "--quiet"]
    assert main(words) == 0
    assert counts == {"files": 2, "scenes": 2}  # and once more in the process of each job
