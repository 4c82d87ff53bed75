"""EmbodiChain's own material: configs, task classes and scene script of its release 0.2.1.

Files that it downloads are small ones that the tests write below `EMBODICHAIN_DATA_ROOT`, at the
paths that its configs name.
"""

import copy
import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import torch
import trimesh

from embodichain.cli import main
from embodichain.lab.gym.utils.gym_utils import config_to_cfg
from embodichain.lab.gym.utils.registration import REGISTERED_ENVS, build_env
from tests.helpers.upstream_tasks import CONFIGS, CartPole, PushCube

pytestmark = [pytest.mark.unmeasured, pytest.mark.slow]

SMALL = ("num_envs=2", "seed=1")
TRAIN = (
    *("total_timesteps=64", "algo.n_steps=16", "algo.batch_size=32", "algo.n_epochs=1"),
    "eval.episodes=0",
)


def config(name: str) -> dict[str, Any]:
    return json.loads((CONFIGS / f"upstream_{name}.json").read_text())


HAND = """<robot name="hand">
{links}
{fingers}
</robot>"""
LINK = """<link name="{name}"><inertial><mass value="{mass}"/>
<inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><geometry><box size="0.03 0.03 0.04"/></geometry></collision></link>"""
FINGER = """<joint name="finger{number}_joint" type="prismatic"><origin xyz="{x} 0 0.08"/>
<parent link="hand_base"/><child link="finger{number}"/><axis xyz="{axis} 0 0"/>
<limit lower="0" upper="0.04" effort="50" velocity="0.5"/></joint>"""


@pytest.fixture(autouse=True)
def downloaded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The data root, with a two-finger hand where the push-cube config looks for its own."""
    root = tmp_path / "data"
    path = root / "DH_PGI_140_80" / "DH_PGI_140_80.urdf"
    path.parent.mkdir(parents=True)
    masses = {"hand_base": 0.8, "finger1": 0.1, "finger2": 0.1}
    links = [LINK.format(name=name, mass=mass) for name, mass in masses.items()]
    fingers = [FINGER.format(number=n, x=0.04 * sign, axis=sign) for n, sign in ((1, 1), (2, -1))]
    path.write_text(HAND.format(links="\n".join(links), fingers="\n".join(fingers)))
    monkeypatch.setenv("EMBODICHAIN_DATA_ROOT", str(root))
    return root


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Path]:
    """Both configs, in a folder that is the working directory."""
    monkeypatch.chdir(tmp_path)
    names = ("cart_pole", "push_cube")
    return {n: Path(shutil.copy(CONFIGS / f"upstream_{n}.json", f"{n}.json")) for n in names}


@pytest.fixture
def unregistered(monkeypatch: pytest.MonkeyPatch) -> None:
    """No class is registered for EmbodiChain's ids."""
    for uid in ("CartPoleRL", "PushCubeRL"):
        monkeypatch.delitem(REGISTERED_ENVS, uid)


@pytest.mark.parametrize("name", ["cart_pole", "push_cube"])
def test_configs_convert_validate_run_and_train(
    name: str, files: dict[str, Path], unregistered: None, capsys: pytest.CaptureFixture[str]
) -> None:
    path = str(files[name])
    before = files[name].read_bytes()
    assert main(["convert", path, "--json"]) == 0
    converted = json.loads(capsys.readouterr().out)
    assert converted["mistakes"] == []
    assert main(["validate", path]) == 0
    assert main(["validate", "--train", path]) == 2  # how long to train is for the user to say
    capsys.readouterr()
    assert main(["run", "--gym-config", path, *SMALL, "max_steps=5", "record=none", "--json"]) == 0
    summary = json.loads(capsys.readouterr().out)
    assert (summary["control_steps"], summary["diverged"]) == (5, 0)
    assert main(["train", "--gym-config", path, *SMALL, *TRAIN, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["env_steps"] == 64
    assert files[name].read_bytes() == before


def test_the_lost_success_of_push_cube_is_said(files: dict[str, Path], unregistered: None, capsys):
    assert main(["convert", "push_cube.json"]) == 0
    assert "rewards.success_bonus: it stays 0" in capsys.readouterr().err


def test_registered_classes_are_used_and_succeed(files: dict[str, Path], capsys) -> None:
    line = ["run", "--gym-config", "push_cube.json", "num_envs=4", "max_steps=40", "seed=0"]
    near = "task.events.randomize_goal.params.position_range=[[-0.6,-0.4,0.05],[-0.6,-0.4,0.05]]"
    assert main([*line, near, "task.extensions.success_threshold=1.0", "--json"]) == 0
    out, err = capsys.readouterr()
    summary = json.loads(out)
    assert summary["success_rate"] == 1.0 and "it stays 0" not in err


def env_of(content: dict[str, Any], name: str, **values: Any) -> Any:
    cfg = config_to_cfg(copy.deepcopy(content))
    cfg.num_envs = 3
    for key, value in values.items():
        setattr(cfg, key, value)
    return build_env(name, cfg)


def test_the_cart_pole_class_reports_success() -> None:
    env = env_of(config("cart_pole"), "CartPoleRL")
    assert isinstance(env, CartPole) and env.max_episode_steps == 500  # the config's, not 50
    env.max_episode_steps = 3
    env.reset()
    hold = torch.zeros(3, 2)
    for _ in range(2):
        assert not env.step(hold)[2].any()
    upright = torch.tensor([[0.0, 0.001], [0.0, 0.3], [0.0, -2.0]])
    env.robot.set_qpos(upright, target=False)
    env.robot.set_qpos(upright)
    env.robot.set_qvel(torch.zeros(3, 2), target=False)
    _, reward, terminated, truncated, info = env.step(hold)
    assert terminated.tolist() == [True, False, False] and truncated.all()
    assert info["success"].tolist() == [True, False, False]
    angle = info["metrics"]["distance_to_goal"]
    assert angle[0] < 0.02 and angle[2] > 1.5
    assert reward[0] > reward[1] > reward[2]
    env.close()


def test_the_push_cube_class_reports_success() -> None:
    env = env_of(config("push_cube"), "PushCubeRL")
    assert isinstance(env, PushCube) and env.max_episode_steps == 100
    obs, _ = env.reset()
    assert obs["robot", "ee_pos"].shape == (3, 4, 4) and obs["object", "goal_pos"].shape == (3, 3)
    link = env.robot.get_link_pose("ee_link", to_matrix=True)
    apart = obs["robot", "ee_pos"][:, :3, 3] - link[:, :3, 3]
    assert torch.allclose(apart.norm(dim=1), torch.full((3,), 0.16), atol=1e-5)
    cube = env.sim.get_rigid_object("cube")
    pose = cube.get_local_pose()
    pose[1, :2] = env.goal_pose[1, :2, 3]
    cube.set_local_pose(pose)
    _, reward, terminated, _, info = env.step(torch.zeros(3, 8))  # the fingers are active, too
    far = torch.norm(cube.get_local_pose()[:, :2] - env.goal_pose[:, :2, 3], dim=1)
    assert info["success"][1] and terminated[1]
    bonus = info["rewards"]["success_bonus"]
    assert torch.equal(bonus, info["success"].float())
    assert reward[1] >= 10.0
    others = [0, 2]
    assert torch.allclose(info["metrics"]["distance_to_goal"][others], far[others], atol=1e-5)
    env.close()


SCENE = """
import argparse

from embodichain.data import get_data_path
from embodichain.lab.gym.utils.gym_utils import add_env_launcher_args_to_parser
from embodichain.lab.sim import SimulationManager, SimulationManagerCfg
from embodichain.lab.sim.cfg import RenderCfg, RigidBodyAttributesCfg, RigidObjectCfg
from embodichain.lab.sim.shapes import CubeCfg, MeshCfg

parser = argparse.ArgumentParser()
add_env_launcher_args_to_parser(parser)
args = parser.parse_args()
sim = SimulationManager(
    SimulationManagerCfg(
        width=1920,
        height=1080,
        headless=True,
        physics_dt=0.01,
        sim_device=args.device,
        render_cfg=RenderCfg(renderer=args.renderer),
        num_envs=args.num_envs,
        arena_space=3.0,
    )
)
stuff = RigidBodyAttributesCfg(
    mass=1.0, dynamic_friction=0.5, static_friction=0.5, restitution=0.1
)
cube = sim.add_rigid_object(
    cfg=RigidObjectCfg(
        uid="cube",
        shape=CubeCfg(size=[0.1, 0.1, 0.1]),
        body_type="dynamic",
        attrs=stuff,
        init_pos=[0, 0.0, 1.0],
    )
)
chair = sim.add_rigid_object(
    cfg=RigidObjectCfg(
        uid="chair",
        shape=MeshCfg(fpath=get_data_path("Chair/chair.glb")),
        body_type="dynamic",
        attrs=RigidBodyAttributesCfg(mass=3.0),
        body_scale=[0.5, 0.5, 0.5],
        init_pos=[0.0, 0.0, 0.6],
        init_rot=[90.0, 0.0, 0.0],
    )
)
for _ in range(200):
    sim.update(step=1)
print("cube", cube.get_local_pose()[:, 2].tolist())
print("chair", chair.get_local_pose()[:, 2].tolist())
sim.destroy()
"""


def test_the_steps_of_the_scene_script(tmp_path: Path, downloaded: Path) -> None:
    chair = downloaded / "Chair" / "chair.glb"
    chair.parent.mkdir(parents=True)
    chair.write_bytes(trimesh.creation.box((1.0, 1.0, 1.0)).export(file_type="glb"))
    (tmp_path / "create_scene.py").write_text(SCENE)
    line = [sys.executable, "create_scene.py", "--headless", "--num_envs", "2"]
    done = subprocess.run(line, cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    heights = {k: json.loads(v) for k, _, v in (x.partition(" ") for x in done.stdout.splitlines())}
    assert len(heights["cube"]) == 2
    assert heights["chair"] == pytest.approx([0.25] * 2, abs=0.01)  # a scaled box, at rest
