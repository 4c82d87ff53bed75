"""Installs dependencies whose hashes are those of locked.txt, and nothing else.

`python scripts/locked.py install --extra robots,video` installs what `embodichain[robots,video]`
needs into the environment of this interpreter: torch first, then the rest, each file compared with
its hashes (pip's ``--require-hashes``). The project itself follows without dependencies, since pip
does not take hashes together with an editable installation: ``pip install --no-deps -e .``.
`print` writes the lines for a file of requirements, `--only uv` takes packages without the project.

A Linux build of torch for CUDA needs NVIDIA's libraries, the CPU build none of them: what the
installed torch asks for decides. Only the standard library is used: this runs in new environments.
"""

from __future__ import annotations

import argparse
import importlib.metadata as metadata
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

LOCK = Path(__file__).parents[1] / "locked.txt"
RUN = "run"
"""What the project needs itself."""
CUDA = "torch-cuda"
"""What only torch's CUDA build asks for."""
_FIRST = {"setuptools", "torch"}
_ENTRY = re.compile(r"^([a-z0-9-]+)==([^ ;\\]+)(?: ; ([^\\]+?))? \\$")
_HASH = re.compile(r"^    --hash=(sha256:[0-9a-f]{64})(?: \\)?$")
_NOTE = re.compile(r"^    # (licence|for|via): (.+)$")


@dataclass(frozen=True)
class Package:
    """A version that is locked.

    Attributes:
        name: Canonical, such as ``ruamel-yaml``.
        version: Without a local part.
        marker: When it is installed, as in PEP 508; empty: always.
        hashes: ``sha256:...`` of every file that may be installed.
        licence: SPDX expression where the package has one, else its own words.
        sets: What it is installed for: `RUN`, extras of the project, or `CUDA`.
        via: Packages that ask for it themselves, the project among them.
    """

    name: str
    version: str
    marker: str
    hashes: tuple[str, ...]
    licence: str
    sets: tuple[str, ...]
    via: tuple[str, ...]

    def lines(self, *, notes: bool = True) -> str:
        """The entry, as in locked.txt.

        Args:
            notes: Whether the comments follow, too.
        """
        marker = f" ; {self.marker}" if self.marker else ""
        text = " \\\n    ".join(
            [f"{self.name}=={self.version}{marker}", *(f"--hash={h}" for h in self.hashes)]
        )
        if notes:
            text += f"\n    # licence: {self.licence}"
            text += f"\n    # for: {', '.join(self.sets)}\n    # via: {', '.join(self.via)}"
        return text + "\n"


def read(lock: Path = LOCK) -> list[Package]:
    """The packages of a lock file.

    Raises:
        ValueError: A line is not one that `make pins` writes; with its number.
    """
    found: list[Package] = []
    for number, line in enumerate(lock.read_text(encoding="utf-8").splitlines(), 1):
        if line.startswith("#"):
            continue
        if match := _ENTRY.match(line):
            found.append(Package(match[1], match[2], match[3] or "", (), "", (), ()))
        elif found and (match := _HASH.match(line)):
            found[-1] = replace(found[-1], hashes=(*found[-1].hashes, match[1]))
        elif found and (match := _NOTE.match(line)):
            words = tuple(match[2].split(", "))
            named = {"licence": match[2], "for": words, "via": words}
            field = {"for": "sets"}.get(match[1], match[1])
            found[-1] = replace(found[-1], **{field: named[match[1]]})
        else:
            raise ValueError(f"{lock.name}, line {number}: not written by `make pins`: {line!r}")
    return found


def of_sets(packages: Iterable[Package], sets: Iterable[str]) -> list[Package]:
    """What is installed for any of the sets.

    Raises:
        ValueError: There is no such set; with those there are.
    """
    packages, wanted = list(packages), set(sets)
    known = {name for p in packages for name in p.sets}
    if unknown := sorted(wanted - known):
        raise ValueError(f"{', '.join(unknown)}: not among {', '.join(sorted(known))}")
    return [p for p in packages if wanted & set(p.sets)]


def with_needs(packages: Iterable[Package], names: Iterable[str]) -> list[Package]:
    """Packages, and what they need, directly or not.

    Raises:
        ValueError: There is no such package.
    """
    packages, todo = list(packages), list(names)
    if unknown := sorted(set(todo) - {p.name for p in packages}):
        raise ValueError(f"no package {', '.join(unknown)}")
    seen: set[str] = set()
    while todo:
        name = todo.pop()
        if name not in seen:
            seen.add(name)
            todo += [p.name for p in packages if name in p.via]
    return [p for p in packages if p.name in seen]


def install(chosen: list[Package], cuda: list[Package], torch_index: str) -> None:
    """Install packages into this interpreter's environment.

    Args:
        chosen: The packages.
        cuda: What follows them if torch is a CUDA build.
        torch_index: Where torch is taken from; empty: where the rest is.

    Raises:
        subprocess.CalledProcessError: pip refused a file, or found none.
    """
    rest = [p for p in chosen if p.name not in _FIRST]
    torch = [p for p in chosen if p.name == "torch"]
    if torch:
        index = ["--index-url", torch_index] if torch_index else []
        _pip([cpu_build(torch[0], index)], index)
        if needs_cuda():
            rest += cuda
    _pip([p for p in chosen if p.name == "setuptools"])
    # Without build isolation the locked setuptools builds source distributions, not the newest.
    _pip(rest, ["--no-build-isolation"])


def cpu_build(torch: Package, options: list[str]) -> Package:
    """The CPU build of torch, if pip finds one, else torch as it is.

    Without hashes pip takes the CPU build, whose version X.Y.Z+cpu is the higher one. With hashes
    it would prefer any file whose hash an index lists to one in a folder (``--find-links``).
    """
    version = f"{torch.version}+cpu"
    command = [sys.executable, "-m", "pip", "--disable-pip-version-check", "index", "versions"]
    done = subprocess.run(
        [*command, "torch", *options], capture_output=True, text=True, check=False
    )
    found = re.split(r"[\s,]+", done.stdout)
    return replace(torch, version=version) if version in found else torch


def needs_cuda() -> bool:
    """Whether the installed torch asks for NVIDIA's libraries."""
    return any(re.match(r"(nvidia|cuda)-", line) for line in metadata.requires("torch") or [])


def _pip(packages: list[Package], options: list[str] | None = None) -> None:
    """Install exactly these.

    Python compiles what it imports at its first import: compiling all of torch beforehand takes
    longer than installing it.
    """
    if not packages:
        return
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "requirements.txt")
        file.write_text("".join(p.lines(notes=False) for p in packages), encoding="utf-8")
        command = [sys.executable, "-m", "pip", "--disable-pip-version-check", "install"]
        command += ["--no-compile", "--no-deps", "--require-hashes", *(options or [])]
        subprocess.run([*command, "-r", file], check=True)


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split(",") if name.strip()]


def main(arguments: list[str] | None = None) -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    verbs = parser.add_subparsers(dest="verb", required=True)
    for verb, what in (("install", "into this environment"), ("print", "as requirements for pip")):
        one = verbs.add_parser(verb, help=what)
        one.add_argument("--extra", default="", metavar="NAME,...", help="extras of the project")
        one.add_argument("--only", default="", metavar="NAME,...", help="packages, no project")
        one.add_argument("--lock", type=Path, default=LOCK)
    verbs.choices["install"].add_argument("--torch-index", default="", metavar="URL")
    verbs.choices["print"].add_argument("--cuda", action="store_true", help="torch's CUDA build")
    options = parser.parse_args(arguments)
    extras, only = _names(options.extra), _names(options.only)
    try:
        packages = read(options.lock)
        chosen = with_needs(packages, only) if only else of_sets(packages, [RUN, *extras])
        cuda = of_sets(packages, [CUDA])
        if options.verb == "install":
            install([p for p in chosen if p not in cuda], cuda, options.torch_index)
        else:
            listed = chosen + (cuda if options.cuda else [])
            print("".join(p.lines(notes=False) for p in listed), end="")
    except ValueError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except subprocess.CalledProcessError as error:
        return error.returncode
    return 0


if __name__ == "__main__":
    sys.exit(main())
