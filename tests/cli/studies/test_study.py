"""`embodichain study`: what it does, what it skips, what it says; jobs that fail or are killed."""

import csv
import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from embodichain.cli import main
from tests.helpers.commands import Commands

pytestmark = pytest.mark.slow

SHIPPED = Path(__file__).parents[3] / "conf"
MINI = """
description: Two policies that need no training.
tasks: [cart_pole]
seeds: [0, 1]
arms:
  zero: {policy: zero}
  random: {policy: random}
evaluate:
  episodes: 6
  variations:
    clean: {}
    noisy: {noise: 0.5}
compare: {metrics: [success, return]}
"""
TRAINED = """
tasks: [cart_pole]
seeds: [0]
arms: {ppo: [algo.n_steps=8, algo.batch_size=16, algo.n_epochs=2]}
train: [num_envs=4, total_timesteps=512, checkpoint.every_steps=64, checkpoint.keep=20]
evaluate: {episodes: 4}
compare: {metrics: [return]}
"""
ONE_BY_ONE = "hydra/launcher=basic"
DRY = "--dry-run"
FALLEN_SOON = (
    "evaluate.overrides=['task.terminations.fallen.shape.outside=[-0.06,0.06]',"
    "'task.metrics.success.params.terms.upright.shape.within=[-0.06,0.06]']"
)
"""Short episodes that fail, and short films of them."""
UNRECORDED = "evaluate.record=false"  # no log, so no pictures and films of failed episodes


@pytest.fixture
def write_study(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str, str], Path]:
    monkeypatch.chdir(tmp_path)

    def write(name: str, text: str) -> Path:
        folder = tmp_path / "conf" / "study"
        folder.mkdir(parents=True, exist_ok=True)
        (folder / f"{name}.yaml").write_text(text)
        return tmp_path / "outputs" / "studies" / name

    return write


def episodes_of(folder: Path) -> list[dict[str, Any]]:
    with (folder / "episodes.csv").open(newline="") as stream:
        return list(csv.DictReader(stream))


def test_a_study_from_its_file_to_its_tables(write_study, capsys) -> None:
    folder = write_study("mini", MINI)
    assert main(["study", "mini", FALLEN_SOON, ONE_BY_ONE]) == 0
    first = capsys.readouterr()
    rows = episodes_of(folder)
    keys = [(r["arm"], r["seed"], r["variation"], r["episode"]) for r in rows]
    assert len(set(keys)) == len(keys) == 2 * 2 * 2 * 6
    assert {row["strength.noise"] for row in rows if row["variation"] == "noisy"} == {"0.5"}
    assert {row["strength.noise"] for row in rows if row["variation"] == "clean"} == {""}
    for row in rows:
        results = json.loads((folder / row["folder"] / "eval.json").read_text())
        played = results["per_episode"]
        i = int(row["episode"])
        assert float(row["return"]) == played["return"][i]
        assert float(row["success"] == "True") == played["metrics"]["success"][i]
    assert "difference from zero, on the same starts" in first.out
    assert "2 seeds: an interval over seeds needs at least 5" in first.out
    title = "mini: mean over 2 seeds (the value of each); an interval needs 5 seeds"
    report = (folder / "results.md").read_text()
    assert title in first.out and title in report
    assert title in (folder / "report.html").read_text()
    assert re.search(r"\| \d+\.\d% \(seeds \d+\.\d, \d+\.\d\) \|", report)

    parquet = pytest.importorskip("pyarrow.parquet")
    table = parquet.read_table(folder / "episodes.parquet").to_pylist()
    assert [row["return"] for row in table] == [float(row["return"]) for row in rows]

    page = (folder / "report.html").read_text()
    assert "<h1>mini" in page and "Content-Security-Policy" in page
    films = set(re.findall(r'href="(films/[^"]+)"', page))
    logs = set(re.findall(r'href="(jobs/[^"]+)"', page))
    assert films and logs and all((folder / path).is_file() for path in films | logs)

    # The same once more: nothing runs, and the tables are the same.
    assert main(["study", "mini", FALLEN_SOON, ONE_BY_ONE]) == 0
    again = capsys.readouterr()
    assert ": begins" in first.err and "eval-clean" not in again.err
    assert again.out == first.out


def test_the_shipped_study_in_small(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As docs/studies.md has it, with few steps and episodes."""
    monkeypatch.chdir(tmp_path)
    few = ("train=[total_timesteps=64,num_envs=2,algo.n_steps=16,algo.batch_size=8]", "seeds=[0]")
    few_variations = ("evaluate.episodes=2", "~evaluate.variations.late")
    words = [*few, *few_variations, UNRECORDED, ONE_BY_ONE, "--quiet"]
    assert main(["study", "reach_light", *words]) == 0
    rows = episodes_of(tmp_path / "outputs/studies/reach_light")
    assert {(row["arm"], row["variation"]) for row in rows} == {
        *(("ppo", "clean"), ("ppo", "noisy"), ("expert", "clean"), ("expert", "noisy"))
    }
    assert {row["success"] for row in rows if row["arm"] == "expert"} == {"True"}


def test_a_change_repeats_only_what_depends_on_it(write_study, capsys) -> None:
    folder = write_study("mini", MINI)
    small = ("evaluate.episodes=2", "seeds=[0]", "~arms.random", UNRECORDED, ONE_BY_ONE)
    assert main(["study", "mini", *small]) == 0
    capsys.readouterr()
    assert main(["study", "mini", *small, "evaluate.variations.noisy.noise=1"]) == 0
    said = [line for line in capsys.readouterr().err.splitlines() if line.startswith("zero-")]
    assert len(said) == 1
    assert said[0].startswith("zero-cart_pole-0: eval-noisy: again, because of another config")
    assert "std is" in said[0]
    assert (folder / "jobs/zero-cart_pole-0/eval-noisy.earlier-1/eval.json").is_file()
    assert main(["study", "mini", *small, "seeds=[0,7]", "--dry-run", "--json"]) == 0
    jobs = json.loads(capsys.readouterr().out)["jobs"]
    assert [job["left"] for job in jobs] == ["eval-noisy", "eval-clean, eval-noisy"]
    assert jobs[0]["about"] != "unknown"


def test_arms_with_one_seed_begin_in_the_same_states(write_study) -> None:
    from embodichain.recording import open as open_log

    folder = write_study("mini", MINI)
    few = ("seeds=[3]", "evaluate.episodes=2", "~evaluate.variations.clean")
    assert main(["study", "mini", *few, FALLEN_SOON, ONE_BY_ONE]) == 0
    starts = []
    for arm in ("zero", "random"):
        log = open_log(folder / f"jobs/{arm}-cart_pole-3/eval-noisy/rollout.mcap")
        starts.append([log.read(name)[name][0].tolist() for name in ("qpos", "qvel")])
    assert starts[0] == starts[1]
    pairs = json.loads((folder / "results.json").read_text())["pairs"]
    assert {pair["result"]["pairs"] for pair in pairs} == {2}


def test_arms_with_other_scenes_are_not_paired(write_study, capsys) -> None:
    text = MINI.replace("random: {policy: random}", "heavy: {policy: zero, evaluate: [HEAVY]}")
    write_study("mini", text.replace("HEAVY", "'task.physics.gravity=[0,0,-3]'"))
    assert main(["study", "mini", "seeds=[0]", "evaluate.episodes=2", UNRECORDED, ONE_BY_ONE]) == 0
    assert "heavy and zero are not paired on cart_pole: other" in capsys.readouterr().out


def test_a_job_that_fails_does_not_stop_the_others(write_study, capsys) -> None:
    text = MINI.replace("random: {policy: random}", "broken: {policy: 'broken_policy:act'}")
    folder = write_study("mini", text)
    Path("broken_policy.py").write_text("def act(obs, env):\n    raise RuntimeError('no arm')\n")
    assert main(["study", "mini", "seeds=[0]", UNRECORDED, ONE_BY_ONE]) == 1
    said = capsys.readouterr()
    assert "broken-cart_pole-0: eval-clean failed: " in said.err and "no arm" in said.err
    assert "1 of 2 jobs failed; the same command runs them again" in said.err
    assert {row["arm"] for row in episodes_of(folder)} == {"zero"}

    # Its page is written again from its files, and the index of all runs has it.
    page = (folder / "report.html").read_bytes()
    assert main(["report", str(folder), "--quiet"]) == 0
    assert (folder / "report.html").read_bytes() == page
    assert main(["report", "outputs", "--quiet"]) == 0
    index = Path("outputs/index.html").read_text()
    assert '<a href="./studies/mini/report.html">studies/mini</a>' in index
    assert '<a href="./studies/mini/report.html">study</a>' in index  # of each of its runs

    # A study of which nothing is done says the same, and no more.
    write_study("none", text)
    capsys.readouterr()
    assert main(["study", "none", "seeds=[0]", "~arms.zero", UNRECORDED, ONE_BY_ONE]) == 1
    said = capsys.readouterr().err
    assert "no arm" in said and "1 of 1 jobs failed" in said and "error: " not in said


def test_jobs_of_workers_are_those_of_one_process(write_study) -> None:
    folder = write_study("mini", MINI)
    few = ("evaluate.episodes=3", "~evaluate.variations.noisy", UNRECORDED)
    assert main(["study", "mini", *few, ONE_BY_ONE]) == 0
    alone = (folder / "episodes.csv").read_bytes()
    folder.rename(folder.with_name("alone"))
    workers = ("hydra/launcher=joblib", "hydra.launcher.n_jobs=2")
    assert main(["study", "mini", *few, *workers, "--quiet"]) == 0
    assert (folder / "episodes.csv").read_bytes() == alone


def test_a_study_that_is_killed_five_times_ends_with_the_same_table(
    write_study, commands: Commands, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys
) -> None:
    folder = write_study("small", TRAINED)
    arguments = ("study", "small", UNRECORDED, ONE_BY_ONE, "--quiet")
    assert commands.run(*arguments, cwd=tmp_path).returncode == 0
    whole = (folder / "episodes.csv").read_bytes()
    folder.rename(folder.with_name("whole"))
    job = folder / "jobs" / "ppo-cart_pole-0"
    # One kill at each point that leaves other files behind.
    points = (
        job / "train" / "config.yaml",
        job / "train" / "checkpoints",
        job / "train" / "summary.json",
        job / "eval-clean" / "config.yaml",
        job / "eval-clean" / "eval.json",
    )
    for point in points:
        process = commands.start(*arguments, cwd=tmp_path)
        while process.poll() is None and not point.exists():
            pass
        process.kill()
        process.wait()
        assert point.exists()
    assert commands.run(*arguments, cwd=tmp_path).returncode == 0
    assert (folder / "episodes.csv").read_bytes() == whole

    # A training that is repeated and fails leaves no evaluation of the earlier one in the results.
    def fail(job: Any) -> None:
        raise RuntimeError("no luck")

    # Training fails here and nowhere else: the same inputs have worked before.
    monkeypatch.setattr("embodichain.cli.studies.study_job.train_job", fail)
    assert main([*arguments, "train=[num_envs=4,total_timesteps=128]"]) == 1
    assert "train failed: no luck" in capsys.readouterr().err
    assert main(["report", str(folder)]) == 2
    assert "no evaluation of the study small is done" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("overrides", "sentences"),
    [
        (("seed=1",), ["seed: unknown key", "Did you mean 'seeds'?"]),
        (("task=reach",), ["not a key of a study", "tasks=[reach]"]),
        (("seeds=[1,1]",), ["seeds: a seed is listed twice"]),
        (("~tasks",), ["a study needs a task"]),
        (("tasks=[cart_pol]",), ["there is no task 'cart_pol'", "Did you mean 'cart_pole'?"]),
        (("suite=leg",), ["unknown option 'leg'; suite is one of: arms, locomotion"]),
        (("arms.zero.policy=no/such.zip",), ["arms.zero.policy: there is no such file"]),
        (("arms.zero.train=[seed=1]",), ["has a policy, and keys of a training"]),
        (("compare.baseline=zer",), ["there is no arm 'zer'", "Did you mean 'zero'?"]),
        (("compare.metrics=[sucess]",), ["has no metric 'sucess'", "Did you mean 'success'?"]),
        (("evaluate.variations.dim.lihgting=1",), ["Did you mean 'lighting'?"]),
        (("evaluate.episodes=0", "seeds=[]"), ["evaluate.episodes: must be", "seeds: "]),
        (("arms.zero=null", "arms.random=null"), ["arms: expected at least 1 value, got 0"]),
        (("evaluate.overrides=[seed=1,num_envs=2]",), ["the study sets seed", "evaluate.episodes"]),
        (("~arms.zero", "arms.random=null", "+arms.a=[task=reach]"), ["arms.a: task=reach: the"]),
        (("evaluate.overrides=[task.nothing=1]",), ["arm zero, task cart_pole", "task.nothing"]),
    ],
)
def test_mistakes_are_told_before_anything_starts(
    write_study, capsys, overrides: tuple[str, ...], sentences: list[str]
) -> None:
    folder = write_study("mini", MINI)
    assert main(["study", "mini", *overrides]) == 2
    said = capsys.readouterr().err
    for sentence in sentences:
        assert sentence in said
    assert not folder.exists()


def test_two_jobs_do_not_share_a_folder(write_study, tmp_path: Path, capsys) -> None:
    write_study("mini", MINI.replace("zero:", "a-b:").replace("random:", "a:"))
    (tmp_path / "conf/task").mkdir()
    shutil.copy(SHIPPED / "task/cart_pole.yaml", tmp_path / "conf/task/b-cart_pole.yaml")
    assert main(["study", "mini", "tasks=[cart_pole,b-cart_pole]", "seeds=[0]"]) == 2
    said = capsys.readouterr().err
    assert "a-b on cart_pole and a on b-cart_pole have one name, a-b-cart_pole-0: rename" in said


def test_an_unknown_study_is_answered_with_those_that_exist(write_study, capsys) -> None:
    write_study("mini", MINI)
    assert main(["study", "min"]) == 2
    said = capsys.readouterr().err
    assert "there is no study 'min'; there are: mini, " in said and "Did you mean 'mini'?" in said


def test_trainings_of_a_study_share_a_group_in_weights_and_biases(write_study) -> None:
    from embodichain.config.study import resolve_study

    write_study("small", TRAINED)
    (job,) = resolve_study("small").jobs()
    wandb = job.training().tree["wandb"]
    assert (wandb["group"], wandb["name"]) == ("small", "ppo-cart_pole-0")
    (job,) = resolve_study("small", ["train=[wandb.group=mine,wandb.name=one]"]).jobs()
    assert job.training().tree["wandb"]["group"] == "mine"


def test_a_study_extends_another(write_study, capsys) -> None:
    write_study("mini", MINI)
    write_study("more", "defaults: [mini, _self_]\nseeds: [4]\narms: {random: null}\n")
    assert main(["study", "more", "--dry-run", "--json"]) == 0
    jobs = json.loads(capsys.readouterr().out)["jobs"]
    assert [job["job"] for job in jobs] == ["zero-cart_pole-4"]


def test_a_search_is_frozen_before_the_evaluations(write_study, capsys) -> None:
    text = TRAINED.replace("arms: {ppo: [", "arms: {ppo: {train: [").replace(
        "algo.n_epochs=2]}",
        "algo.n_epochs=2], optimize: {trials: 2, params: "
        "{algo.learning_rate: 'interval(1e-4,1e-2)'}}}}",
    )
    folder = write_study("search", text)
    few = "train=[num_envs=4,total_timesteps=64,eval.episodes=2]"
    search = ["study", "search", UNRECORDED, ONE_BY_ONE, "--quiet", few]
    assert main(["study", "search", "--dry-run", "--json"]) == 0
    (job,) = json.loads(capsys.readouterr().out)["jobs"]
    assert job["left"] == "search, train, eval-clean" and job["about"].endswith(" s")
    params = "arms.ppo.optimize.params"
    assert main(["study", "search", f"+{params}.algo.gama='choice(1,2)'", DRY]) == 2
    assert "Did you mean 'gamma'?" in capsys.readouterr().err
    assert main(["study", "search", f"+{params}.algo.gamma=1", DRY]) == 2
    assert "algo.gamma=1 has one value: write interval(" in capsys.readouterr().err
    assert main(search) == 0
    (chosen,) = (folder / "search" / "ppo-cart_pole" / "chosen.yaml").read_text().splitlines()
    assert chosen.startswith("- algo.learning_rate=")
    config = (folder / "jobs/ppo-cart_pole-0/train/config.yaml").read_text()
    assert chosen.removeprefix("- algo.learning_rate=") in config
    trials = list((folder / "search/ppo-cart_pole").glob("*/summary.json"))
    assert {json.loads(path.read_text())["seed"] for path in trials} == {1}  # no result's seed
    capsys.readouterr()
    assert main(search) == 0
    assert len(list((folder / "search/ppo-cart_pole").glob("*/summary.json"))) == len(trials)

    # What it has trained is refused in another task, before anything starts.
    training = folder / "jobs/ppo-cart_pole-0/train"
    other = write_study("other", MINI.replace("policy: random", f"policy: {training}"))
    assert main(["study", "other", "tasks=[cart_pole,reach]"]) == 2
    said = capsys.readouterr().err
    assert "arm random, task reach" in said and "this task has (21,)" in said
    assert "task cart_pole" not in said and not other.exists()
    heavier = "evaluate.overrides=['task.physics.gravity=[0,0,-3]']"
    assert main(["study", "other", heavier]) == 2
    assert "was trained in another task" in capsys.readouterr().err
    assert main(["study", "other", heavier.replace("]']", "]',allow_changed=true]"), DRY]) == 0


def test_two_processes_do_not_run_one_study(write_study, capsys) -> None:
    from embodichain.cli.sweeps.sweep_jobs import exclusive

    folder = write_study("mini", MINI)
    with exclusive(folder, "study"):
        assert main(["study", "mini", ONE_BY_ONE]) == 1
    said = capsys.readouterr().err
    assert "another process runs this study now (process " in said
    assert not folder.exists()
