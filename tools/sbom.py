# SPDX-License-Identifier: GPL-3.0-or-later
"""The list of what a zip holds beside our own code, as CycloneDX (an SBOM): each part with its hash, licence and owners."""
from __future__ import annotations

import uuid
from datetime import datetime
from pathlib import Path

import wheels
from cyclonedx.model import HashAlgorithm, HashType
from cyclonedx.model.bom import Bom, BomMetaData
from cyclonedx.model.component import Component, ComponentType
from cyclonedx.model.license import DisjunctiveLicense, LicenseExpression
from cyclonedx.output.json import JsonV1Dot6
from packageurl import PackageURL

EXAMPLES = ("examples/cameras.json", "examples/fireside.safetensors")


def text(manifest: dict, bundled: list[Path], stage: Path, made: datetime) -> str:
    """The JSON for a zip with this manifest, these wheels and the files in the folder `stage`; the same words each time."""
    extension = Component(name=manifest["id"], version=manifest["version"], type=ComponentType.APPLICATION, bom_ref=manifest["id"],
                          licenses=[DisjunctiveLicense(id="GPL-3.0-or-later")], copyright=manifest["copyright"][0])
    parts = [*(_example(stage, name) for name in EXAMPLES), *map(_wheel, bundled)]
    number = uuid.uuid5(uuid.NAMESPACE_URL, f"{manifest['id']} {[(part.name, *map(str, part.hashes)) for part in parts]}")
    bom = Bom(components=parts, metadata=BomMetaData(component=extension, timestamp=made), serial_number=number)
    bom.register_dependency(extension, parts)
    return JsonV1Dot6(bom).output_as_string(indent=2) + "\n"


def _example(stage: Path, name: str) -> Component:
    path = stage / name
    return Component(name=path.name, type=ComponentType.DATA, bom_ref=path.name, hashes=[_hash(path)],
                     licenses=[DisjunctiveLicense(id="CC0-1.0")])


def _wheel(path: Path) -> Component:
    facts = wheels.metadata(path)
    return Component(name=facts["Name"], version=facts["Version"], type=ComponentType.LIBRARY, bom_ref=path.name, hashes=[_hash(path)],
                     licenses=[LicenseExpression(wheels.licence(path))], copyright="; ".join(wheels.holders([path])),
                     purl=PackageURL("pypi", None, facts["Name"].lower(), facts["Version"], {"file_name": path.name}))


def _hash(path: Path) -> HashType:
    return HashType(alg=HashAlgorithm.SHA_256, content=wheels.digest(path))
