"""A bundle for publication: objects, manifest, citation, licences, RO-Crate and Croissant, and how to reproduce it."""

import csv
import io
import json
from collections.abc import Mapping, Sequence
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path

from stillpoint.datasets.archive.crate import make_croissant, make_ro_crate
from stillpoint.datasets.archive.selection import INDEX_COLUMNS, About, Item, list_citations

MANIFEST = "manifest.json"
CHECKSUMS = "manifest-sha256.txt"
STUDY_SUFFIX = ".study.toml"  # beside the JSON of a leaderboard: repeats it from the bundle
FORMAT = 1
_ACROSS_KINDS_RAD = 1e-7  # between references of two kinds of processors: forty times what was seen (docs/archive.md)


def bundle_files(items: Sequence[Item], about: About, extra: Mapping[str, bytes]) -> dict[str, Path | bytes]:
    """Return every file of a bundle: objects as paths of their bytes, everything else as bytes.

    ``extra`` holds further files, such as the page of a leaderboard. Needs the extra ``publish``; raises
    :class:`~stillpoint.datasets.errors.BadParameter` without it.
    """
    texts: dict[str, bytes] = {
        "README.md": _format_readme(items, about).encode(),
        "CITATION.cff": _format_citation(items, about).encode(),
        "LICENSES.md": _format_licences(items).encode(),
        "REPRODUCE.md": _format_instructions(items).encode(),
        "reproduce.sh": _make_script(items).encode(),
        "index.csv": _make_index(items).encode(),
        **extra,
    }
    texts[MANIFEST] = _make_manifest(items, about, texts).encode()
    texts["croissant.json"] = make_croissant(items, about, texts["index.csv"])
    texts["ro-crate-metadata.json"] = make_ro_crate(items, about, texts)
    sums = {item.path: item.entry.sha256 for item in items} | {
        path: sha256(data).hexdigest() for path, data in texts.items()
    }
    texts[CHECKSUMS] = "".join(f"{digest}  {path}\n" for path, digest in sorted(sums.items())).encode()
    return {**{item.path: item.source for item in items}, **texts}


def _make_manifest(items: Sequence[Item], about: About, texts: Mapping[str, bytes]) -> str:
    """Return the list of all files with their hashes, from which `archive import` takes a bundle in."""
    objects = [
        {
            "path": item.path,
            "sha256": item.entry.sha256,
            "size": item.entry.size,
            "kind": item.entry.kind,
            "name": item.entry.name,
            "file_name": item.entry.file_name,
            "added": item.entry.added,
            "licences": list(item.licences),
            "tags": sorted(item.record.tags),
            "metadata": dict(item.record.metadata),
            "made_from": [{"name": name, "sha256": parent} for name, parent in item.parents],
        }
        for item in items
    ]
    files = [{"path": path, "sha256": sha256(data).hexdigest(), "size": len(data)} for path, data in texts.items()]
    content = {
        "format": FORMAT,
        "stillpoint": version("stillpoint"),
        "title": about.title,
        "date": about.published,
        "objects": objects,
        "files": files,
    }
    return json.dumps(content, indent=1, ensure_ascii=False) + "\n"


def _make_index(items: Sequence[Item]) -> str:
    """Return one row per object, for people and for the record set of Croissant."""
    out = io.StringIO()
    table = csv.writer(out, lineterminator="\n")
    table.writerow(INDEX_COLUMNS)
    for item in items:
        named = {"path": item.path, "licence": "; ".join(item.licences)}
        fixed = {name: getattr(item.entry, name) for name in ("sha256", "size", "kind", "name")}
        row = {**item.entry.columns, **fixed, **named}
        table.writerow(["" if row.get(name) is None else row[name] for name in INDEX_COLUMNS])
    return out.getvalue()


def _format_citation(items: Sequence[Item], about: About) -> str:
    """Return CITATION.cff 1.2.0; strings are JSON strings, which YAML reads."""
    lines = [
        "cff-version: 1.2.0",
        "message: If you use this dataset, cite it and the sources under references.",
        "type: dataset",
        f"title: {_quote(about.title)}",
        f"date-released: {_quote(about.published)}",
        *([f"url: {_quote(about.url)}"] if about.url else []),
        "authors:",
        *(f"  - name: {_quote(author)}" for author in about.authors or ("The authors of the sources",)),
    ]
    citations = list_citations(items)
    if citations:
        lines.append("references:")
    for text in citations:
        authors, title = _split_citation(text)
        lines += [
            "  - type: generic",
            f"    title: {_quote(title)}",
            "    authors:",
            f"      - name: {_quote(authors)}",
        ]
    return "\n".join(lines) + "\n"


def _split_citation(text: str) -> tuple[str, str]:
    """Return authors and title of a citation ``AUTHORS: TITLE``."""
    authors, colon, title = text.partition(": ")
    return (authors, title) if colon else ("see the title", text)


def _quote(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)


def _format_licences(items: Sequence[Item]) -> str:
    """Return the page LICENCES.md, which lists the files of the bundle under their licences."""
    by_licence: dict[tuple[str, ...], list[str]] = {}
    for item in items:
        by_licence.setdefault(item.licences, []).append(item.path)
    lines = [
        "# Licences",
        "",
        "References, estimates and scores are under the licences of what they were made from.",
        "",
    ]
    for licences, paths in sorted(by_licence.items()):
        lines += [f"## {' and '.join(licences) or 'No licence is stated'}", "", *(f"- `{path}`" for path in paths), ""]
    return "\n".join(lines)


def _format_readme(items: Sequence[Item], about: About) -> str:
    """Return the page that Zenodo and Hugging Face show, with the front matter of a dataset card."""
    licences = sorted({licence for item in items for licence in item.licences})
    counts = {kind: sum(item.entry.kind == kind for item in items) for kind in {item.entry.kind for item in items}}
    table = "\n".join(f"| {kind} | {count} |" for kind, count in sorted(counts.items()))
    cite = "\n".join(f"- {text}" for text in list_citations(items)) or "- (no citation is stated)"
    return f"""---
pretty_name: {_quote(about.title)}
license: other
license_name: {_quote("; ".join(licences) or "not stated")}
license_link: LICENSES.md
tags: [imu, orientation, attitude, mcap]
---

# {about.title}

{about.description or "Recordings of inertial sensors, reference trajectories with a stated accuracy, and estimates."}

| kind | files |
|---|---|
{table}

- `index.csv` lists every object with its facts; `manifest.json` has hashes, tags and provenance.
- `sha256sum -c {CHECKSUMS}` checks all files.
- Recordings, references and estimates are MCAP files; Foxglove, PlotJuggler, rerun and `ros2 bag` open them.
- `LICENSES.md` has the licence of each file, `CITATION.cff` what to cite, `REPRODUCE.md` how to remake the results.
- `ro-crate-metadata.json` and `croissant.json` describe the bundle for machines.

## Sources

{cite}
"""


def _format_instructions(items: Sequence[Item]) -> str:
    """Return the page REPRODUCE.md: how to make the files of the bundle again, and how exactly they agree."""
    made = sorted({item.entry.columns["version"] for item in items if item.entry.columns.get("version")})
    return f"""# Reproduce

Install stillpoint {version("stillpoint")} (`pip install .` in a checkout of that version), then:

    sh reproduce.sh

The script takes this bundle into a new archive, checks every hash, and makes every reference and estimate anew from
the raw recordings with the recorded settings; each is compared with the one in this bundle to
{_ACROSS_KINDS_RAD:g} rad, because processors of another kind change up to 2.4e-9 rad (docs/archive.md).
Leaderboards are made anew into the folder `remade`. The script ends with 1 where something differs, after all is done.
The files were made by stillpoint {", ".join(made) or "(no version is recorded)"}.
"""


def _make_script(items: Sequence[Item]) -> str:
    """Return the shell script that imports the bundle into a new archive and makes its files again."""
    lines = [
        "#!/bin/sh",
        "# Remakes all references, estimates and leaderboards of this bundle from its recordings; see REPRODUCE.md.",
        "set -eu",
        'cd "$(dirname "$0")"',
        "work=${1:-reproduced}",
        'stillpoint archive init "$work"',
        'stillpoint archive import . --archive "$work"',
        "differs=0",
        f'stillpoint archive verify --archive "$work" --remake all --tolerance {_ACROSS_KINDS_RAD:g} || differs=$?',
    ]
    for item in items:
        if item.entry.kind == "leaderboard":
            stem = item.path.removesuffix(".json")
            lines.append(f'stillpoint leaderboard -c "{stem}{STUDY_SUFFIX}" -o "remade/{stem.rpartition("/")[2]}"')
    return "\n".join([*lines, "exit $differs"]) + "\n"
