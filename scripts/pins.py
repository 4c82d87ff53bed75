"""Write the exact versions that the tests run with, and their licences.

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
# Licences that the metadata of packages lack, from their licence files; and those of packages that
# are not installed on the machine that writes the file.
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
    """Find every distribution that `root` needs, without `root` itself.

    Args:
        root: The requirement to start from, with its extras.

    Returns:
        Canonical name to public version (no local part such as `+cpu`).

    Raises:
        importlib.metadata.PackageNotFoundError: If a needed distribution is not installed.
    """
    versions: dict[str, str] = {}
    seen: set[tuple[str, str]] = set()
    unread = [root]
    while unread:
        requirement = unread.pop()
        name = canonicalize_name(requirement.name)
        versions[name] = Version(metadata.version(name)).public
        for extra in {"", *requirement.extras}:
            if (name, extra) not in seen:
                seen.add((name, extra))
                unread += _requirements_of(name, extra)
    del versions[canonicalize_name(root.name)]
    return dict(sorted(versions.items()))


def _requirements_of(name: str, extra: str) -> list[Requirement]:
    """Return what `name[extra]` asks for on this machine."""
    environment = {**default_environment(), "extra": extra}
    requirements = map(Requirement, metadata.requires(name) or [])
    return [r for r in requirements if r.marker is None or r.marker.evaluate(environment)]


def constraint(name: str, version: str) -> str:
    """Return the line of constraints.txt.

    A version that does not support our oldest Python is a constraint of later ones only; for the
    oldest, pip chooses a version.
    """
    pythons = SpecifierSet(metadata.metadata(name).get("Requires-Python") or "")
    if pythons.contains(LOWEST):
        return f"{name}=={version}"
    lowest = max(Version(s.version) for s in pythons if s.operator == ">=")
    return f'{name}=={version}; python_full_version >= "{lowest}"'


def locked(constraints: str) -> list[Package]:
    """Resolve the dependencies for every system, within the constraints.

    Raises:
        subprocess.CalledProcessError: If uv finds no solution; it has printed why.
    """
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras: dict[str, list[str]] = project["optional-dependencies"]
    everything = [*project["dependencies"], *_expand_extra(extras, "dev")]
    entries = _read_entries(_resolve(everything, constraints, "--generate-hashes"))
    names_by_set = _names_by_set(project["dependencies"], extras, entries)
    pinned_names = {line.partition("==")[0] for line in constraints.splitlines()}
    cuda = _names_for_cuda(entries, pinned_names)
    (torch_version,) = (entry.version for entry in entries if entry.name == "torch")
    packages = []
    for entry in entries:
        hashes = list(entry.hashes)
        if entry.name == "torch":
            hashes += [f"sha256:{digest}" for digest in _torch_cpu_digests(torch_version)]
        sets = [name for name, names in names_by_set.items() if entry.name in names]
        if entry.name in cuda:
            sets = [CUDA]
        elif RUN in sets:
            sets = [RUN]
        package = Package(
            name=entry.name,
            version=entry.version,
            marker=entry.marker,
            hashes=tuple(sorted(hashes)),
            licence=licence_of(entry.name),
            sets=tuple(sorted(sets)),
            via=tuple(sorted(set(entry.via))),
        )
        packages.append(package)
    return packages


@dataclass
class _Entry:
    """A version in the output of uv; attributes as of `Package`."""

    name: str
    version: str
    marker: str
    hashes: list[str] = field(default_factory=list)
    via: list[str] = field(default_factory=list)

    def pin(self) -> str:
        """Return the requirement of exactly this version."""
        marker = f" ; {self.marker}" if self.marker else ""
        return f"{self.name}=={self.version}{marker}"


def _names_by_set(
    dependencies: list[str], extras: dict[str, list[str]], entries: list[_Entry]
) -> dict[str, set[str]]:
    """Return the names of packages that the project needs, and each of its extras.

    Args:
        dependencies: Requirements of the project.
        extras: Requirements of its extras.
        entries: The versions of all of them.
    """
    pins = "".join(f"{entry.pin()}\n" for entry in entries)
    requirements = {RUN: dependencies}
    for name in extras:
        requirements[name] = _expand_extra(extras, name)
    return {
        name: {entry.name for entry in _read_entries(_resolve(needed, pins))}
        for name, needed in requirements.items()
    }


def _resolve(requirements: list[str], constraints: str, *options: str) -> str:
    """Resolve requirements for every system; return them with hashes, as uv writes them."""
    with tempfile.TemporaryDirectory() as folder:
        pins = Path(folder, "constraints.txt")
        pins.write_text(constraints, encoding="utf-8")
        source = Path(folder, "requirements.in")
        source.write_text("\n".join(requirements), encoding="utf-8")
        command = [sys.executable, "-m", "uv", "pip", "compile", "--universal", "--quiet"]
        command += ["--python-version", LOWEST, "--no-header", "--no-emit-index-url", *options]
        command += ["-c", str(pins), str(source)]
        process = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
    return process.stdout


def _read_entries(text: str) -> list[_Entry]:
    """Read the output of uv; packages that only PyPy needs are left out."""
    entries: list[_Entry] = []
    for line in text.splitlines():
        if match := _ENTRY.match(line):
            entries.append(_Entry(match[1], match[2], match[3] or ""))
        elif "--hash=" in line:
            entries[-1].hashes.append(line.strip(" \\").removeprefix("--hash="))
        else:
            parent = line.strip(" #").removeprefix("via").strip()
            if parent and not parent.startswith("-c "):
                entries[-1].via.append(PROJECT if parent.startswith("-r ") else parent)
    return [entry for entry in entries if "implementation_name == 'pypy'" not in entry.marker]


def _names_for_cuda(entries: list[_Entry], pinned_names: set[str]) -> set[str]:
    """Return names of packages that only torch's CUDA build asks for, directly or not.

    No other package asks for them, and they are not installed.
    """
    names: set[str] = set()
    while True:
        more = {e.name for e in entries if e.via and set(e.via) <= {"torch", *names}}
        more -= pinned_names | names
        if not more:
            return names
        names |= more


def _expand_extra(extras: dict[str, list[str]], extra: str) -> list[str]:
    """Return the requirements of an extra, and of the extras that it names."""
    requirements: list[str] = []
    for requirement in map(Requirement, extras[extra]):
        if requirement.name == PROJECT:
            for other in sorted(requirement.extras):
                requirements += _expand_extra(extras, other)
        else:
            requirements.append(str(requirement))
    return list(dict.fromkeys(requirements))


def licence_of(name: str) -> str:
    """Return the licence that a package states: its SPDX expression if it has one.

    Raises:
        SystemExit: If it states none, and `LICENCES` has none.
    """
    if name in LICENCES:
        return LICENCES[name]
    if name.startswith("nvidia-"):
        return "NVIDIA Proprietary Software"
    about = metadata.metadata(name)
    classifiers = about.get_all("Classifier") or []
    classes = [c.rpartition(" :: ")[2] for c in classifiers if c.startswith("License :: ")]
    if len(classes) > 1:
        classes = [c for c in classes if c != "OSI Approved"]
    text = (about.get("License") or "").strip().removeprefix("UNKNOWN")
    if len(text.splitlines()) != 1:  # some have the text of the licence there
        text = ""
    licence = about.get("License-Expression") or text or "; ".join(classes)
    if not licence:
        raise SystemExit(f"error: {name} states no licence: read it, and add it to LICENCES")
    return str(licence)


def _read_torch_cpu(lines: list[str]) -> dict[str, str]:
    """Return name -> digest of the files that lines of scripts/torch_cpu.txt list."""
    pairs = [line.split() for line in lines if line and not line.startswith("#")]
    return {name: digest for digest, name in pairs}


def _is_of_version(file: str, version: str) -> bool:
    """Whether a file is torch's CPU build of a version."""
    match = _FILE.fullmatch(file)
    return match is not None and match[1] == version


def _torch_cpu_digests(version: str) -> list[str]:
    """Return the digests of torch's CPU build.

    Raises:
        SystemExit: If there is none of that version.
    """
    files = _read_torch_cpu(TORCH_CPU.read_text(encoding="utf-8").splitlines())
    digests = [digest for name, digest in files.items() if _is_of_version(name, version)]
    if not digests:
        raise SystemExit(
            f"error: {TORCH_CPU.name} has no file of torch {version}+cpu: see its first lines"
        )
    return digests


def torch_files(place: str) -> dict[str, str]:
    """Return name -> digest of the CPU builds that an index lists, or of one file.

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
    digest_of = {urllib.parse.unquote(name): digest for name, digest in links}
    return {name: digest for name, digest in digest_of.items() if _FILE.fullmatch(name)}


def add_torch_files(file: Path, new_files: dict[str, str]) -> None:
    """Put digests of the pinned version into scripts/torch_cpu.txt, and take other versions out.

    Args:
        file: The list.
        new_files: Name -> digest.

    Raises:
        SystemExit: If none is of the pinned version.
    """
    version = Version(metadata.version("torch")).public
    lines = file.read_text(encoding="utf-8").splitlines()
    digest_of = _read_torch_cpu(lines) | new_files
    names = sorted(name for name in digest_of if _is_of_version(name, version))
    if not set(names) & set(new_files):
        raise SystemExit(f"error: there is no file of torch {version}+cpu")
    notes = [line for line in lines if line.startswith("#")]
    files = [f"{digest_of[name]}  {name}" for name in names]
    file.write_text("\n".join([*notes, *files]) + "\n", encoding="utf-8")


def main(arguments: list[str] | None = None) -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--torch-cpu", metavar="PLACE", help="an index's page of torch, or a wheel")
    options = parser.parse_args(arguments)
    if options.torch_cpu:
        add_torch_files(TORCH_CPU, torch_files(options.torch_cpu))
        return
    versions = closure(Requirement(f"{PROJECT}[dev]"))
    pins = "".join(sorted(f"{constraint(name, version)}\n" for name, version in versions.items()))
    packages = locked(pins)
    CONSTRAINTS.write_text(HEADER + pins, encoding="utf-8")
    LOCK.write_text(LOCK_HEADER + "".join(p.lines() for p in packages), encoding="utf-8")
    PAGE.write_text(page(packages), encoding="utf-8")


if __name__ == "__main__":
    main()
