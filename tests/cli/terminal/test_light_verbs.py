"""What never needs torch: overview, list, a refused run; and that it answers at once."""

import json
import sys
from pathlib import Path

import pytest

import embodichain
from embodichain.cli import main
from embodichain.lab.gym.envs.managers.terms.registry import KINDS

pytestmark = pytest.mark.slow

HEAVY = {"torch", "tensordict", "stable_baselines3"}


@pytest.mark.unmeasured
@pytest.mark.parametrize(
    ("arguments", "light"),
    [
        (["--help"], HEAVY | {"mujoco", "numpy", "hydra", "pydantic", "rich"}),
        (["list", "tasks"], HEAVY | {"mujoco", "pydantic", "gymnasium"}),
        (["list", "robots"], HEAVY | {"mujoco", "pydantic", "hydra", "gymnasium"}),
        (["list", "terms"], HEAVY),
        (["list", "formats"], HEAVY | {"mujoco", "numpy", "pydantic"}),
        (["list", "viewers"], HEAVY | {"mujoco", "pydantic"}),
        (["list", "learners"], HEAVY | {"mujoco"}),
        (["list", "steps"], HEAVY | {"mujoco"}),
        (["run", "task=reach", "num_envs=0"], HEAVY),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_nothing_heavy_is_imported(arguments, light, embodichain) -> None:
    done = embodichain(*arguments, env={"PYTHONPROFILEIMPORTTIME": "1"})
    assert done.returncode == (2 if "num_envs=0" in arguments else 0), done.stderr
    lines = [x for x in done.stderr.splitlines() if x.startswith("import time:")]
    imported = {line.rpartition("|")[2].strip().partition(".")[0] for line in lines}
    assert "embodichain" in imported
    assert light & imported == set()


def listed(what: str, capsys: pytest.CaptureFixture[str], *options: str) -> list[dict[str, str]]:
    assert main(["list", what, "--json", *options]) == 0
    rows: list[dict[str, str]] = json.loads(capsys.readouterr().out)[what]
    return rows


def test_tasks_are_listed_with_their_descriptions(capsys: pytest.CaptureFixture[str]) -> None:
    rows = {row["name"]: row for row in listed("tasks", capsys)}
    assert {"random_reach", "reach", "push_cube"} <= set(rows)
    assert all(row["what"].endswith(".") and row["from"] == "embodichain" for row in rows.values())
    assert main(["list", "tasks"]) == 0
    assert rows["reach"]["what"] in capsys.readouterr().out


def test_tasks_of_ones_own_are_listed_broken_ones_too(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    for folder, name, text in (
        (tmp_path / "extra", "mine", "description: Mine."),
        (tmp_path / "extra", "broken", "a: ["),
        (Path("conf"), "local", "description: Here."),
        (Path("conf"), "reach", "description: Instead."),
    ):
        (folder / "task").mkdir(parents=True, exist_ok=True)
        (folder / "task" / f"{name}.yaml").write_text(text)
    rows = listed("tasks", capsys, "--config-dir", str(tmp_path / "extra"))
    found = {row["name"]: (row["what"], row["from"]) for row in rows}
    assert found["mine"] == ("Mine.", "--config-dir")
    assert found["local"] == ("Here.", "./conf")
    assert found["reach"] == ("Instead.", "./conf")
    assert found["broken"][0] == "(malformed YAML: embodichain validate task=broken)"


def test_robots_are_listed_by_the_name_to_write(capsys: pytest.CaptureFixture[str]) -> None:
    rows = listed("robots", capsys)
    ur10 = {"name": "UniversalRobots/UR10/UR10.urdf", "format": "urdf", "from": "bundled"}
    ur10["cannot load"] = ""
    assert ur10 in rows


def test_terms_are_listed_with_their_parameters(capsys: pytest.CaptureFixture[str]) -> None:
    rows = {(row["kind"], row["name"]): row for row in listed("terms", capsys)}
    within = rows["reward", "within_distance"]
    assert within["params"] == "from, to, threshold, use_xy_only=False"
    assert within["what"]
    assert {"event", "observation", "reward", "action"} <= {kind for kind, _ in rows} <= set(KINDS)


def test_validate_says_ok(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["validate", "task=reach", "num_envs=8"]) == 0
    assert capsys.readouterr().out == "task=reach num_envs=8: ok\n"
    assert main(["validate", "reach", "--train", "algo.learning_rate=1e-4"]) == 0


def test_validate_lists_every_mistake_with_its_place(capsys: pytest.CaptureFixture[str]) -> None:
    task = Path("conf/task/wrong.yaml")
    task.parent.mkdir(parents=True)
    task.write_text("descriptio: x\nmax_episode_steps: 0.5\nrobot: {fpath: no/such.urdf}\n")
    assert main(["validate", "task=wrong", "num_env=4"]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    first, *lines = err.splitlines()
    rest = [line for line in lines if not line.startswith("    ")]
    assert first == f"{len(rest)} mistakes:"
    for words in (
        ("command line", "num_env", "Did you mean 'num_envs'?"),
        ("conf/task/wrong.yaml:1", "task.descriptio", "Did you mean 'description'?"),
        ("conf/task/wrong.yaml:2", "task.max_episode_steps"),
        ("conf/task/wrong.yaml:3", "task.robot.fpath"),
    ):
        assert any(all(word in line for word in words) for line in rest), (words, err)
    assert main(["validate", "task=wrong", "num_env=4", "--json"]) == 2
    data = json.loads(capsys.readouterr().out)
    assert data["ok"] is False
    assert len(data["mistakes"]) == len(rest)
    assert {m["source"] for m in data["mistakes"]} >= {"command line", "conf/task/wrong.yaml:1"}


def test_validate_reads_a_file(capsys: pytest.CaptureFixture[str]) -> None:
    Path("good.yaml").write_text("description: Nothing at all.\n")
    assert main(["validate", "good.yaml"]) == 0
    assert main(["validate", "missing.yaml"]) == 2
    assert "missing.yaml" in capsys.readouterr().err
    assert main(["validate", "good.yaml", "seed=1"]) == 2
    assert "either one file or overrides" in capsys.readouterr().err
    assert main(["validate"]) == 2
    assert "validate what?" in capsys.readouterr().err


@pytest.mark.parametrize("verb", ["run", "train", "show", "bench"])
def test_mistakes_stop_a_verb_before_anything_is_made(
    verb: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([verb, "task=reach", "num_env=4", "task.max_episode_stepz=3"]) == 2
    err = capsys.readouterr().err
    assert err.startswith("2 mistakes:\n")
    assert "Did you mean 'num_envs'?" in err
    assert "Did you mean 'max_episode_steps'?" in err
    assert list(Path().iterdir()) == []


def test_wrong_option_and_wrong_key_are_one_report(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "task=random_rech", "num_env=4"]) == 2
    err = capsys.readouterr().err
    assert err.startswith("2 mistakes:\n")
    assert "Did you mean 'random_reach'?" in err
    assert "Did you mean 'num_envs'?" in err
    assert list(Path().iterdir()) == []


@pytest.mark.parametrize("multirun", [(), ("-m",)], ids=["once", "sweep"])
def test_wrong_argument_of_an_algorithm_stops_training_before_anything_is_made(
    multirun: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    wrong = "algo.policy_kwargs={activatio_fn: tanh, net_arch: [0]}"
    assert main(["train", *multirun, "task=reach", wrong]) == 2
    err = capsys.readouterr().err
    assert err.startswith("2 mistakes:\n")
    assert "command line: algo.policy_kwargs.activatio_fn: unknown key" in err
    assert "algo.policy_kwargs.net_arch: layers need a width of at least 1" in err
    assert list(Path().iterdir()) == []


def test_last_of_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "task=reach", "policy=last"]) == 2
    assert "there is no finished training in outputs" in capsys.readouterr().err
    assert main(["replay", "last"]) == 2
    assert "no run in outputs has a log yet" in capsys.readouterr().err
    assert list(Path().iterdir()) == []


def test_mistake_in_any_job_of_a_sweep_stops_it(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "-m", "task=reach", "seed=0,x"]) == 2
    assert "seed" in capsys.readouterr().err
    assert list(Path().iterdir()) == []


def test_config_is_printed_without_running(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "task=reach", "num_envs=3", "--cfg", "job", "--package", "task"]) == 0
    assert "description: Bring the tool" in capsys.readouterr().out
    assert main(["run", "task=reach", "--info", "searchpath"]) == 0
    assert "embodichain.conf" in capsys.readouterr().out
    assert main(["run", "task=reac", "--cfg", "job"]) == 2
    assert "Did you mean 'reach'?" in capsys.readouterr().err
    assert list(Path().iterdir()) == []


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("embodichain ", {"run", "train", "replay", "list", "doctor"}),
        ("embodichain re", {"replay", "recover", "render", "report"}),
        ("embodichain list r", {"robots"}),
        ("embodichain run task=", {"task=reach", "task=random_reach"}),
        ("embodichain train task=reach alg", {"algo="}),
        ("embodichain show task=reach task.physics.phys", {"task.physics.physics_dt="}),
        ("embodichain run sim.num_th", {"sim.num_threads="}),
        ("embodichain replay la", {"last"}),
        ("embodichain eval la", {"last"}),
        ("embodichain eval last record=", {"record=mcap", "record=none"}),
        ("embodichain export ", {"policy"}),
        ("embodichain compare ", {"last"}),
        ("embodichain new ", {"task"}),
        ("embodichain nonsense ", set()),
    ],
)
def test_completion(
    line: str,
    words: set[str],
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    words_typed = line.split(" ")
    monkeypatch.setenv("_EMBODICHAIN_COMPLETE", "bash_complete")
    monkeypatch.setenv("COMP_WORDS", line)
    monkeypatch.setenv("COMP_CWORD", str(len(words_typed) - 1))
    assert main([]) == 0
    found = {x.partition(",")[2] for x in capsys.readouterr().out.split()}
    assert words <= found
    if line.endswith("re"):
        assert found == words


def test_completion_script_is_for_this_command(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["-sc", "install=bash"]) == 0
    script = capsys.readouterr().out
    assert "_EMBODICHAIN_COMPLETE=bash_complete" in script
    assert script.rstrip().endswith("_embodichain_completion_setup;")
    assert main(["-sc", "uninstall=bash"]) == 0
    assert capsys.readouterr().out == "complete -r embodichain\n"


def test_process_is_as_it_was_afterwards(monkeypatch: pytest.MonkeyPatch) -> None:
    # A program that calls `main` has words of its own, and gets them back.
    monkeypatch.setattr(sys, "argv", ["mine", "a"])
    assert main(["run", "task=reach", "--info", "searchpath"]) == 0
    assert sys.argv == ["mine", "a"]


def test_a_task_without_a_description_in_a_working_copy(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """There, files of the user are in the package's own folder: the folder is shown."""
    (Path("conf") / "task").mkdir(parents=True)
    (Path("conf") / "task" / "touch.yaml").write_text("{}\n")
    assert main(["list", "tasks"]) == 0
    (line,) = [x for x in capsys.readouterr().out.splitlines() if x.startswith(" touch ")]
    assert line.split() == ["touch", "-", "./conf"]
    root = Path(embodichain.__file__).resolve().parent.parent
    monkeypatch.chdir(root)
    rows = {row["name"]: row for row in listed("tasks", capsys)}
    shown = rows["reach"]["from"]
    assert shown.startswith("./") and (root / shown / "task" / "reach.yaml").is_file()
