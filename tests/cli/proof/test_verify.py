"""`embodichain verify`: receipts of evaluations, collections, studies; what was tampered with."""

import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from embodichain.cli import main

pytestmark = pytest.mark.slow

TRAIN = (
    *("train", "task=cart_pole", "num_envs=4", "total_timesteps=256", "algo.n_steps=8"),
    *("algo.batch_size=16", "eval.episodes=0", "seed=1", "quiet=true"),
)
Tamper = Callable[[Path], None]


@pytest.fixture(scope="module")
def evaluated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A training and its evaluation, with a receipt."""
    root = tmp_path_factory.mktemp("evaluated")
    assert main([*TRAIN, f"hydra.run.dir={root}/train"]) == 0
    words = ("episodes=6", "num_envs=3", "seed=2", "quiet=true", f"output_dir={root}/outputs")
    assert main(["eval", f"{root}/train", *words]) == 0
    return root


@pytest.fixture
def folder(evaluated: Path, tmp_path: Path) -> Path:
    """A copy of the evaluation, beside a copy of its training."""
    copy = tmp_path / "copy"
    shutil.copytree(evaluated, copy, symlinks=True)
    (run,) = (path.parent for path in copy.glob("outputs/2*/*/receipt.json"))
    return run


def verify(folder: Path, capsys: Any, *words: str) -> tuple[int, dict[str, Any]]:
    code = main(["verify", str(folder), "--json", *words])
    return code, json.loads(capsys.readouterr().out)


def test_an_untouched_receipt_is_verified(folder: Path, capsys: Any) -> None:
    code, report = verify(folder, capsys)
    assert code == 0 and report["ok"]
    found = {finding["what"]: finding for finding in report["findings"]}
    assert set(found) == {"receipt", "files", "results", "physics", "actions", "successes"}
    assert all(finding["ok"] for finding in found.values())
    assert "identical to the bit" in found["physics"]["text"]
    assert "equal to the bit" in found["actions"]["text"]
    assert report["notes"] == []


def change_number(folder: Path) -> None:
    """Claim another mean return, and seal the receipt anew: the episodes say otherwise."""
    for name in ("eval.json", "receipt.json"):
        path = folder / name
        content = json.loads(path.read_text())
        results = content.get("results", content)
        results["returns"]["mean"] += 1
        path.write_text(json.dumps(content))
    seal(folder, "eval.json")


def swap_episodes(folder: Path) -> None:
    """Give two episodes each other's results: their means stay."""
    path = folder / "eval.json"
    content = json.loads(path.read_text())
    content["per_episode"]["return"].reverse()
    path.write_text(json.dumps(content))
    seal(folder, "eval.json")


def widen_interval(folder: Path) -> None:
    for name in ("eval.json", "receipt.json"):
        path = folder / name
        content = json.loads(path.read_text())
        content.get("results", content)["length"]["mean_interval"][0] -= 1
        path.write_text(json.dumps(content))
    seal(folder, "eval.json")


def seal(folder: Path, *names: str) -> None:
    """Make the receipt of a folder fit its files again, as somebody who cheats would do."""
    from embodichain.cli.jobs.code_digest import file_digest
    from embodichain.cli.jobs.receipt import _seal_of

    content = json.loads((folder / "receipt.json").read_text())
    for name in names:
        content["files"][name] = file_digest(folder / name)
    content["seal"] = _seal_of(content)
    (folder / "receipt.json").write_text(json.dumps(content))


def change_receipt(folder: Path) -> None:
    path = folder / "receipt.json"
    path.write_text(path.read_text().replace('"seed": 2', '"seed": 3'))


def change_log(folder: Path) -> None:
    path = folder / "rollout.mcap"
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)


def change_checkpoint(folder: Path) -> None:
    path = folder.parents[2] / "train/checkpoints/final.zip"
    path.write_bytes(path.read_bytes() + b"\0")


def remove_config(folder: Path) -> None:
    (folder / "config.yaml").unlink()


@pytest.mark.parametrize(
    ("tamper", "what", "text"),
    [
        (change_number, "results", "returns do not follow from the 6 episodes"),
        (swap_episodes, "results", "return of the episodes in eval.json differs from that in the"),
        (widen_interval, "results", "length do not follow"),
        (change_receipt, "receipt", "it was changed"),
        (change_log, "files", "rollout.mcap was changed"),
        (change_checkpoint, "actions", "is not the policy of the receipt"),
        (remove_config, "files", "config.yaml is missing"),
    ],
)
def test_what_was_tampered_with_is_found(
    folder: Path, capsys: Any, tamper: Tamper, what: str, text: str
) -> None:
    if what == "actions":  # the receipt names the policy where it was made
        receipt = json.loads((folder / "receipt.json").read_text())
        policy = folder.parents[2] / "train/checkpoints/final.zip"
        tamper(folder)
        code, report = verify(folder, capsys, "--policy", str(policy))
        assert receipt["policy_file"]["sha256"]
    else:
        tamper(folder)
        code, report = verify(folder, capsys)
    assert code == 1 and not report["ok"]
    wrong = {f["what"]: f["text"] for f in report["findings"] if f["ok"] is False}
    assert text in wrong[what]


def test_another_policy_plays_other_actions(folder: Path, tmp_path: Path, capsys: Any) -> None:
    """A receipt that claims a policy which did not play."""
    from embodichain.cli.jobs.code_digest import file_digest
    from embodichain.cli.jobs.receipt import _seal_of

    assert main([*TRAIN[:-2], "seed=9", "quiet=true", f"hydra.run.dir={tmp_path}/other"]) == 0
    other = tmp_path / "other/checkpoints/final.zip"
    path = folder / "receipt.json"
    content = json.loads(path.read_text())
    content["policy_file"] = {"path": str(other), "sha256": file_digest(other)}
    content["seal"] = _seal_of(content)
    path.write_text(json.dumps(content))
    code, report = verify(folder, capsys)
    found = {finding["what"]: finding for finding in report["findings"]}
    assert code == 1 and found["physics"]["ok"] and found["actions"]["ok"] is False
    assert "differ from control step 0 on" in found["actions"]["text"]


def test_a_file_without_its_results_is_one_report(folder: Path, capsys: Any) -> None:
    (folder / "eval.json").write_text("{}")
    seal(folder, "eval.json")
    assert main(["verify", str(folder)]) == 2
    said = capsys.readouterr().err
    assert "are damaged, or of another version" in said and len(said.splitlines()) == 1


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (None, "there is no receipt"),
        ("{", "is not a receipt"),
        ("[]", "is not a receipt"),
        ('{"format": 99}', "a receipt of format 99, this is for 1: use the version that wrote it"),
        ('{"format": 1, "kind": "eval"}', "is damaged"),
    ],
)
def test_what_is_not_a_receipt_is_one_report(
    tmp_path: Path, capsys: Any, content: str | None, sentence: str
) -> None:
    if content is not None:
        (tmp_path / "receipt.json").write_text(content)
    assert main(["verify", str(tmp_path)]) == 2
    said = capsys.readouterr().err
    assert sentence in said and len(said.splitlines()) == 1


def test_a_policy_that_is_code_is_not_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    code = "from pathlib import Path\n\ndef act(obs, env):\n    Path('ran').touch()\n"
    (tmp_path / "coded.py").write_text(code + "    return env.action_space.sample() * 0\n")
    words = ("task=cart_pole", "episodes=2", "num_envs=2", "quiet=true")
    assert main(["eval", "coded:act", *words, f"hydra.run.dir={tmp_path}/e"]) in (0, 2)
    runs = [*tmp_path.glob("e/receipt.json"), *tmp_path.glob("outputs/2*/*/receipt.json")]
    (receipt,) = runs
    (tmp_path / "ran").unlink()
    status, report = verify(receipt.parent, capsys)
    found = {finding["what"]: finding for finding in report["findings"]}
    assert status == 1 and "the policy is code, coded:act: --trust" in found["actions"]["text"]
    assert not (tmp_path / "ran").exists()


def test_a_collection_has_a_receipt(tmp_path: Path, capsys: Any) -> None:
    words = ("task=push_cube", "episodes=2", "num_envs=2", "seed=1", "quiet=true")
    assert main(["collect", *words, f"hydra.run.dir={tmp_path}/demos"]) == 0
    code, report = verify(tmp_path / "demos", capsys)
    assert code == 0
    found = {finding["what"]: finding for finding in report["findings"]}
    assert found["results"]["text"].startswith("2 successes of ")
    assert found["actions"]["ok"] is None


STUDY = """
tasks: [cart_pole]
seeds: [0, 1, 2]
arms: {zero: {policy: zero}, random: {policy: random}}
evaluate: {episodes: 3}
"""


def test_a_study_has_a_receipt_of_receipts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "conf/study").mkdir(parents=True)
    (tmp_path / "conf/study/mini.yaml").write_text(STUDY)
    assert main(["study", "mini", "hydra/launcher=basic", "--quiet"]) == 0
    folder = tmp_path / "outputs/studies/mini"
    code, report = verify(folder, capsys)
    assert code == 0
    simulated = [f["what"] for f in report["findings"] if f["what"].endswith("physics")]
    assert len(simulated) == 3  # of six evaluations
    assert [f["text"] for f in report["findings"] if f["what"] == "table"] == [
        "18 rows are those of the evaluations"
    ]
    code, report = verify(folder, capsys, "--all")
    assert code == 0
    assert sum(f["what"].endswith("actions") for f in report["findings"]) == 6
    # What is written about the episodes follows from them, whoever has sealed it.
    for name, old, new in (
        ("summary.csv", b"cart_pole", b"cart_pale"),
        ("results.json", b'"episodes": 9', b'"episodes": 8'),
        ("results.md", b"| cart_pole", b"| cart_pale"),
        ("episodes.csv", b",clean,0,", b",clean,1,"),
        ("receipt.json", b'"episodes": 9', b'"episodes": 8'),
    ):
        data = {path: (folder / path).read_bytes() for path in (name, "receipt.json")}
        assert old in data[name]
        (folder / name).write_bytes(data[name].replace(old, new, 1))
        seal(folder, *([] if name == "receipt.json" else [name]))
        code, report = verify(folder, capsys, "--sample-seed", "1")
        wrong = [finding for finding in report["findings"] if finding["ok"] is False]
        assert code == 1 and len(wrong) == 1, name
        assert wrong[0]["what"] == ("table" if name == "episodes.csv" else "results")
        for path, content in data.items():
            (folder / path).write_bytes(content)
    # Any evaluation that was changed is found, in the sample or not.
    for log in folder.glob("jobs/*/eval-clean/rollout.mcap"):
        data = log.read_bytes()
        log.write_bytes(data[:-1] + bytes([data[-1] ^ 1]))
        code, report = verify(folder, capsys)
        assert code == 1
        assert any("rollout.mcap was changed" in f["text"] for f in report["findings"])
        log.write_bytes(data)


def test_a_receipt_is_verified_in_another_virtual_environment(folder: Path, tmp_path: Path) -> None:
    """The other environment shares the installed packages, and nothing else with this process."""
    venv = tmp_path / "venv"
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(venv)], check=True)
    (place,) = venv.glob("lib/python*/site-packages")
    paths = [path for path in sys.path if path]
    (place / "shared.pth").write_text("\n".join(paths) + "\n")
    result = subprocess.run(
        [str(venv / "bin/python"), "-m", "embodichain", "verify", str(folder)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stderr
    assert "NOT" not in result.stdout and "equal to the bit" in " ".join(result.stdout.split())
