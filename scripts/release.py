"""Build the files of a release, and move the changelog's entries under its heading.

`python scripts/release.py prepare 0.1.0` writes the version into `embodichain/__init__.py` and
CITATION.cff, and makes a dated section of the changelog's *Unreleased*; commit that, and tag the
commit ``v0.1.0``.

`python scripts/release.py build` (`make dist`) builds sdist, wheel, bill of materials and
SHA256SUMS into ``dist/`` from the files of the commit, never from the working tree. The same commit
gives the same bytes: times are the commit's, owners and modes are fixed, and the tools are those of
locked.txt. It refuses a dirty tree, and a tag, version and changelog that differ; ``--tag v0.1.0``
insists on the tag. The exit code is 2 for these.
"""

from __future__ import annotations

import argparse
import gzip
import hashlib
import io
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
from datetime import UTC, datetime
from pathlib import Path

ROOT = Path(__file__).parents[1]
VERSION_FILE = Path("embodichain", "__init__.py")
CHANGELOG = Path("CHANGELOG.md")
CITATION = Path("CITATION.cff")
LOCK = Path("locked.txt")
SUMS = "SHA256SUMS"
UNRELEASED = "## [Unreleased]"
_VERSION = re.compile(r'^__version__ = "([^"]+)"$', re.MULTILINE)
_CITED = re.compile(r"^(?:version|date-released):.*\n?", re.MULTILINE)
_HEADING = re.compile(r"^## \[([^\]]+)\](?: - (\d{4}-\d{2}-\d{2}))?$", re.MULTILINE)
_ALLOWED = re.compile(r"\d+\.\d+\.\d+(?:(?:a|b|rc)\d+)?")  # of PEP 440, what this project uses


class ReleaseError(Exception):
    """The release cannot be made; the message says why."""


def version_of(root: Path) -> str:
    """Read the version in the source.

    Raises:
        ReleaseError: If there is none, or several.
    """
    versions: list[str] = _VERSION.findall((root / VERSION_FILE).read_text(encoding="utf-8"))
    if len(versions) != 1:
        raise ReleaseError(f"{VERSION_FILE}: {len(versions)} lines with __version__, not one")
    return versions[0]


def prepare(root: Path, version: str, date: str) -> None:
    """Write a version and its dated section.

    A section of that version that was never tagged is a draft: the entries join it.

    Raises:
        ReleaseError: If the version or the date is malformed, the version is tagged already, or
            nothing is unreleased.
    """
    if not _ALLOWED.fullmatch(version):
        raise ReleaseError(f"{version!r} is not MAJOR.MINOR.PATCH, with a1, b1 or rc1 at most")
    if not re.fullmatch(r"\d{4}-\d{2}-\d{2}", date):
        raise ReleaseError(f"{date!r} is not YYYY-MM-DD")
    if git(root, "tag", "--list", f"v{version}"):
        raise ReleaseError(f"v{version} is tagged already")
    text = (root / CHANGELOG).read_text(encoding="utf-8")
    before, mark, after = text.partition(f"{UNRELEASED}\n")
    if not mark or not re.search(r"^- \S", _HEADING.split(after)[0], re.MULTILINE):
        raise ReleaseError(f"{CHANGELOG}: nothing is listed under {UNRELEASED!r}")
    draft = re.compile(rf"^## \[{re.escape(version)}\].*\n\n?", re.MULTILINE)
    dated = f"{before}{mark}\n## [{version}] - {date}\n{draft.sub('', after)}"
    version_of(root)
    source = (root / VERSION_FILE).read_text(encoding="utf-8")
    citation = _CITED.sub("", (root / CITATION).read_text(encoding="utf-8")).rstrip("\n")
    (root / CITATION).write_text(
        f"{citation}\nversion: {version}\ndate-released: {date}\n", encoding="utf-8"
    )
    (root / CHANGELOG).write_text(dated, encoding="utf-8")
    source = _VERSION.sub(f'__version__ = "{version}"', source)
    (root / VERSION_FILE).write_text(source, encoding="utf-8")


def check(root: Path, tag: str | None = None) -> str | None:
    """Check that the commit can be built.

    Args:
        root: The checkout.
        tag: The tag that the commit must have; None allows any, and none.

    Returns:
        The tag, or None if the commit has none.

    Raises:
        ReleaseError: If something is not committed, or tag, version and changelog differ.
    """
    dirty = git(root, "status", "--porcelain").splitlines()
    if dirty:
        names = ", ".join(line[3:] for line in dirty[:3])
        if len(dirty) > 3:
            names += f" and {len(dirty) - 3} more"
        raise ReleaseError(f"not committed: {names}")
    tags = [name for name in git(root, "tag", "--points-at", "HEAD").split() if name[0] == "v"]
    if tag is not None and tag not in tags:
        listed_tags = ", ".join(tags) or "none"
        raise ReleaseError(f"HEAD does not have the tag {tag} (it has: {listed_tags})")
    if tag is None and tags:
        tag = tags[0]
    if tag is None:
        return None
    version = version_of(root)
    if tag != f"v{version}":
        raise ReleaseError(f"the tag is {tag}, {VERSION_FILE} has {version}")
    if f"\nversion: {version}\n" not in (root / CITATION).read_text(encoding="utf-8"):
        raise ReleaseError(f"{CITATION} does not have version: {version}")
    headings = dict(_HEADING.findall((root / CHANGELOG).read_text(encoding="utf-8")))
    if not headings.get(version):
        raise ReleaseError(f"{CHANGELOG} has no dated heading '## [{version}] - YYYY-MM-DD'")
    return tag


def git(root: Path, *arguments: str) -> str:
    """Run git, and return what it prints."""
    command = ["git", "-C", str(root), *arguments]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.rstrip("\n")


def build(tree: Path, out: Path, epoch: int) -> list[Path]:
    """Build a tree of source files: the sdist, the wheel from it, and the bill of materials.

    Args:
        tree: The files, as in a checkout; setuptools writes into it.
        out: Folder for the distributions; those of the same names are replaced.
        epoch: Time of all files inside, in seconds since 1970.

    Returns:
        sdist, wheel, bill of materials (`scripts/sbom.py`) and SHA256SUMS.

    Raises:
        ReleaseError: If a build fails; with its output.
    """
    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        _run_build("--sdist", tree, work, epoch)
        (built_sdist,) = work.glob("*.tar.gz")
        sdist = out / built_sdist.name
        sdist.write_bytes(_normalize(built_sdist, epoch))
        with tarfile.open(sdist) as archive:
            archive.extractall(work / "source", filter="data")
        (source,) = (work / "source").iterdir()
        _run_build("--wheel", source, work / "wheel", epoch)
        (built_wheel,) = (work / "wheel").glob("*.whl")
        wheel = out / built_wheel.name
        shutil.move(built_wheel, wheel)
    version = version_of(tree)
    bill = out / f"embodichain-{version}.cdx.json"
    options = [
        f"--lock={tree / LOCK}",
        f"--wheel={wheel}",
        f"--version={version}",
        f"--epoch={epoch}",
        f"--out={bill}",
    ]
    _run("bill of materials", ["scripts.sbom", *options], epoch)
    sums = out / SUMS
    files = (wheel, sdist, bill)
    lines = [f"{hashlib.sha256(p.read_bytes()).hexdigest()}  {p.name}" for p in files]
    sums.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return [sdist, wheel, bill, sums]


def _run_build(option: str, source: Path, out: Path, epoch: int) -> None:
    """Build a distribution, ``--sdist`` or ``--wheel``."""
    module = ["build", "--no-isolation", option, f"--outdir={out}", str(source)]
    _run(option.removeprefix("--"), module, epoch)


def _run(title: str, module: list[str], epoch: int) -> None:
    """Run a module in a process of its own.

    Args:
        title: What it makes, for the message.
        module: Its name and arguments.
        epoch: Time of the files that it makes, in seconds since 1970.

    Raises:
        ReleaseError: If it fails; with its output.
    """
    process = subprocess.run(
        [sys.executable, "-m", *module],
        capture_output=True,
        text=True,
        env={**os.environ, "SOURCE_DATE_EPOCH": str(epoch)},
        check=False,
        umask=0o022,
        cwd=ROOT,
    )
    if process.returncode:
        raise ReleaseError(f"{title}: {process.stdout[-2000:]}{process.stderr[-2000:]}")


def _normalize(sdist: Path, epoch: int) -> bytes:
    """Return an sdist with sorted members, fixed owners and modes, and one time."""
    packed = io.BytesIO()
    with (
        tarfile.open(sdist) as old,
        gzip.GzipFile("", "wb", 9, packed, mtime=epoch) as zipped,
        tarfile.open(fileobj=zipped, mode="w", format=tarfile.PAX_FORMAT) as new,
    ):
        for member in sorted(old.getmembers(), key=lambda member: member.name):
            is_executable = member.isdir() or bool(member.mode & 0o100)
            member.mode = 0o755 if is_executable else 0o644
            member.mtime = epoch
            member.pax_headers = {}
            member.uid = 0
            member.gid = 0
            member.uname = ""
            member.gname = ""
            content = old.extractfile(member) if member.isreg() else None
            new.addfile(member, content)
    return packed.getvalue()


def main(arguments: list[str] | None = None) -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    verbs = parser.add_subparsers(dest="verb", required=True)
    prepare_parser = verbs.add_parser("prepare", help="write version and changelog")
    prepare_parser.add_argument("version")
    prepare_parser.add_argument("--date", default=f"{datetime.now(UTC):%Y-%m-%d}")
    build_parser = verbs.add_parser("build", help="sdist, wheel, bill of materials, checksums")
    build_parser.add_argument("--tag", help="the tag that the commit must have")
    build_parser.add_argument("--out", type=Path, default=ROOT / "dist")
    for verb in (prepare_parser, build_parser):
        verb.add_argument("--root", type=Path, default=ROOT, help="the checkout")
    options = parser.parse_args(arguments)
    root = options.root
    try:
        if options.verb == "prepare":
            prepare(root, options.version, options.date)
            print(f"{CHANGELOG}, {VERSION_FILE}, {CITATION}: {options.version}; now:")
            print(f"  git commit -am 'release: {options.version}' && git tag v{options.version}")
            return 0
        tag = check(root, options.tag)
        with tempfile.TemporaryDirectory() as folder:
            tree = Path(folder, "tree")
            archive = subprocess.run(
                ["git", "-C", root, "archive", "HEAD"], check=True, capture_output=True
            )
            with tarfile.open(fileobj=io.BytesIO(archive.stdout)) as files:
                files.extractall(tree, filter="tar")
            epoch = int(git(root, "log", "-1", "--format=%ct"))
            paths = build(tree, options.out.resolve(), epoch)
    except ReleaseError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(f"{version_of(root)}, {tag or 'without a tag: not a release'}:")
    print("\n".join(f"  {path}" for path in paths))
    return 0


if __name__ == "__main__":
    sys.exit(main())
