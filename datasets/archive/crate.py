"""Descriptions of a bundle for machines: RO-Crate 1.1 (Zenodo, WorkflowHub) and Croissant 1.0 (Hugging Face)."""

import json
import re
from collections.abc import Mapping, Sequence
from hashlib import sha256
from importlib.metadata import version
from typing import Any

from stillpoint.datasets.archive.selection import INDEX_COLUMNS, About, Item, list_citations
from stillpoint.datasets.errors import BadParameter

_MEDIA_TYPES = {
    ".mcap": "application/octet-stream",  # MCAP has no registered type
    ".json": "application/json",
    ".csv": "text/csv",
    ".md": "text/markdown",
    ".html": "text/html",
    ".cff": "text/yaml",
    ".sh": "text/x-shellscript",
    ".txt": "text/plain",
}
_SPDX = {
    "cc by 4.0": "CC-BY-4.0",
    "cc by-sa 4.0": "CC-BY-SA-4.0",
    "cc0 1.0": "CC0-1.0",
    "cc0": "CC0-1.0",
    "cecill 2.1": "CECILL-2.1",
    "apache 2.0": "Apache-2.0",
    "mit": "MIT",
    "eupl 1.2": "EUPL-1.2",
}
_MCAP_FORMAT = "https://mcap.dev/spec"
_MISSING = "{} needs the extra publish ({}); install it: pip install 'stillpoint[publish]'"


def _find_licence_url(licence: str) -> str | None:
    """Return the page of a licence at SPDX, None for one that is not known here."""
    known = _SPDX.get(licence.lower()) or (licence if licence in _SPDX.values() else None)
    return None if known is None else f"https://spdx.org/licenses/{known}"


def make_ro_crate(items: Sequence[Item], about: About, texts: Mapping[str, bytes]) -> bytes:
    """Return ``ro-crate-metadata.json``: every file with its hash, its licence, and what it is based on."""
    try:
        from rocrate.model.contextentity import ContextEntity
        from rocrate.rocrate import ROCrate
    except ImportError as error:
        raise BadParameter(_MISSING.format("RO-Crate", error)) from None
    crate: Any = ROCrate(version="1.1")
    crate.name, crate.description = about.title, about.description or about.title
    crate.datePublished = about.published
    licences = {
        licence: crate.add(
            ContextEntity(
                crate,
                _find_licence_url(licence) or f"#licence-{_make_identifier(licence)}",
                properties={"@type": "CreativeWork", "name": licence},
            )
        )
        for licence in sorted({licence for item in items for licence in item.licences})
    }
    every = list(licences.values())
    crate.license = every if every else "no licence is stated; see LICENSES.md"
    crate.creator = [
        crate.add(ContextEntity(crate, f"#author-{_make_identifier(name)}", {"@type": "Person", "name": name}))
        for name in about.authors
    ]
    made_by = crate.add(
        ContextEntity(
            crate,
            "#stillpoint",
            {"@type": "SoftwareApplication", "name": "stillpoint", "softwareVersion": version("stillpoint")},
        )
    )
    files = {item.entry.sha256: crate.add_file(dest_path=item.path) for item in items}
    for item in items:
        file = files[item.entry.sha256]
        properties: dict[str, Any] = {
            "name": item.entry.file_name,
            "description": f"{item.entry.kind} {item.entry.name}",
            "encodingFormat": _find_media_type(item.path),
            "contentSize": str(item.entry.size),
            "sha256": item.entry.sha256,
        }
        file.properties().update(properties)
        if item.path.endswith(".mcap"):
            file["conformsTo"] = {"@id": _MCAP_FORMAT}
        if item.licences:
            file["license"] = [licences[licence] for licence in item.licences]
        based_on = [files[parent] for _, parent in item.parents if parent in files]
        if based_on:
            file["isBasedOn"] = based_on
            file["creator"] = made_by
    for path, data in texts.items():
        properties = {"encodingFormat": _find_media_type(path), "contentSize": str(len(data))}
        crate.add_file(dest_path=path, properties={**properties, "sha256": sha256(data).hexdigest()})
    return _to_bytes(crate.metadata.generate())


def make_croissant(items: Sequence[Item], about: About, index: bytes) -> bytes:
    """Return ``croissant.json``: every object with its hash, and ``index.csv`` as a set of records."""
    try:
        import mlcroissant as mlc
    except ImportError as error:
        raise BadParameter(_MISSING.format("Croissant", error)) from None
    table = mlc.FileObject(
        id="index.csv",
        name="index.csv",
        content_url="index.csv",
        content_size=f"{len(index)} B",
        encoding_formats=["text/csv"],
        sha256=sha256(index).hexdigest(),
    )
    objects = [
        mlc.FileObject(
            id=item.path,
            name=item.path,
            description=f"{item.entry.kind} {item.entry.name}",
            content_url=item.path,
            content_size=f"{item.entry.size} B",
            encoding_formats=[_find_media_type(item.path)],
            sha256=item.entry.sha256,
        )
        for item in items
    ]
    numbers = {"size": mlc.DataType.INTEGER, "samples": mlc.DataType.FLOAT}
    numbers |= dict.fromkeys(("duration_s", "rate_hz", "sd_median_deg"), mlc.DataType.FLOAT)
    fields = [
        mlc.Field(
            id=f"objects/{name}",
            name=name,
            description=name,
            data_types=[numbers.get(name, mlc.DataType.TEXT)],
            source=mlc.Source(file_object="index.csv", extract=mlc.Extract(column=name)),
        )
        for name in INDEX_COLUMNS
    ]
    licences = sorted({licence for item in items for licence in item.licences})
    metadata = mlc.Metadata(
        name=_make_identifier(about.title),
        description=about.description or about.title,
        license=[_find_licence_url(licence) or licence for licence in licences] or ["not stated"],
        url=about.url or f"https://example.org/{_make_identifier(about.title)}",
        cite_as="; ".join(list_citations(items)) or about.title,
        creators=[mlc.Person(name=name) for name in about.authors],
        date_published=about.published,
        version="1.0.0",
        distribution=[table, *objects],
        record_sets=[mlc.RecordSet(id="objects", name="objects", description="One row per file.", fields=fields)],
    )
    return _to_bytes(metadata.to_json())


def _make_identifier(text: str) -> str:
    """Return text as an identifier of letters, digits, ``_``, ``.`` and ``-``."""
    return re.sub(r"[^A-Za-z0-9_.-]+", "-", text).strip("-") or "dataset"


def _find_media_type(path: str) -> str:
    return next((kind for suffix, kind in _MEDIA_TYPES.items() if path.endswith(suffix)), "application/octet-stream")


def _to_bytes(content: Any) -> bytes:
    return (json.dumps(content, indent=1, ensure_ascii=False, default=str) + "\n").encode()
