"""Train, export and evaluate the policies that ship: `scripts/make_policies.py [TASK...]`.

Without tasks, it makes all of `RECIPES`. Each is the task's own training (`suggested.train`) with
the seed of the recipe. `--output` writes elsewhere; `--key KEY=VALUE` changes the training, for a
trial. A policy that is made again replaces the shipped one; commit both of its files.
"""

import argparse
import hashlib
import importlib.metadata as metadata
import io
import json
import shutil
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path
from typing import Any

from embodichain.data.pretrained import FOLDER, Pretrained
from embodichain.utils.system.atomic import atomic_file, write_text

RECIPES = {
    "cart_pole": 1,
    "cart_pole_swing_up": 1,
    "press_button": 1,
    "push_cube": 1,
    "quadruped_velocity": 1,
    "reach": 1,
    "reach_pose": 1,
    "reach_workspace": 1,
}
"""Task -> seed, of the policies that ship: learned in minutes. `quadruped_velocity` needs the extra
`robots`."""
MORE = {"humanoid_velocity": 1, "lift_cube": 2, "quadruped_rough": 1}
"""Made when named: they need longer, and the extra `robots`. `humanoid_velocity` reached 0.88, less
than `LEAST`."""
EPISODES = 500
"""Of an evaluation."""
LEAST = 0.9
"""Success rate below which a policy is not written."""


def make(task: str, seed: int, output: Path, keys: list[str], episodes: int, least: float) -> None:
    """Make the policy of one task, and write its two files.

    Args:
        task: The task.
        seed: Seed of the training.
        output: The folder of the files.
        keys: More overrides of the training.
        episodes: Episodes of the evaluation.
        least: The least success rate.
    """
    source_commit = commit()
    training = ["train", f"task={task}", f"seed={seed}", *keys]
    with tempfile.TemporaryDirectory() as folder:
        not_recorded = ["record=none", f"output_dir={folder}"]
        trained = verb([*training, "eval.episodes=2", *not_recorded])
        script = Path(folder) / "traced.pt"
        plain = Path(folder) / f"{task}.pt"
        export = ["export", "policy", trained["folder"], "--format", "torchscript"]
        verb([*export, "-o", str(script)], quiet=False)
        plain.write_bytes(without_paths(script.read_bytes()))
        evaluation = [f"task={task}", f"episodes={episodes}", "num_envs=50"]
        task_changes = [key for key in keys if key.startswith("task.")]
        result = verb(["eval", str(plain), *evaluation, *task_changes, *not_recorded])
        success = result["success"]
        shown = f"{task}: {success['count']} of {success['trials']} episodes succeeded"
        if success["rate"] < least:
            raise SystemExit(f"{shown}, less than {least:.0%}: nothing was written")
        about = Pretrained(
            task=task,
            algo=trained["algo"],
            command=shown_command(training),
            commit=source_commit,
            mujoco=metadata.version("mujoco"),
            torch=metadata.version("torch"),
            env_steps=trained["env_steps"],
            train_seconds=round(trained["train_seconds"], 1),
            evaluated=shown_command(["eval", "pretrained", *evaluation]),
            episodes=success["trials"],
            success=success["rate"],
            interval=tuple(round(end, 4) for end in success["interval"]),
            sha256=hashlib.sha256(plain.read_bytes()).hexdigest(),
        )
        output.mkdir(parents=True, exist_ok=True)
        with atomic_file(output / plain.name) as temporary:
            shutil.copyfile(plain, temporary)
        write_text(output / f"{task}.json", about.to_json())
    print(f"{shown}; {output / plain.name}", flush=True)


def verb(arguments: list[str], quiet: bool = True) -> dict[str, Any]:
    """Run `embodichain` in a process of its own, and return its JSON.

    Raises:
        SystemExit: If it fails; its messages are on stderr.
    """
    command = [sys.executable, "-m", "embodichain", *arguments, "--json"]
    if quiet:
        command.append("--quiet")
    process = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False)
    if process.returncode:
        raise SystemExit(process.returncode)
    return json.loads(process.stdout)


def shown_command(arguments: list[str]) -> str:
    """Return the command as one types it."""
    return " ".join(["embodichain", *arguments])


def without_paths(script: bytes) -> bytes:
    """Return a TorchScript file without the source paths of the machine that traced it.

    They are in entries that only messages of errors use. A serial number is left out too, so that
    the same training makes the same bytes.
    """
    stream = io.BytesIO()
    with (
        zipfile.ZipFile(io.BytesIO(script)) as old,
        zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as new,
    ):
        for entry in old.infolist():
            if entry.filename.endswith((".debug_pkl", "/serialization_id")):
                continue
            plain = zipfile.ZipInfo(entry.filename)  # without a time
            plain.compress_type = zipfile.ZIP_DEFLATED
            new.writestr(plain, old.read(entry))
    return stream.getvalue()


def commit() -> str:
    """Return the commit of the working tree; ``+changes`` where files differ from it."""

    def git(*arguments: str) -> str:
        done = subprocess.run(["git", *arguments], capture_output=True, text=True, check=True)
        return done.stdout.strip()

    folders = ("embodichain", "conf", "tasks", ":!embodichain/data/policies")
    head = git("rev-parse", "HEAD")
    if git("status", "--porcelain", "--", *folders):
        return f"{head}+changes"
    return head


def main() -> None:
    """Make the policies of the tasks named, or all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("tasks", nargs="*", metavar="TASK", choices=[[], *RECIPES, *MORE])
    parser.add_argument("--output", type=Path, default=FOLDER)
    parser.add_argument("--key", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--episodes", type=int, default=EPISODES)
    parser.add_argument("--least", type=float, default=LEAST)
    options = parser.parse_args()
    for task in options.tasks or RECIPES:
        seed = (RECIPES | MORE)[task]
        make(task, seed, options.output, options.key, options.episodes, options.least)


if __name__ == "__main__":
    main()
