"""`embodichain impact`: a changed friction is found, a changed comment is not."""

import json
import sys
from pathlib import Path
from typing import Any

import pytest

from embodichain.cli import main
from embodichain.config.run_folder import LOG

pytestmark = pytest.mark.slow

SHIPPED = Path(__file__).parents[3] / "conf" / "task"


@pytest.fixture(scope="module")
def golden(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log of an expert that pushes a cube, in three environments."""
    folder = tmp_path_factory.mktemp("golden") / "run"
    words = ("task=push_cube", "policy=expert", "num_envs=3", "seed=4", "episodes=2")
    assert main(["run", *words, "quiet=true", "scene_png=false", f"hydra.run.dir={folder}"]) == 0
    return folder / LOG


def impact(capsys: Any, *words: str) -> tuple[int, dict[str, Any]]:
    code = main(["impact", *words, "--json"])
    (log,) = json.loads(capsys.readouterr().out)["logs"]
    return code, log


def own_task(folder: Path, old: str, new: str) -> tuple[str, str]:
    """A folder with a changed copy of the task, as words of the command line."""
    (folder / "task").mkdir()
    text = (SHIPPED / "push_cube.yaml").read_text()
    assert old in text
    (folder / "task" / "push_cube.yaml").write_text(text.replace(old, new, 1))
    return "--config-dir", str(folder)


def test_nothing_changed(golden: Path, capsys: Any) -> None:
    code, log = impact(capsys, str(golden))
    assert code == 0
    assert (log["parted"], log["flips"], log["first_step"]) == (0, 0, None)
    assert log["episodes"] >= 6 and log["successes"] == log["successes_before"] > 0


def test_a_comment_is_no_change(golden: Path, tmp_path: Path, capsys: Any) -> None:
    words = own_task(tmp_path, "description:", "# A comment.\ndescription:")
    assert impact(capsys, str(golden), *words)[0] == 0


def test_a_friction_is_found_where_it_first_acts(golden: Path, capsys: Any) -> None:
    code, log = impact(capsys, str(golden), "task.objects.cube.attrs.dynamic_friction=0.3")
    assert code == 1
    assert log["parted"] == 3 and log["steps"] > log["first_step"] >= 0
    assert log["first_difference"] > 0 and log["component"] in ("qpos", "qvel")
    assert log["flips"] == abs(log["successes"] - log["successes_before"]) or log["flips"] > 0


def test_a_change_in_the_last_bit_is_found(golden: Path, tmp_path: Path, capsys: Any) -> None:
    code, log = impact(capsys, str(golden), "task.physics.gravity=[0,0,-9.810000000000002]")
    assert code == 1 and log["first_difference"] < 1e-10


def test_another_scene_cannot_be_compared(golden: Path, capsys: Any) -> None:
    code, log = impact(capsys, str(golden), "embodiment=panda")
    assert code == 1 and "columns of actions, " in log["reason"]


def test_a_log_that_cannot_be_played_does_not_end_the_others(
    golden: Path, tmp_path: Path, capsys: Any
) -> None:
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(golden.read_bytes()[:5000])
    assert main(["impact", str(broken), str(golden), "--json"]) == 1
    found = json.loads(capsys.readouterr().out)
    assert not found["same"]
    assert [log["parted"] for log in found["logs"]] == [0, 0]
    assert "it was not closed, or cut" in found["logs"][0]["reason"]
    assert found["logs"][1]["reason"] == ""


def test_another_interpreter_plays_the_logs(golden: Path, capsys: Any) -> None:
    code, log = impact(capsys, str(golden), "--with-python", sys.executable)
    assert code == 0 and log["parted"] == 0
    change = "task.objects.cube.attrs.dynamic_friction=0.3"
    code, log = impact(capsys, str(golden), change, "--with-python", sys.executable)
    assert code == 1 and log["parted"] == 3


def test_what_a_log_names_is_not_imported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "extra_term.py").write_text(
        "import torch\n\ndef nothing(env, obs, action, info):\n"
        "    return torch.zeros(env.num_envs)\n"
    )
    reward = "+task.rewards.more={func: 'extra_term:nothing', weight: 1}"
    words = ("task=cart_pole", reward, "max_steps=5", "quiet=true", "scene_png=false")
    assert main(["run", *words, f"hydra.run.dir={tmp_path}/log"]) == 0
    sys.modules.pop("extra_term")
    capsys.readouterr()
    assert main(["impact", f"{tmp_path}/log"]) == 2
    assert "extra_term:nothing" in capsys.readouterr().err
    assert "extra_term" not in sys.modules
    assert main(["impact", f"{tmp_path}/log", "--trust", "--quiet"]) == 0


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("task.seed=1",), "impact of what?"),
        (("no/such.mcap",), "no/such.mcap"),
        (("LOG", "task.objects.cub.mass=1"), "task.objects.cub"),
        (("LOG", "--with-python", "no/such"), "there is no interpreter no/such"),
    ],
)
def test_mistakes(golden: Path, capsys: Any, words: tuple[str, ...], sentence: str) -> None:
    assert main(["impact", *(str(golden) if word == "LOG" else word for word in words)]) == 2
    assert sentence in capsys.readouterr().err
