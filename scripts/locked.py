"""Install dependencies whose hashes are those of locked.txt, and nothing else.

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
"""Name of the set of packages that the project needs itself."""
CUDA = "torch-cuda"
"""Name of the set that only torch's CUDA build asks for."""
_FIRST = {"setuptools", "torch"}
"""Packages that are installed before the others."""
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
        """Return the entry, as in locked.txt.

        Args:
            notes: Whether comments follow: licence, sets, and the packages that ask for it.
        """
        marker = f" ; {self.marker}" if self.marker else ""
        parts = [f"{self.name}=={self.version}{marker}"]
        parts += [f"--hash={digest}" for digest in self.hashes]
        text = " \\\n    ".join(parts)
        if notes:
            text += f"\n    # licence: {self.licence}"
            text += f"\n    # for: {', '.join(self.sets)}"
            text += f"\n    # via: {', '.join(self.via)}"
        return text + "\n"


def read(lock: Path = LOCK) -> list[Package]:
    """Read the packages of a lock file.

    Raises:
        ValueError: If a line is not one that `make pins` writes; with its number.
    """
    packages: list[Package] = []
    for number, line in enumerate(lock.read_text(encoding="utf-8").splitlines(), 1):
        if line.startswith("#"):
            continue
        if match := _ENTRY.match(line):
            package = Package(
                name=match[1],
                version=match[2],
                marker=match[3] or "",
                hashes=(),
                licence="",
                sets=(),
                via=(),
            )
            packages.append(package)
        elif packages and (match := _HASH.match(line)):
            package = packages[-1]
            packages[-1] = replace(package, hashes=(*package.hashes, match[1]))
        elif packages and (match := _NOTE.match(line)):
            packages[-1] = _with_note(packages[-1], kind=match[1], text=match[2])
        else:
            raise ValueError(f"{lock.name}, line {number}: not written by `make pins`: {line!r}")
    return packages


def _with_note(package: Package, kind: str, text: str) -> Package:
    """Return a package with what a comment of its entry says."""
    if kind == "licence":
        return replace(package, licence=text)
    names = tuple(text.split(", "))
    if kind == "for":
        return replace(package, sets=names)
    return replace(package, via=names)


def of_sets(packages: Iterable[Package], sets: Iterable[str]) -> list[Package]:
    """Return the packages that are installed for any of the sets.

    Raises:
        ValueError: If there is no such set; lists those that exist.
    """
    packages = list(packages)
    chosen_sets = set(sets)
    all_sets = {name for package in packages for name in package.sets}
    unknown = sorted(chosen_sets - all_sets)
    if unknown:
        raise ValueError(f"{', '.join(unknown)}: not among {', '.join(sorted(all_sets))}")
    return [package for package in packages if chosen_sets & set(package.sets)]


def with_needs(packages: Iterable[Package], names: Iterable[str]) -> list[Package]:
    """Return packages, and those that they need, directly or not.

    Raises:
        ValueError: If there is no such package.
    """
    packages = list(packages)
    unread = list(names)
    unknown = sorted(set(unread) - {package.name for package in packages})
    if unknown:
        raise ValueError(f"no package {', '.join(unknown)}")
    needed: set[str] = set()
    while unread:
        name = unread.pop()
        if name not in needed:
            needed.add(name)
            unread += [package.name for package in packages if name in package.via]
    return [package for package in packages if package.name in needed]


def install(chosen: list[Package], cuda: list[Package], torch_index: str) -> None:
    """Install packages into this interpreter's environment.

    Args:
        chosen: The packages.
        cuda: Packages that follow them if torch is a CUDA build.
        torch_index: The index that has torch; empty is that of the others.

    Raises:
        subprocess.CalledProcessError: If pip refuses a file, or finds none.
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
    """Return the CPU build of torch, if pip finds one, else torch as it is.

    Without hashes pip takes the CPU build, whose version X.Y.Z+cpu is the higher one. With hashes
    it would prefer any file whose hash an index lists to one in a folder (``--find-links``).
    """
    version = f"{torch.version}+cpu"
    command = [sys.executable, "-m", "pip", "--disable-pip-version-check", "index", "versions"]
    command += ["torch", *options]
    process = subprocess.run(command, capture_output=True, text=True, check=False)
    versions = re.split(r"[\s,]+", process.stdout)
    if version not in versions:
        return torch
    return replace(torch, version=version)


def needs_cuda() -> bool:
    """Whether the installed torch asks for NVIDIA's libraries."""
    return any(re.match(r"(nvidia|cuda)-", line) for line in metadata.requires("torch") or [])


def _pip(packages: list[Package], options: list[str] | None = None) -> None:
    """Install exactly these packages.

    They are not compiled: Python compiles a module at its first import, and compiling all of torch
    beforehand takes longer than installing it.
    """
    if not packages:
        return
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "requirements.txt")
        file.write_text("".join(p.lines(notes=False) for p in packages), encoding="utf-8")
        command = [sys.executable, "-m", "pip", "--disable-pip-version-check", "install"]
        command += ["--no-compile", "--no-deps", "--require-hashes", *(options or [])]
        command += ["-r", str(file)]
        subprocess.run(command, check=True)


def _split_names(text: str) -> list[str]:
    """Return the names of a list with commas."""
    return [name.strip() for name in text.split(",") if name.strip()]


def main(arguments: list[str] | None = None) -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    verbs = parser.add_subparsers(dest="verb", required=True)
    install_parser = verbs.add_parser("install", help="into this environment")
    install_parser.add_argument("--torch-index", default="", metavar="URL")
    print_parser = verbs.add_parser("print", help="as requirements for pip")
    print_parser.add_argument("--cuda", action="store_true", help="torch's CUDA build")
    for verb in (install_parser, print_parser):
        verb.add_argument("--extra", default="", metavar="NAME,...", help="extras of the project")
        verb.add_argument("--only", default="", metavar="NAME,...", help="packages, no project")
        verb.add_argument("--lock", type=Path, default=LOCK)
    options = parser.parse_args(arguments)
    extras = _split_names(options.extra)
    names = _split_names(options.only)
    try:
        packages = read(options.lock)
        chosen = with_needs(packages, names) if names else of_sets(packages, [RUN, *extras])
        cuda = of_sets(packages, [CUDA])
        if options.verb == "install":
            install([p for p in chosen if p not in cuda], cuda, options.torch_index)
        else:
            if options.cuda:
                chosen = chosen + cuda
            print("".join(p.lines(notes=False) for p in chosen), end="")
    except ValueError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except subprocess.CalledProcessError as error:
        return error.returncode
    return 0


if __name__ == "__main__":
    sys.exit(main())
