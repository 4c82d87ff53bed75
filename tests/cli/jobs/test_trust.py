"""Verbs read folders, logs and robots of other people: none runs what is planted in them."""

import importlib.util
import json
import os
import shutil
import stat
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from embodichain.cli import main
from embodichain.learning.checkpoints.checkpoint import save_script
from tests.helpers.planted import NAME, Payload, pickled, plant, was_run
from tests.helpers.planted_networks import (
    Writes,
    WritesAtLoading,
    WritesInABranch,
    onnx_beside,
    script_of,
)

pytestmark = pytest.mark.slow

SMALL = ("num_envs=2", "task.max_episode_steps=6", "record=none", "scene_png=false", "--quiet")
UNNEEDED = ("action_noise", "lr_schedule", "rollout_buffer_class", "ep_info_buffer")
GHOSTSCRIPT = "#!/bin/sh\ntouch PWNED\nexit 1\n"
PICTURE = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 8 8\n%%EndComments\nshowpage\n%%EOF\n"


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a training of `reach`, and a log of its task."""
    root = tmp_path_factory.mktemp("trained")
    keys = ["num_envs=4", "total_timesteps=64", "algo.n_steps=8", "algo.batch_size=16", "seed=5"]
    keys += ["task.max_episode_steps=6", "eval.episodes=0", f"hydra.run.dir={root}/run"]
    assert main(["train", "task=reach", "--quiet", *keys]) == 0
    log = ["num_envs=2", "max_steps=8", "seed=3", "scene_png=false", "--quiet"]
    log += ["task.max_episode_steps=6", f"hydra.run.dir={root}/log"]
    assert main(["run", "task=reach", *log]) == 0
    return root


@pytest.fixture
def folder(trained: Path, tmp_path: Path) -> Path:
    """A copy of the training's folder, to plant something in."""
    return Path(shutil.copytree(trained / "run", tmp_path / "theirs"))


VERBS: dict[str, Callable[[Path, Path], list[str]]] = {
    "validate": lambda run, log: ["validate", "task=reach", f"policy={run}", *SMALL[:2]],
    "run": lambda run, log: ["run", "task=reach", f"policy={run}", "max_steps=2", *SMALL],
    "collect": lambda run, log: [
        *("collect", "task=reach", f"policy={run}", "episodes=1", "max_steps=2", "num_envs=1"),
        *("task.max_episode_steps=6", "--quiet"),
    ],
    "eval": lambda run, log: ["eval", str(run), "episodes=1", "record=none", "--quiet"],
    "eval of a file": lambda run, log: [
        *("eval", f"{run}/checkpoints/final.zip", "episodes=1", "record=none", "--quiet"),
    ],
    "render": lambda run, log: [
        *("render", "x.png", "task=reach", f"policy={run}", "task.max_episode_steps=6"),
        *("--step", "1"),
    ],
    "export": lambda run, log: [
        "export",
        "policy",
        str(run),
        "-o",
        "x.pt",
        "--format",
        "torchscript",
    ],
    "replay": lambda run, log: ["replay", str(log), "--policy", str(run), "--quiet"],
}


@pytest.mark.parametrize("verb", VERBS)
def test_a_planted_pickle_is_not_run(
    verb: str,
    folder: Path,
    trained: Path,
    capsys: pytest.CaptureFixture[str],
    caplog: pytest.LogCaptureFixture,
) -> None:
    words = VERBS[verb](folder, trained / "log/rollout.mcap")
    file = folder / "checkpoints/final.zip"
    plant(file, UNNEEDED)
    assert main(words) == 0, capsys.readouterr().err
    said = capsys.readouterr().err + caplog.text  # a process shows both
    assert not was_run()
    assert f"its action_noise would run {NAME}: it is not read" in said
    for case in ("weights alone", "refused"):
        Path("x.png").unlink(missing_ok=True)  # `render` and `export` replace no file
        Path("x.pt").unlink(missing_ok=True)
        plant(file, [*UNNEEDED, "policy_class", "policy_kwargs", "observation_space"])
        caplog.clear()
        config = yaml.safe_load((folder / "config.yaml").read_text())
        if case == "weights alone":  # as a training resumes
            assert main(words) == 0, capsys.readouterr().err
            said = capsys.readouterr().err + caplog.text
            assert "only weights were read; the rest comes from its run's config.yaml" in said
        else:
            # Whoever wrote the folder does not say whom to trust.
            changed = {**config, "trust": True, "algo": None}
            (folder / "config.yaml").write_text(yaml.safe_dump(changed))
            assert main(words) == 2
            said = capsys.readouterr().err
            assert f"its policy_class is made by {NAME}. It would run {NAME}" in said
            assert "trust=true (replay: --trust) runs it" in said
        assert not was_run()


def test_the_model_of_the_config_is_that_of_the_file_to_the_bit(folder: Path) -> None:
    import torch

    from embodichain.config import make_env, resolve
    from embodichain.learning.policies.policy import load_model

    file = folder / "checkpoints/final.zip"
    with closing(make_env(resolve(["task=reach", "num_envs=2"]))) as env:
        before = load_model(file, env).model
        plant(file, ["policy_class", "policy_kwargs", "observation_space", "action_space"])
        state = torch.get_rng_state()
        after = load_model(file, env).model
        assert torch.equal(state, torch.get_rng_state())
    assert not was_run()
    assert before.observation_space == after.observation_space
    assert before.action_space == after.action_space
    weights = after.policy.state_dict()
    assert all(torch.equal(w, weights[n]) for n, w in before.policy.state_dict().items())
    obs = before.observation_space.sample()
    actions = [model.predict(obs, deterministic=True)[0] for model in (before, after)]
    np.testing.assert_array_equal(*actions)


@pytest.mark.parametrize("verb", ["run", "eval", "export", "replay"])
def test_it_is_run_where_it_is_trusted(verb: str, folder: Path, trained: Path) -> None:
    plant(folder / "checkpoints/final.zip", ["policy_kwargs"])
    config = yaml.safe_load((folder / "config.yaml").read_text())
    (folder / "config.yaml").write_text(yaml.safe_dump({**config, "algo": None}))
    words = VERBS[verb](folder, trained / "log/rollout.mcap")
    trust = "--trust" if verb == "replay" else "trust=true"
    assert main([*words, trust]) == 2  # the payload returns no arguments
    assert was_run()


FILES: dict[str, Callable[[Path], list[str]]] = {
    **{
        verb: lambda file, verb=verb: VERBS[verb](file, Path("r.mcap"))  # type: ignore[misc]
        for verb in ("validate", "run", "collect", "render")
    },
    "eval": lambda file: ["eval", str(file), "task=reach", "episodes=1", "record=none", "--quiet"],
    "play": lambda file: ["play", str(file), "task=reach", "viewer=none", "--quiet"],
    "bench": lambda file: ["bench", "task=reach", f"policy={file}"],
    "replay": lambda file: ["replay", "LOG", "--policy", str(file), "--quiet"],
}
"""Verbs with the file of an exported policy."""


@pytest.mark.parametrize("verb", FILES)
def test_a_planted_network_is_not_run(
    verb: str, trained: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """TorchScript that writes, alone and in a zip of rsl_rl; a pickle; ONNX with another file."""
    zipped = tmp_path / "final.zip"
    save_script(script_of(Writes()), zipped, {"algo": "rsl_rl_ppo", "group": "policy"})
    planted = {
        "writes.pt": (script_of(Writes()), "does more than compute"),
        "branch.ts": (script_of(WritesInABranch()), "does more than compute"),
        "loading.pt": (script_of(WritesAtLoading()), "runs while it is loaded"),
        "final.zip": (zipped.read_bytes(), "does more than compute"),
        "pickle.pt": (pickled(Payload()), "not a TorchScript file"),
    }
    if importlib.util.find_spec("onnxruntime") and importlib.util.find_spec("onnx"):
        (tmp_path / "secret.bin").write_bytes(bytes(8))
        planted["beside.onnx"] = onnx_beside("secret.bin"), "not an ONNX file"
    for name, (content, why) in planted.items():
        file = tmp_path / name
        file.write_bytes(content)
        log = str(trained / "log/rollout.mcap")
        words = [log if word == "LOG" else word for word in FILES[verb](file)]
        assert main(words) == 2, (name, capsys.readouterr().err)
        assert why in capsys.readouterr().err
        assert not was_run(), name


def test_what_reads_no_code_takes_no_trust(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["train", "task=reach", "trust=true"]) == 2
    assert "trust: `train` does not read it" in capsys.readouterr().err
    assert main(["replay", "x.mcap", "--trust"]) == 2
    assert "--trust needs --policy" in capsys.readouterr().err


def test_a_training_resumes_from_weights_alone(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for path in (folder / "checkpoints").glob("*.zip"):
        plant(path, [*UNNEEDED, "policy_class", "policy_kwargs", "observation_space"])
    words = ["train", f"resume={folder}", "total_timesteps=96", "--quiet"]
    assert main(words) == 0, capsys.readouterr().err
    assert not was_run()


# ------------------------------------------------------------------------ configs of other people


@pytest.fixture
def module(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """A module of the working directory that leaves the trace when it is imported."""
    Path("planted_module.py").write_text(
        "from pathlib import Path\nimport torch\nPath('PWNED').touch()\n"
        "def term(env, obs, action, info):\n    return torch.zeros(env.num_envs)\n"
        "def attribute(env, env_ids, handle):\n    return 1.0\n"
    )
    monkeypatch.syspath_prepend(str(Path.cwd()))
    yield "planted_module"
    import sys

    sys.modules.pop("planted_module", None)


TERMS = {
    "term": "+task.rewards.planted={{func: '{}:term', weight: 1.0}}",
    "attribute": "+task.events.planted={{func: prepare_extra_attr, mode: startup, params: {{attrs: "
    "[{{name: a, mode: callable, entity_uids: all_robots, func_name: '{}:attribute'}}]}}}}",
}
READERS = {
    "replay": ["replay", "LOG"],
    "replay --verify": ["replay", "LOG", "--verify"],
    "report": ["report", "FOLDER"],
    "export": ["export", "LOG", "--format", "csv"],
    "diff": ["diff", "LOG", "LOG"],
    "recover": ["recover", "LOG", "fixed.mcap"],
    "view": ["view", "LOG", "--print"],
}
BUILDERS = {
    "replay --policy": ["replay", "LOG", "--policy", "zero"],
    "export --observations": ["export", "LOG", "--format", "robomimic", "--failures", "-o", "x.h5"],
    "augment": ["augment", "LOG", "episodes=1"],
}
"""These build the task of the log again."""


@pytest.mark.parametrize("kind", TERMS)
def test_no_module_that_a_log_names_is_imported(
    kind: str, module: str, capsys: pytest.CaptureFixture[str]
) -> None:
    keys = ["num_envs=1", "max_steps=3", "scene_png=false", "--quiet", "hydra.run.dir=theirs"]
    assert main(["run", "task=reach", *keys, TERMS[kind].format(module)]) == 0
    import sys

    sys.modules.pop(module)
    assert was_run()
    log = "theirs/rollout.mcap"
    for name, words in {**READERS, **BUILDERS}.items():
        line = [w.replace("LOG", log).replace("FOLDER", "theirs") for w in words]
        code = main(line)
        said = capsys.readouterr().err
        assert module not in sys.modules and not was_run(), name
        if name in BUILDERS:
            assert code == 2 and f"'{module}:{kind}' would be imported" in said, (name, said)


def test_a_class_that_is_no_policy_is_not_made(
    trained: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    policy = "policy={func: 'subprocess:Popen', params: {args: [touch, PWNED]}}"
    for verb in ("run", "validate"):
        assert main([verb, "task=reach", policy]) == 2
        assert "policy: class 'Popen' must define __call__" in capsys.readouterr().err
    assert not was_run()


@pytest.mark.parametrize("name", ["config.yaml", "overrides.yaml"])
def test_tags_of_python_in_yaml_are_refused(
    name: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / name).write_text("task: !!python/object/apply:os.system ['touch PWNED']\n")
    for words in (["eval", str(folder)], ["report", str(folder)], ["train", f"resume={folder}"]):
        main(words)
    assert not was_run()
    Path("task.yaml").write_text("id: !!python/object/apply:os.system ['touch PWNED']\n")
    assert main(["validate", "task.yaml"]) == 2
    assert main(["run", "--gym-config", "task.yaml"]) == 2
    assert not was_run()


# ------------------------------------------------------------------------------- paths and pictures


@pytest.mark.parametrize("log", ["../secret.mcap", "/etc/passwd", "a/b.mcap", "..", "", "a\\b"])
def test_a_collection_names_files_beside_its_list(
    log: str, capsys: pytest.CaptureFixture[str]
) -> None:
    line: dict[str, Any] = dict.fromkeys(("attempt", "env", "episode", "first_step", "steps"), 0)
    line |= {"log": log, "success": True, "failure": None, "total_reward": 1.0}
    Path("theirs").mkdir()
    Path("theirs/successes.jsonl").write_text(json.dumps(line) + "\n")
    assert main(["export", "theirs", "--format", "robomimic", "-o", "x.hdf5"]) == 2
    said = capsys.readouterr().err
    assert "successes.jsonl:1: log must be the name of a file beside it" in said, said


@pytest.mark.parametrize("uri", ["package://arm/../secret.stl", "package://../secret.stl"])
def test_meshes_of_a_robot_stay_in_its_package(
    uri: str, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("pkg/arm/urdf").mkdir(parents=True)
    Path("pkg/secret.stl").write_text("solid x\nendsolid x\n")
    shape = f'<visual><geometry><mesh filename="{uri}"/></geometry></visual>'
    Path("pkg/arm/urdf/arm.urdf").write_text(
        f'<robot name="a"><link name="b">{shape}</link></robot>'
    )
    robot = "task.robot.fpath=pkg/arm/urdf/arm.urdf"
    assert main(["validate", "task=reach", robot]) == 2
    assert f"{uri!r}" in capsys.readouterr().err


@pytest.mark.parametrize("kind", ["texture", "mesh"])
def test_a_picture_starts_no_program(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from PIL import EpsImagePlugin, Image

    from embodichain.lab.sim.compiler.geoms.mesh_reading import MeshError, read_mesh
    from embodichain.lab.sim.compiler.geoms.textures import check_textures

    program = tmp_path / "bin/gs"
    program.parent.mkdir()
    program.write_text(GHOSTSCRIPT)
    program.chmod(program.stat().st_mode | stat.S_IEXEC)
    monkeypatch.setenv("PATH", f"{program.parent}:{os.environ['PATH']}")
    # Pillow looks for the program once in a process, and may have done so in an earlier test.
    monkeypatch.setattr(EpsImagePlugin, "gs_binary", None)
    Path("x.png").write_bytes(PICTURE)
    if kind == "texture":
        (problem,) = check_textures(["x.png"], "textures")
        assert "no texture" in problem.message
    else:
        Path("m.mtl").write_text("newmtl a\nmap_Kd x.png\n")
        Path("m.obj").write_text(
            "mtllib m.mtl\nusemtl a\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\n"
            "f 1/1 2/2 3/3\n"
        )
        try:
            read_mesh(Path("m.obj"))
        except MeshError as error:
            assert "m.obj" in str(error)
    assert not was_run()
    assert EpsImagePlugin.gs_binary is None
    with pytest.raises(Exception, match="gs"), Image.open("x.png") as image:
        image.load()
    assert was_run()  # without the guard, the picture starts it
