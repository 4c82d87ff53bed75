"""`scripts/locked.py` installs files whose hashes are locked, and no other; what the lock says."""

import hashlib
import importlib.metadata as metadata
import json
import os
import subprocess
import sys
import sysconfig
import venv
import zipfile
from pathlib import Path

import pytest
from packaging.markers import Marker
from packaging.requirements import Requirement

from scripts import licences, locked, pins

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def packages() -> list[locked.Package]:
    return locked.read()


class Index:
    """An index of packages in a folder, one folder beside it, and an environment that uses both."""

    def __init__(self, root: Path) -> None:
        self.root, self.links, self.python = root, root / "links", root / "env" / "bin" / "python"
        self.links.mkdir()
        venv.create(root / "env")
        version = f"python{sys.version_info.major}.{sys.version_info.minor}"
        site = root / "env" / "lib" / version / "site-packages"
        (site / "pip.pth").write_text(sysconfig.get_path("purelib") + "\n")
        self.site = site
        self.lock = root / "locked.txt"

    def wheel(self, name: str, version: str, needs: str = "", *, linked: bool = False) -> str:
        """Makes a wheel, in the index, which states its hash, or in the folder beside it."""
        folder = self.links if linked else self.root / "simple" / name
        folder.mkdir(parents=True, exist_ok=True)
        file = folder / f"{name}-{version}-py3-none-any.whl"
        info = f"{name}-{version}.dist-info"
        about = f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n{needs}"
        with zipfile.ZipFile(file, "w") as archive:
            archive.writestr(f"{name}_here.py", f"version = {version!r}\n")
            archive.writestr(f"{info}/METADATA", about)
            archive.writestr(f"{info}/WHEEL", "Wheel-Version: 1.0\nRoot-Is-Purelib: true\n")
            archive.writestr(f"{info}/RECORD", "")
        digest = hashlib.sha256(file.read_bytes()).hexdigest()
        if not linked:
            page = f'<a href="{file.name}#sha256={digest}">{file.name}</a>'
            (folder / "index.html").write_text(f"<!DOCTYPE html><html><body>{page}</body></html>")
        return f"sha256:{digest}"

    def locks(self, *packages: locked.Package) -> None:
        self.lock.write_text("# a comment\n" + "".join(p.lines() for p in packages))

    def install(self, *options: str) -> subprocess.CompletedProcess[str]:
        clean = {k: v for k, v in os.environ.items() if not k.startswith(("PIP", "PYTHON", "COV"))}
        clean |= {"PIP_CONFIG_FILE": os.devnull, "PIP_FIND_LINKS": str(self.links)}
        clean |= {"PIP_INDEX_URL": (self.root / "simple").as_uri(), "PIP_NO_CACHE_DIR": "1"}
        command = [self.python, locked.__file__, "install", "--lock", self.lock, *options]
        return subprocess.run(command, env=clean, capture_output=True, text=True, check=False)

    def installed(self) -> set[str]:
        return {path.name.removesuffix(".dist-info") for path in self.site.glob("*.dist-info")}


@pytest.fixture
def index(tmp_path: Path) -> Index:
    return Index(tmp_path)


def package(name: str, digests: str | list[str], *sets: str, via: str = "x") -> locked.Package:
    hashes = tuple([digests] if isinstance(digests, str) else digests)
    return locked.Package(name, "1.0", "", hashes, "MIT", sets or ("run",), (via,))


def test_a_file_with_another_hash_is_refused(index: Index) -> None:
    good = index.wheel("one", "1.0")
    index.locks(package("one", good), package("cudart", good, "torch-cuda"))
    done = index.install()
    assert done.returncode == 0, done.stderr
    assert index.installed() == {"one-1.0"}

    index.wheel("two", "1.0")
    index.locks(package("two", good), package("cudart", good, "torch-cuda"))
    done = index.install()
    assert done.returncode != 0
    assert "do not match the hashes" in done.stderr.lower().replace("\n", " ")
    assert index.installed() == {"one-1.0"}


def test_what_is_not_locked_is_not_installed(index: Index) -> None:
    """A package whose new metadata ask for another one brings nothing along."""
    digest = index.wheel("one", "1.0", "Requires-Dist: other\n")
    index.wheel("other", "1.0")
    index.locks(package("one", digest), package("cudart", digest, "torch-cuda"))
    assert index.install().returncode == 0
    assert index.installed() == {"one-1.0"}


def test_extras_and_single_packages(index: Index) -> None:
    digests = {name: index.wheel(name, "1.0") for name in ("one", "two", "three")}
    index.locks(
        package("one", digests["one"], "run"),
        package("two", digests["two"], "video", "robots"),
        package("three", digests["three"], "dev", via="two"),
        package("cudart", digests["one"], "torch-cuda"),
    )
    done = index.install("--only", "two")
    assert done.returncode == 0, done.stderr
    assert index.installed() == {"two-1.0", "three-1.0"}
    assert index.install("--extra", "video").returncode == 0
    assert index.installed() == {"one-1.0", "two-1.0", "three-1.0"}
    done = index.install("--extra", "films")
    assert done.returncode == 2
    allowed = "dev, robots, run, torch-cuda, video"
    assert done.stderr == f"error: films: not among {allowed}\n"


CUDA = "Requires-Dist: nvidia-cudart; platform_system == 'Linux'\n"


@pytest.mark.parametrize("reached", [True, False])
def test_the_cpu_build_of_torch_is_taken_where_pip_finds_it(index: Index, reached: bool) -> None:
    """A folder states no hash, the index does: pip alone would take the CUDA build from there."""
    hashes = [index.wheel("torch", "1.0", CUDA)]
    library = index.wheel("cudart", "1.0")
    if reached:
        hashes.append(index.wheel("torch", "1.0+cpu", linked=True))
    index.locks(package("torch", hashes), package("cudart", library, "torch-cuda"))
    done = index.install()
    assert done.returncode == 0, done.stderr
    both = {"torch-1.0", "cudart-1.0"}
    assert index.installed() == ({"torch-1.0+cpu"} if reached else both)


def test_a_line_that_is_not_ours_is_named(tmp_path: Path) -> None:
    file = tmp_path / "locked.txt"
    file.write_text(package("one", f"sha256:{'a' * 64}").lines() + "two\n")
    with pytest.raises(ValueError, match=r"locked.txt, line 6: not written by `make pins`: 'two'"):
        locked.read(file)


def test_the_lock_has_the_constraints(repo: Path, packages: list[locked.Package]) -> None:
    """The same versions; besides, what other systems and torch's CUDA build need."""
    lines = (repo / "constraints.txt").read_text().splitlines()
    asked = {r.name: r for line in lines if line[0] != "#" for r in [Requirement(line)]}
    names = {p.name for p in packages}
    assert set(asked) <= names
    for p in packages:
        if p.name in asked and (not p.marker or Marker(p.marker).evaluate()):
            assert p.version in asked[p.name].specifier, p.name
    for name in names - set(asked):
        (p,) = (p for p in packages if p.name == name)
        assert p.sets == (locked.CUDA,) or "sys_platform == 'darwin'" in p.marker, name
    assert all(len(p.hashes) == len(set(p.hashes)) >= 1 for p in packages)


def test_every_extra_is_locked_with_what_it_asks_for(packages: list[locked.Package]) -> None:
    """From the metadata of what is installed: nothing that `pip check` would miss."""
    for extra in ["", *metadata.metadata("embodichain").get_all("Provides-Extra", [])]:
        needed = pins.closure(Requirement(f"embodichain[{extra}]" if extra else "embodichain"))
        sets = [locked.RUN, *([extra] if extra else [])]
        assert set(needed) <= {p.name for p in locked.of_sets(packages, sets)}, extra


def test_torch_is_locked_with_both_builds(repo: Path, packages: list[locked.Package]) -> None:
    (torch,) = (p for p in packages if p.name == "torch")
    lines = (repo / "scripts" / "torch_cpu.txt").read_text().splitlines()
    files = dict(line.split()[::-1] for line in lines if line[0] != "#")
    assert {
        f"torch-{torch.version}+cpu-cp3{n}-cp3{n}-manylinux_2_28_x86_64.whl" for n in (11, 12, 13)
    } <= set(files)
    assert {f"sha256:{digest}" for digest in files.values()} < set(torch.hashes)


def test_hashes_of_the_cpu_build_come_from_its_index(tmp_path: Path) -> None:
    version = metadata.version("torch").partition("+")[0]
    name = f"torch-{version}+cpu-cp311-cp311-manylinux_2_28_x86_64.whl"
    escaped = name.replace("+", "%2B")
    links = [
        f'<a href="/whl/{escaped}#sha256={"a" * 64}" data-x="y">{name}</a>',
        f'<a href="torch-{version}-cp311-cp311-win_amd64.whl#sha256={"b" * 64}">another build</a>',
        f'<a href="torch-0.1%2Bcpu-cp311-cp311-win_amd64.whl#sha256={"c" * 64}">too old</a>',
    ]
    (tmp_path / "index.html").write_text("\n".join(links))
    found = pins.torch_files(str(tmp_path / "index.html"))
    assert found[name] == "a" * 64
    file = tmp_path / "torch_cpu.txt"
    file.write_text(f"# notes\n{'d' * 64}  torch-0.1+cpu-cp311-cp311-old.whl\n")
    pins.add_torch_files(file, found)
    assert file.read_text() == f"# notes\n{'a' * 64}  {name}\n"

    wheel = tmp_path / name.replace("cp311", "cp312")
    wheel.write_bytes(b"torch")
    pins.add_torch_files(file, pins.torch_files(str(wheel)))
    digest = hashlib.sha256(b"torch").hexdigest()
    assert file.read_text() == f"# notes\n{'a' * 64}  {name}\n{digest}  {wheel.name}\n"
    with pytest.raises(SystemExit, match=r"there is no file of torch .*\+cpu"):
        pins.add_torch_files(file, {})


def test_a_version_that_refuses_the_oldest_python_is_pinned_for_later_ones(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    said = {"Requires-Python": ">=3.11.5"}
    # No installed package refuses 3.11.0, the oldest Python.
    monkeypatch.setattr(metadata, "metadata", lambda name: said)
    assert pins.constraint("a", "2") == 'a==2; python_full_version >= "3.11.5"'
    said["Requires-Python"] = ">=3.9"
    assert pins.constraint("a", "2") == "a==2"


def test_licences_are_those_that_the_packages_state(packages: list[locked.Package]) -> None:
    here = {
        d.metadata["Name"].lower().replace("_", "-").replace(".", "-")
        for d in metadata.distributions()
    }
    for p in packages:
        if p.name in here:
            assert p.licence == pins.licence_of(p.name), p.name
    assert {p.licence for p in packages if p.name in ("torch", "numpy", "?")} >= {
        metadata.metadata("torch")["License-Expression"]
    }


def test_the_page_of_licences_is_of_the_lock(repo: Path, packages: list[locked.Package]) -> None:
    text = (repo / "docs" / "licences.md").read_text(encoding="utf-8")
    assert text == licences.page(packages)  # `make pins` writes both
    assert "\n| click | 8" in text.partition("## With an extra")[0]
    assert all(text.count(f"\n| {p.name} | {p.version} |") == 1 for p in packages)


def test_the_bill_of_materials_is_valid_and_complete(
    packages: list[locked.Package], tmp_path: Path
) -> None:
    # A second to import, in each process that collects the tests.
    from cyclonedx.schema import SchemaVersion
    from cyclonedx.validation.json import JsonStrictValidator

    from scripts import sbom

    wheel = tmp_path / "a.whl"
    wheel.write_bytes(b"wheel")
    text = sbom.bill(packages, wheel, "1.2.3", 1767323044)
    assert text == sbom.bill(packages, wheel, "1.2.3", 1767323044)
    assert JsonStrictValidator(SchemaVersion.V1_6).validate_str(text) is None
    found = json.loads(text)
    assert (found["bomFormat"], found["specVersion"]) == ("CycloneDX", "1.6")
    assert found["metadata"]["timestamp"] == "2026-01-02T03:04:04+00:00"
    root = found["metadata"]["component"]
    assert (root["name"], root["version"]) == ("embodichain", "1.2.3")
    digest = hashlib.sha256(b"wheel").hexdigest()
    assert root["hashes"] == [{"alg": "SHA-256", "content": digest}]

    components = {c["name"]: c for c in found["components"]}
    assert set(components) == {p.name for p in packages if set(p.sets) - {"dev", "docs"}}
    assert {"pytest", "ruff", "mkdocs"} & set(components) == set()
    click = components["click"]
    assert (click["purl"], click["scope"]) == ("pkg:pypi/click@8.5.1", "required")
    assert click["licenses"] == [{"license": {"id": "BSD-3-Clause"}}]
    (files,) = click["externalReferences"]
    locked_click = {h for p in packages if p.name == "click" for h in p.hashes}
    assert {f"sha256:{h['content']}" for h in files["hashes"]} == locked_click
    assert components["h5py"]["scope"] == "optional"
    extras = [p["value"] for p in components["h5py"]["properties"]]
    assert extras == ["export-log", "hdf5"]
    needs = {d["ref"]: d.get("dependsOn", []) for d in found["dependencies"]}
    assert click["bom-ref"] in needs[root["bom-ref"]]
    assert components["numpy"]["bom-ref"] in needs[components["scipy"]["bom-ref"]]
