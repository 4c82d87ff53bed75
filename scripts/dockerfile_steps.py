"""Run the steps of the Dockerfile without Docker, each stage in a root folder of its own.

`python scripts/dockerfile_steps.py --base DIR --out DIR [-- ARGUMENTS]`, as root. The base is the
folder that ``debootstrap --variant=minbase bookworm DIR`` makes; every ``FROM`` is a copy of it.
``RUN`` runs in a chroot with the build's arguments and variables, ``COPY`` copies the files that
.dockerignore leaves, and at the end the entry point runs with the given arguments as the image's
user. `--bind PATH` shows a path of this machine inside, read-only; `--env NAME` passes a variable.

It does not try Docker's own layers, caching and isolation, nor whether ``debian:12-slim`` is the
base that debootstrap makes without documentation files.
"""

from __future__ import annotations

import argparse
import fnmatch
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).parents[1]
WORDS = ("FROM", "ARG", "ENV", "RUN", "COPY", "WORKDIR", "USER", "ENTRYPOINT", "CMD")


@dataclass(frozen=True)
class Step:
    """One instruction.

    Attributes:
        word: Such as ``RUN``.
        text: The rest of the line.
        line: Its number.
    """

    word: str
    text: str
    line: int


@dataclass
class Stage:
    """A stage of the build: its folder, and what its instructions set."""

    root: Path
    arguments: dict[str, str] = field(default_factory=dict)
    variables: dict[str, str] = field(default_factory=dict)
    folder: str = "/"
    user: str = "root"
    entry: list[str] = field(default_factory=list)
    command: list[str] = field(default_factory=list)


def steps(text: str) -> list[Step]:
    """Read the instructions of a Dockerfile.

    Raises:
        ValueError: If one is not known here.
    """
    instructions = []
    for number, line in enumerate(text.splitlines(), 1):
        if not line.strip() or line.startswith("#"):
            continue
        word, _, rest = line.partition(" ")
        if word not in WORDS:
            raise ValueError(f"line {number}: {word!r} is not known here")
        instructions.append(Step(word, rest.strip(), number))
    return instructions


def context(root: Path, ignored: str) -> Iterator[Path]:
    """Yield the files that ``COPY .`` copies, relative to the root.

    Args:
        root: The root folder of the build.
        ignored: The text of .dockerignore.
    """
    rules = [line for line in ignored.splitlines() if line and not line.startswith("#")]
    # Folders at the top that are ignored, but have files that a rule includes again.
    reopened = {rule[1:].partition("/")[0] for rule in rules if rule.startswith("!")}
    for folder, folders, files in os.walk(root):
        parent = Path(folder).relative_to(root)
        links = [name for name in folders if Path(folder, name).is_symlink()]
        for name in (*files, *links):
            path = parent / name
            if not _is_ignored(path.as_posix(), rules):
                yield path
        if parent == Path():  # do not descend into folders that are ignored as a whole
            folders[:] = [n for n in folders if n in reopened or not _is_ignored(f"{n}/x", rules)]


def _is_ignored(path: str, rules: Iterable[str]) -> bool:
    """Whether rules ignore a path: the last one that matches decides, as in Docker.

    A rule matches a path if it matches the path or a folder above it. ``!`` includes a path again,
    ``**/`` matches a name at any depth.
    """
    names = path.split("/")
    parents = ["/".join(names[:depth]) for depth in range(1, len(names) + 1)]
    is_ignored = False
    for rule in rules:
        pattern = rule.removeprefix("!")
        candidates = parents
        if pattern.startswith("**/"):
            pattern = pattern.removeprefix("**/")
            candidates = names
        if any(fnmatch.fnmatchcase(candidate, pattern) for candidate in candidates):
            is_ignored = not rule.startswith("!")
    return is_ignored


class Builder:
    """Performs the steps.

    Args:
        base: Root folder that every stage starts from.
        out: Folder for the stages' roots.
        binds: Paths of this machine that are shown inside.
        passed: Variables of this machine that steps get.
        arguments: Values of the build's arguments.
    """

    def __init__(
        self, base: Path, out: Path, binds: list[Path], passed: list[str], arguments: dict[str, str]
    ) -> None:
        self.base = base
        self.out = out
        self.binds = binds
        self.arguments = arguments
        self.passed = {name: os.environ[name] for name in passed if name in os.environ}
        self.stages: dict[str, Stage] = {}
        self.stage = Stage(out)

    def perform(self, step: Step) -> None:
        """Perform one step.

        Raises:
            subprocess.CalledProcessError: If a command fails.
        """
        getattr(self, f"_{step.word.lower()}")(step.text)

    def _from(self, text: str) -> None:
        match = re.fullmatch(r"\S+(?: AS (\S+))?", text)
        name = f"stage{len(self.stages)}"
        if match and match[1]:
            name = match[1]
        self.stage = Stage(self.out / name)
        self.stages[name] = self.stage
        self.out.mkdir(parents=True, exist_ok=True)
        subprocess.run(["cp", "-a", self.base, self.stage.root], check=True)
        shutil.copy("/etc/resolv.conf", self.stage.root / "etc" / "resolv.conf")

    def _arg(self, text: str) -> None:
        name, _, default = text.partition("=")
        self.stage.arguments[name] = self.arguments.get(name, default)

    def _env(self, text: str) -> None:
        name, _, value = text.partition("=")
        self.stage.variables[name] = value

    def _workdir(self, text: str) -> None:
        self.stage.folder = text
        (self.stage.root / text.lstrip("/")).mkdir(parents=True, exist_ok=True)

    def _user(self, text: str) -> None:
        self.stage.user = text

    def _entrypoint(self, text: str) -> None:
        self.stage.entry = json.loads(text)

    def _cmd(self, text: str) -> None:
        self.stage.command = json.loads(text)

    def _copy(self, text: str) -> None:
        *options, source, target = shlex.split(text)
        place = self._inside(target)
        if options:
            (option,) = options
            stage = self.stages[option.removeprefix("--from=")]
            folder = stage.root / source.lstrip("/")
            shutil.copytree(folder, place, symlinks=True, dirs_exist_ok=True)
            return
        ignored = (ROOT / ".dockerignore").read_text(encoding="utf-8")
        for path in context(ROOT, ignored):
            if source == ".":
                self._copy_file(path, place / path)
            elif path == Path(source):
                self._copy_file(path, place)

    def _copy_file(self, path: Path, target: Path) -> None:
        """Copy a file of the checkout."""
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(ROOT / path, target, follow_symlinks=False)

    def _inside(self, path: str) -> Path:
        return self.stage.root / path.lstrip("/")

    def _run(self, text: str) -> None:
        self.inside(["/bin/sh", "-c", text])

    def inside(self, command: list[str]) -> None:
        """Run a command in the stage's root, as its user.

        Raises:
            subprocess.CalledProcessError: If it fails.
        """
        stage = self.stage
        variables = {
            "PATH": "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin",
            "HOME": "/root" if stage.user == "root" else f"/home/{stage.user}",
            "DEBIAN_FRONTEND": "noninteractive",
            **self.passed,
            **stage.arguments,
            **stage.variables,
        }
        words = [f"{name}={value}" for name, value in variables.items()]
        user = [f"--userspec={stage.user}"] if stage.user != "root" else []
        root = stage.root
        for path in self.binds:
            place = self._inside(str(path))
            place.parent.mkdir(parents=True, exist_ok=True)
            if path.is_dir():
                place.mkdir(exist_ok=True)
            else:
                place.touch()
        line = f"cd {stage.folder} && exec {shlex.join(['env', '-i', *words, *command])}"
        chroot = ["exec", "chroot", *user, str(root), "/bin/sh", "-c", line]
        script = " && ".join([*mounts(root, self.binds), shlex.join(chroot)])
        # In namespaces of its own nothing stays mounted or running, whatever happens.
        unshare = ["unshare", "--mount", "--propagation", "private", "--pid", "--fork"]
        subprocess.run([*unshare, "/bin/sh", "-c", script], check=True, stdin=subprocess.DEVNULL)


def mounts(root: Path, binds: list[Path]) -> list[str]:
    """Return commands that mount the parts of this machine that a step sees, read-only.

    A package's installation script that runs inside would otherwise change this machine's files.
    """
    dev = root / "dev"
    commands = [
        ["mount", "-t", "proc", "proc", str(root / "proc")],
        ["mount", "-t", "tmpfs", "-o", "mode=755", "tmpfs", str(dev)],
        ["mkdir", "-m", "1777", str(dev / "shm")],
    ]
    for name in ("null", "zero", "random", "urandom"):
        commands += [
            ["touch", str(dev / name)],
            ["mount", "--bind", f"/dev/{name}", str(dev / name)],
        ]
    for path in binds:
        place = str(root / str(path).lstrip("/"))
        commands.append(["mount", "--bind", str(path), place])
        commands.append(["mount", "-o", "remount,bind,ro", place])
    return [shlex.join(command) for command in commands]


def main(arguments: list[str] | None = None) -> int:
    """Perform all steps, then run the entry point."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--base", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True, help="a new folder")
    parser.add_argument("--bind", type=Path, action="append", default=[])
    parser.add_argument("--env", action="append", default=[])
    parser.add_argument("--build-arg", action="append", default=[], metavar="NAME=VALUE")
    parser.add_argument("command", nargs="*", help="for the entry point")
    options = parser.parse_args(arguments)
    builder = Builder(
        base=options.base.resolve(),
        out=options.out.resolve(),
        binds=options.bind,
        passed=options.env,
        arguments=dict(argument.split("=", 1) for argument in options.build_arg),
    )
    try:
        for step in steps((ROOT / "Dockerfile").read_text(encoding="utf-8")):
            print(f"{step.line}: {step.word} {step.text}", flush=True)
            builder.perform(step)
        stage = builder.stage
        print(f"as {stage.user}: {shlex.join([*stage.entry, *options.command])}", flush=True)
        builder.inside([*stage.entry, *(options.command or stage.command)])
    except subprocess.CalledProcessError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
