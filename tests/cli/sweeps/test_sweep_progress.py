"""The table of a sweep's progress, from the files of its jobs."""

import os
from pathlib import Path

import yaml

from embodichain.cli.sweeps.sweep_progress import job_label, job_rows, table_of

HEADER = "time/fps,time/total_timesteps,rollout/ep_rew_mean,rollout/success_rate\n"


def job(sweep: Path, name: str, progress: str = "", summary: str = "") -> Path:
    folder = sweep / name
    folder.mkdir(parents=True)
    (folder / "config.yaml").write_text("task: {}\n")
    lines = ["++num_envs=4", f"++seed={name}", "++algo.gamma=0.9"]
    (folder / "overrides.yaml").write_text(yaml.safe_dump(lines))
    if progress:
        (folder / "progress.csv").write_text(HEADER + progress)
    if summary:
        (folder / "summary.json").write_text(summary)
    return folder


def test_each_job_has_its_name_and_its_last_numbers(tmp_path: Path) -> None:
    job(tmp_path, "0", "99,32,,\n120,64,12.5,0.25\n1,9")  # the last row is being written
    job(tmp_path, "10")
    job(tmp_path, "2", "120,64,12.5,1.0\n", '{"status": "finished"}')
    job(tmp_path, "2.earlier-1")
    os.utime(tmp_path / "2/progress.csv", (1, 1))
    rows = job_rows(tmp_path, ["seed"])
    assert [(row.label, row.state) for row in rows] == [
        ("0 seed=0", "running"),
        ("2 seed=2", "finished"),
        ("10 seed=10", "running"),
    ]
    assert table_of(rows, 5).splitlines() == [
        "jobs: 2 running, 1 finished, 2 waiting",
        "  [0 seed=0]    steps 64  steps/s 120  return 12.5  success 25%",
        "  [10 seed=10]",
    ]


def test_a_job_that_goes_on_is_running_again(tmp_path: Path) -> None:
    folder = job(tmp_path, "0", "99,32,,\n", '{"status": "interrupted"}')
    os.utime(folder / "progress.csv", (1, 1))
    assert job_rows(tmp_path, [])[0].state == "interrupted"
    os.utime(folder / "summary.json", (0, 0))
    assert job_rows(tmp_path, [])[0].state == "running"


def test_many_running_jobs_are_counted(tmp_path: Path) -> None:
    for number in range(23):
        job(tmp_path, str(number))
    lines = table_of(job_rows(tmp_path, ["seed"]), 23).splitlines()
    assert lines[0] == "jobs: 23 running" and len(lines) == 22
    assert lines[-1] == "  and 3 more"


def test_labels_name_what_differs() -> None:
    assert job_label("3", ["++seed=1", "record=none", "~task.events"], ["seed"]) == "3 seed=1"
