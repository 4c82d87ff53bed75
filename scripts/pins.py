"""Writes the exact versions that the tests run with, and their licences.

Run it with the environment's own python (`make pins`) after changing a dependency. It writes
constraints.txt, locked.txt and docs/licences.md. All have everything the installed
`embodichain[dev]` needs; a package that is installed but needed by nothing is left out, a needed
one that is missing is an error.

constraints.txt has names and versions, for ``pip install -c``. locked.txt has the same versions for
Linux, macOS and Windows, what those need besides, the sha256 of every file of each version, its
licence, and who needs it; `scripts/locked.py` installs from it. uv resolves it, and asks the index
for the hashes (``UV_DEFAULT_INDEX`` names another than its own). torch's CPU build comes from an
index of its own: scripts/torch_cpu.txt has its hashes, and ``--torch-cpu`` adds to them.
"""

import argparse
import hashlib
import importlib.metadata as metadata
import re
import subprocess
import sys
import tempfile
import tomllib
import urllib.parse
import urllib.request
from dataclasses import dataclass, field
from pathlib import Path

from packaging.markers import default_environment
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet
from packaging.utils import canonicalize_name
from packaging.version import Version

from scripts.licences import PAGE, page
from scripts.locked import CUDA, RUN, Package

PROJECT = "embodichain"
ROOT = Path(__file__).parents[1]
CONSTRAINTS = ROOT / "constraints.txt"
LOCK = ROOT / "locked.txt"
TORCH_CPU = ROOT / "scripts" / "torch_cpu.txt"
LOWEST = "3.11.0"
"""The oldest Python that pyproject.toml allows."""
HEADER = """\
# Exact pins of everything `pip install -e .[dev]` needs: what the tests run with (`make pins`).
# torch has no local version here: both the CPU build and the one with CUDA are 'torch X.Y.Z'.
"""
LOCK_HEADER = """\
# constraints.txt for CPython on Linux, macOS and Windows, with the sha256 of every file that may be
# installed, both builds of torch among them. `make pins` writes it, `scripts/locked.py` installs.
"""
# What the packages' metadata do not say, from their licence files; and what is not installed on the
# machine that writes the file.
LICENCES = {
    "appnope": "BSD-2-Clause",
    "cuda-bindings": "LicenseRef-NVIDIA-SOFTWARE-LICENSE",
    "cuda-pathfinder": "Apache-2.0",
    "cuda-toolkit": "NVIDIA Proprietary Software",
    "embreex": "BSD-2-Clause",
    "triton": "MIT",
    "vhacdx": "MIT",
}
_FILE = re.compile(r"torch-([0-9.]+)\+cpu-\S+\.whl")
_ENTRY = re.compile(r"^([a-z0-9-]+)==([^ ;\\]+)(?: ; ([^\\]+?))?(?: \\)?$")


def closure(root: Requirement) -> dict[str, str]:
    """Finds every distribution that `root` needs, without `root` itself.

    Args:
        root: The requirement to start from, with its extras.

    Returns:
        Canonical name to public version (no local part such as `+cpu`).

    Raises:
        importlib.metadata.PackageNotFoundError: If a needed distribution is not installed.
    """
    found: dict[str, str] = {}
    seen: set[tuple[str, str]] = set()
    todo = [root]
    while todo:
        requirement = todo.pop()
        name = canonicalize_name(requirement.name)
        found[name] = Version(metadata.version(name)).public
        for extra in {"", *requirement.extras}:
            if (name, extra) not in seen:
                seen.add((name, extra))
                todo += _needs(name, extra)
    del found[canonicalize_name(root.name)]
    return dict(sorted(found.items()))


def _needs(name: str, extra: str) -> list[Requirement]:
    """Lists what `name[extra]` asks for on this machine."""
    environment = {**default_environment(), "extra": extra}
    requirements = map(Requirement, metadata.requires(name) or [])
    return [r for r in requirements if r.marker is None or r.marker.evaluate(environment)]


def constraint(name: str, version: str) -> str:
    """The line of constraints.txt.

    A version that does not take the oldest Python we take is a constraint of later ones only; the
    oldest gets what its index has for it.
    """
    pythons = SpecifierSet(metadata.metadata(name).get("Requires-Python") or "")
    if pythons.contains(LOWEST):
        return f"{name}=={version}"
    lowest = max(Version(s.version) for s in pythons if s.operator == ">=")
    return f'{name}=={version}; python_full_version >= "{lowest}"'


def locked(constraints: str) -> list[Package]:
    """Resolves for every system, within the constraints.

    Raises:
        subprocess.CalledProcessError: uv found no solution; it has said why.
    """
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras: dict[str, list[str]] = project["optional-dependencies"]
    everything = [*project["dependencies"], *_expanded(extras, "dev")]
    entries = _entries(_uv(everything, constraints, "--generate-hashes"))
    pins = "".join(
        f"{e.name}=={e.version}{f' ; {e.marker}' if e.marker else ''}\n" for e in entries
    )
    wanted = {RUN: project["dependencies"], **{name: _expanded(extras, name) for name in extras}}
    found = {name: {e.name for e in _entries(_uv(r, pins))} for name, r in wanted.items()}
    cuda = _cuda(entries, {line.partition("==")[0] for line in constraints.splitlines()})
    (version,) = (e.version for e in entries if e.name == "torch")
    torch = [f"sha256:{digest}" for digest in _torch_cpu(version)]
    packages = []
    for entry in entries:
        names = [RUN] if entry.name in found[RUN] else [n for n in found if entry.name in found[n]]
        hashes = [*entry.hashes, *(torch if entry.name == "torch" else [])]
        packages.append(
            Package(
                *(entry.name, entry.version, entry.marker),
                tuple(sorted(hashes)),
                licence_of(entry.name),
                (CUDA,) if entry.name in cuda else tuple(sorted(names)),
                tuple(sorted(set(entry.via))),
            )
        )
    return packages


@dataclass
class _Entry:
    """What uv says of a version."""

    name: str
    version: str
    marker: str
    hashes: list[str] = field(default_factory=list)
    via: list[str] = field(default_factory=list)


def _uv(requirements: list[str], constraints: str, *options: str) -> str:
    """Resolves for every system; requirements with hashes as uv writes them."""
    with tempfile.TemporaryDirectory() as folder:
        pins = Path(folder, "constraints.txt")
        pins.write_text(constraints, encoding="utf-8")
        command = [sys.executable, "-m", "uv", "pip", "compile", "--universal", "--quiet"]
        command += ["--python-version", LOWEST, "--no-header", "--no-emit-index-url", *options]
        asked = Path(folder, "requirements.in")
        asked.write_text("\n".join(requirements), encoding="utf-8")
        done = subprocess.run(
            [*command, "-c", pins, asked], check=True, stdout=subprocess.PIPE, text=True
        )
    return done.stdout


def _entries(text: str) -> list[_Entry]:
    """What uv printed, without what only PyPy needs."""
    found: list[_Entry] = []
    for line in text.splitlines():
        if match := _ENTRY.match(line):
            found.append(_Entry(match[1], match[2], match[3] or ""))
        elif "--hash=" in line:
            found[-1].hashes.append(line.strip(" \\").removeprefix("--hash="))
        else:
            parent = line.strip(" #").removeprefix("via").strip()
            if parent and not parent.startswith("-c "):
                found[-1].via.append(PROJECT if parent.startswith("-r ") else parent)
    return [entry for entry in found if "implementation_name == 'pypy'" not in entry.marker]


def _cuda(entries: list[_Entry], pinned: set[str]) -> set[str]:
    """Names of what only torch's CUDA build asks for: nobody else does, and it is not installed."""
    found: set[str] = set()
    while (
        more := {e.name for e in entries if e.via and set(e.via) <= {"torch", *found}}
        - pinned
        - found
    ):
        found |= more
    return found


def _expanded(extras: dict[str, list[str]], extra: str) -> list[str]:
    """An extra's requirements, with those of the extras it names."""
    found: list[str] = []
    for requirement in map(Requirement, extras[extra]):
        if requirement.name == PROJECT:
            for other in sorted(requirement.extras):
                found += _expanded(extras, other)
        else:
            found.append(str(requirement))
    return list(dict.fromkeys(found))


def licence_of(name: str) -> str:
    """The licence that a package states: its SPDX expression where it has one, else its own words.

    Raises:
        SystemExit: It states none, and `LICENCES` has none.
    """
    if name in LICENCES:
        return LICENCES[name]
    if name.startswith("nvidia-"):
        return "NVIDIA Proprietary Software"
    about = metadata.metadata(name)
    classifiers = about.get_all("Classifier") or []
    stated = [c.rpartition(" :: ")[2] for c in classifiers if c.startswith("License :: ")]
    classes = [c for c in stated if c != "OSI Approved" or len(stated) == 1]
    text = (about.get("License") or "").strip().removeprefix("UNKNOWN")
    short = text if len(text.splitlines()) == 1 else ""  # some have the whole licence there
    found = about.get("License-Expression") or short or "; ".join(classes)
    if not found:
        raise SystemExit(f"error: {name} states no licence: read it, and add it to LICENCES")
    return str(found)


def _torch_cpu(version: str) -> list[str]:
    """Digests of the CPU build.

    Raises:
        SystemExit: There is none of that version.
    """
    lines = TORCH_CPU.read_text(encoding="utf-8").splitlines()
    pairs = [line.split() for line in lines if line and not line.startswith("#")]
    found = [d for d, name in pairs if (m := _FILE.fullmatch(name)) and m[1] == version]
    if not found:
        raise SystemExit(
            f"error: {TORCH_CPU.name} has no file of torch {version}+cpu: see its first lines"
        )
    return found


def torch_files(place: str) -> dict[str, str]:
    """Name -> digest of the CPU builds that an index lists, or of one file.

    Args:
        place: Address or path of the index's page of torch, or path of a wheel.
    """
    path = Path(place)
    if path.suffix == ".whl":
        return {path.name: hashlib.sha256(path.read_bytes()).hexdigest()}
    if "://" not in place:
        place = path.resolve().as_uri()
    with urllib.request.urlopen(place) as page:
        text = page.read().decode()
    links = re.findall(r'href="[^"]*?([^/"]+\.whl)#sha256=([0-9a-f]{64})"', text)
    named = {urllib.parse.unquote(name): digest for name, digest in links}
    return {name: digest for name, digest in named.items() if _FILE.fullmatch(name)}


def add_torch_files(file: Path, found: dict[str, str]) -> None:
    """Put digests of the pinned version into scripts/torch_cpu.txt, and take other versions out.

    Raises:
        SystemExit: None is of the pinned version.
    """
    version = Version(metadata.version("torch")).public
    lines = file.read_text(encoding="utf-8").splitlines()
    known = {line.split()[1]: line.split()[0] for line in lines if line and line[0] != "#"}
    known |= found
    kept = {n: d for n, d in known.items() if (m := _FILE.fullmatch(n)) and m[1] == version}
    if not set(kept) & set(found):
        raise SystemExit(f"error: there is no file of torch {version}+cpu")
    notes = [line for line in lines if line.startswith("#")]
    files = [f"{digest}  {name}" for name, digest in sorted(kept.items())]
    file.write_text("\n".join([*notes, *files]) + "\n", encoding="utf-8")


def main(arguments: list[str] | None = None) -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--torch-cpu", metavar="PLACE", help="an index's page of torch, or a wheel")
    options = parser.parse_args(arguments)
    if options.torch_cpu:
        add_torch_files(TORCH_CPU, torch_files(options.torch_cpu))
        return
    found = closure(Requirement(f"{PROJECT}[dev]"))
    pins = "".join(sorted(f"{constraint(name, version)}\n" for name, version in found.items()))
    packages = locked(pins)
    CONSTRAINTS.write_text(HEADER + pins, encoding="utf-8")
    LOCK.write_text(LOCK_HEADER + "".join(p.lines() for p in packages), encoding="utf-8")
    PAGE.write_text(page(packages), encoding="utf-8")


if __name__ == "__main__":
    main()
