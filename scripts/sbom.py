"""Write a release's bill of materials: CycloneDX 1.6, JSON, from locked.txt.

`make dist` puts it beside the wheel. It lists the versions that the tests ran with of everything a
user may install: the dependencies, those of each extra, and those of torch's CUDA build, each with
its licence, the sha256 of its files, and the packages that need it. The packages of development are
not listed. The same commit gives the same bytes.
"""

import argparse
import hashlib
import json
import sys
import uuid
from datetime import UTC, datetime
from pathlib import Path

from cyclonedx.contrib.license.factories import LicenseFactory
from cyclonedx.model import (
    ExternalReference,
    ExternalReferenceType,
    HashAlgorithm,
    HashType,
    Property,
    XsUri,
)
from cyclonedx.model.bom import Bom
from cyclonedx.model.component import Component, ComponentScope, ComponentType
from cyclonedx.output import make_outputter
from cyclonedx.schema import OutputFormat, SchemaVersion
from cyclonedx.validation.json import JsonStrictValidator
from packageurl import PackageURL

from scripts.licences import extras_of, released
from scripts.locked import RUN, Package, read

PROJECT = "embodichain"
SCHEMA = SchemaVersion.V1_6
_NAMESPACE = uuid.UUID("8f5c3f0e-6b0e-4f43-9b7b-3d3d9a9a2f51")  # drawn once, for serial numbers


def bill(packages: list[Package], wheel: Path, version: str, epoch: int) -> str:
    """Return the document, which is valid by its schema.

    Args:
        packages: All that is locked.
        wheel: The release's, whose sha256 is stated.
        version: The release's.
        epoch: Its time, in seconds since 1970.

    Raises:
        ValueError: If the schema does not allow it; with the first reason.
    """
    listed = released(packages)
    digest = hashlib.sha256(wheel.read_bytes()).hexdigest()
    licences = LicenseFactory()
    root = Component(
        name=PROJECT,
        version=version,
        type=ComponentType.LIBRARY,
        bom_ref=f"pkg:pypi/{PROJECT}@{version}",
        purl=PackageURL("pypi", name=PROJECT, version=version),
        licenses=[licences.make_from_string("MIT")],
        hashes=[_sha256(digest)],
    )
    bom = Bom(serial_number=uuid.uuid5(_NAMESPACE, digest))
    bom.metadata.component = root
    bom.metadata.timestamp = datetime.fromtimestamp(epoch, UTC)
    # A package may be listed twice, with versions for different systems.
    component_of = {package: _component(package, licences) for package in listed}
    bom.components.update(component_of.values())
    parents = [(PROJECT, root)]
    parents += [(package.name, component) for package, component in component_of.items()]
    for name, parent in parents:
        needed = [child for package, child in component_of.items() if name in package.via]
        bom.register_dependency(parent, needed)
    text = make_outputter(bom, OutputFormat.JSON, SCHEMA).output_as_string(indent=1)
    error = JsonStrictValidator(SCHEMA).validate_str(text)
    if error is not None:
        raise ValueError(f"not CycloneDX {SCHEMA.to_version()}: {error}")
    return text + "\n"


def _sha256(digest: str) -> HashType:
    return HashType(alg=HashAlgorithm.SHA_256, content=digest)


def _component(package: Package, licences: LicenseFactory) -> Component:
    """Return the component of a package; its files are at the index that the reader uses."""
    purl = PackageURL("pypi", name=package.name, version=package.version)
    properties = [Property(name=f"{PROJECT}:extra", value=n) for n in extras_of(package)]
    if package.marker:
        properties.append(Property(name=f"{PROJECT}:marker", value=package.marker))
    digests = [h.removeprefix("sha256:") for h in package.hashes]
    files = ExternalReference(
        type=ExternalReferenceType.DISTRIBUTION,
        url=XsUri(purl.to_string()),
        hashes=[_sha256(digest) for digest in digests],
    )
    scope = ComponentScope.OPTIONAL
    if RUN in package.sets:
        scope = ComponentScope.REQUIRED
    return Component(
        name=package.name,
        version=package.version,
        type=ComponentType.LIBRARY,
        bom_ref=purl.to_string(),
        purl=purl,
        scope=scope,
        licenses=[licences.make_from_string(package.licence)],
        external_references=[files],
        properties=properties,
    )


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; `scripts/release.py` calls it."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--lock", type=Path, required=True)
    parser.add_argument("--wheel", type=Path, required=True)
    parser.add_argument("--version", required=True)
    parser.add_argument("--epoch", type=int, required=True)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args(arguments)
    text = bill(read(options.lock), options.wheel, options.version, options.epoch)
    options.out.write_text(text, encoding="utf-8")
    print(f"{options.out}: {len(json.loads(text)['components'])} components")
    return 0


if __name__ == "__main__":
    sys.exit(main())
