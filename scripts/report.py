"""``stillpoint report``: write one HTML page about a recording, its reference and its estimates."""

import sys
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.progress import track

from stillpoint.datasets.errors import BadParameter, StillpointError
from stillpoint.datasets.frames import EulerFrame
from stillpoint.datasets.store import read_estimate, read_recording, read_reference, sha256
from stillpoint.scoring import AlignKind
from stillpoint.scoring.report import Material, judge, report_html
from stillpoint.scripts import inputs
from stillpoint.scripts.batch import require_distinct
from stillpoint.scripts.beside import files_of, neighbours, recording_name, require_same
from stillpoint.scripts.flags import Inputs, OutDir
from stillpoint.scripts.text_file import write_text

PAGE = ".report.html"


def report(
    paths: Inputs,
    /,
    *,
    out: OutDir = Path(),
    align: AlignKind = "heading",
    frame: EulerFrame = "nwu",
) -> int:
    """Write one HTML page about a recording, its reference and its estimates.

    Finds NAME.reference.mcap and NAME.ESTIMATOR.estimate.mcap in the folder of NAME.mcap, scores the estimates against
    the reference, and both against the recording's truth where it holds one, and writes NAME.report.html: tables,
    pictures and provenance in one file that needs no network. Further references, NAME.METHOD.reference.mcap, are
    scored beside the estimates.

    Parameters
    ----------
    paths
        Recordings: MCAP files, folders or globs.
    out
        Folder to write into, made when it is not there; or, for one recording, a file that ends in .html.
    align
        What may differ without being an error: none, heading, heading+mounting or heading+mounting+time.
    frame
        Frame of roll, pitch and yaw: nwu (paper 002), ned (paper 003) or enu (ROS).
    """
    recordings = inputs.recordings(paths)
    targets = _targets(recordings, out)
    failed = 0
    pairs = list(zip(recordings, targets, strict=True))
    for recording, target in track(
        pairs, "report", disable=len(pairs) < 2, transient=True, console=Console(stderr=True)
    ):
        try:
            write_report(target, gather(recording), align, frame)
        except StillpointError as error:
            if len(pairs) == 1:
                raise
            failed += 1
            print(f"no report: {error}", file=sys.stderr)
            continue
        print(target)
    return 2 if failed else 0


def gather(path: Path) -> Material:
    """A recording with the references and estimates beside it; raises :class:`BadParameter` when there is none."""
    name, around = recording_name(path), neighbours(path)
    hashes = {path.name: sha256(path)}
    references, estimates = [], []
    for file in files_of(name, "reference", around):
        reference = read_reference(file)
        require_same(file, reference.made_from, path, hashes)
        references.append((file, reference))
    for file in files_of(name, "estimate", around):
        estimate = read_estimate(file)
        require_same(file, estimate.made_from, path, hashes)
        estimates.append((file, estimate))
    recording = read_recording(path)
    if not (references or estimates) or not (references or recording.truth is not None):
        missing = "reference" if estimates else "reference or estimate"
        raise BadParameter(
            f"{path}: no {missing} of it lies beside it; make one in that folder: stillpoint reference {path} "
            f"-o {path.parent}"
        )
    files = {file.name: sha256(file) for file, _ in [*references, *estimates]}
    return Material(
        name=recording.name,
        recording=recording,
        references=tuple(reference for _, reference in references),
        estimates=tuple(estimate for _, estimate in estimates),
        sha256=hashes | files,
    )


def write_report(target: Path, material: Material, align: AlignKind, frame: EulerFrame) -> None:
    """Score the material and write its page; raises :class:`BadParameter` when nothing in it can be scored."""
    verdicts = judge(material, align, frame)
    if not verdicts:
        raise BadParameter(f"{material.name}: nothing to score; make estimates of it: stillpoint estimate")
    write_text(target, report_html(material, verdicts))


def _targets(recordings: Sequence[Path], out: Path) -> list[Path]:
    if out.suffix == ".html":
        if len(recordings) > 1:
            raise BadParameter(f"-o {out}: {len(recordings)} recordings give as many pages; name a folder")
        inputs.output_dir(out.parent)
        return [out]
    folder = inputs.output_dir(out)
    targets = [folder / f"{recording_name(path)}{PAGE}" for path in recordings]
    require_distinct(targets)
    return targets
