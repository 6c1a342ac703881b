"""``stillpoint report``: write one HTML page about a recording, its reference and its estimates."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from stillpoint.datasets.errors import BadParameter, StillpointError
from stillpoint.datasets.frames import EulerFrame
from stillpoint.datasets.mcap.store import read, sha256
from stillpoint.datasets.recording import Recording
from stillpoint.datasets.trajectory import Estimate, Reference, SpinReference
from stillpoint.scoring import AlignKind
from stillpoint.scoring.report.page import Material, judge, make_report_html
from stillpoint.scoring.report.spin_page import SpinMaterial, judge_spin, make_spin_report_html
from stillpoint.scripts.shared import inputs
from stillpoint.scripts.shared.batch import require_distinct
from stillpoint.scripts.shared.companions import get_recording_name, list_neighbours, require_same, select_files
from stillpoint.scripts.shared.flags import Inputs, Jobs, OutBeside, Workers
from stillpoint.scripts.shared.jobs import choose_exit_code, run_jobs
from stillpoint.scripts.shared.output import print_line, write_text
from stillpoint.scripts.shared.recordings import open_recording
from stillpoint.scripts.shared.spin_scores import find_zero, is_spin

PAGE = ".report.html"


def report(
    paths: Inputs,
    /,
    *,
    out: OutBeside = None,
    align: AlignKind = "heading",
    frame: EulerFrame = "nwu",
    jobs: Jobs = None,
) -> int:
    """Write one HTML page about a recording, its reference and its estimates.

    Finds NAME.reference.mcap and NAME.ESTIMATOR.estimate.mcap in the folder of NAME.mcap, scores the estimates against
    the reference, and both against the recording's truth where it holds one, and writes NAME.report.html: tables,
    plots and provenance in one file that needs no network. Further references, NAME.METHOD.reference.mcap, are
    scored beside the estimates. Of a spinning body the page shows angle and rate about its axis.

    Parameters
    ----------
    paths
        Recordings: MCAP files, folders or globs.
    out
        Folder to write into, made when it is not there; or, for one recording, a file that ends in .html. By default
        beside each recording.
    align
        What may differ without being an error: none, heading, heading+mounting or heading+mounting+time.
    frame
        Frame of roll, pitch and yaw: nwu, ned or enu (ROS).
    jobs
        Processes; by default one per core, fewer for few recordings.
    """
    recordings = inputs.find_recordings(paths)
    targets = _choose_targets(recordings, out)
    pages = [_Page(*pair) for pair in zip(recordings, targets, strict=True)]
    outcomes = run_jobs(partial(_write_page, align=align, frame=frame), pages, Workers(jobs), "report")
    if len(pages) == 1 and outcomes[0].error is not None and not outcomes[0].defect:
        raise StillpointError(outcomes[0].error)
    for page, outcome in zip(pages, outcomes, strict=True):
        if outcome.error is None:
            print_line(page.target)
        else:
            print_line(f"no report: {outcome.error}", file=sys.stderr)
    return choose_exit_code(outcomes)


@dataclass(frozen=True)
class _Page:
    """A page to write: about which recording, into which file."""

    source: Path
    target: Path


def _write_page(page: _Page, align: AlignKind, frame: EulerFrame) -> None:
    _write_report(page.target, gather_material(page.source), align, frame)


def gather_material(path: Path) -> Material | SpinMaterial:
    """Read a recording with the references and estimates beside it; raises :class:`BadParameter` when there is none.

    They are attitudes, or angles and rates about the axis of a spinning body where the recording has no IMU.
    """
    recording = open_recording(path)
    of_spin = recording.imu is None
    hashes = {path.name: sha256(path)}
    made: list[Reference | SpinReference | Estimate] = []
    around = list_neighbours(path)
    for file in (
        one for kind in ("reference", "estimate") for one in select_files(get_recording_name(path), kind, around)
    ):
        thing = read(file)
        if not isinstance(thing, Reference | SpinReference | Estimate):
            raise BadParameter(
                f"{file}: holds a recording, but its name ends as that of a reference or an estimate; rename it"
            )
        require_same(file, thing.made_from, path, hashes)
        if is_spin(thing) != of_spin:
            print_line(f"{file}: left out, {'an attitude' if of_spin else 'an angle about one axis'}", file=sys.stderr)
            continue
        made.append(thing)
        hashes[file.name] = sha256(file)
    _require_judge(path, recording, made)
    estimates = tuple(thing for thing in made if isinstance(thing, Estimate))
    if of_spin:
        return SpinMaterial(
            recording, tuple(thing for thing in made if isinstance(thing, SpinReference)), estimates, hashes
        )
    references = tuple(thing for thing in made if isinstance(thing, Reference))
    return Material(recording.name, recording, references, estimates, hashes)


def _write_report(target: Path, material: Material | SpinMaterial, align: AlignKind, frame: EulerFrame) -> None:
    """Score the material and write its page; raises :class:`BadParameter` when nothing in it can be scored."""
    name = material.recording.name if material.recording is not None else target.name
    nothing = BadParameter(f"{name}: nothing to score; make estimates of it: stillpoint estimate")
    if isinstance(material, SpinMaterial):
        spun = judge_spin(material, find_zero(align, name))
        if not spun:
            raise nothing
        write_text(target, make_spin_report_html(material, spun))
        return
    verdicts = judge(material, align, frame)
    if not verdicts:
        raise nothing
    write_text(target, make_report_html(material, verdicts))


def _require_judge(path: Path, recording: Recording, made: Sequence[Reference | SpinReference | Estimate]) -> None:
    """Raise :class:`BadParameter` when a recording has no file beside it, or no judge."""
    references = [thing for thing in made if not isinstance(thing, Estimate)]
    known = recording.truth if recording.imu is not None else recording.roll_truth or recording.encoder
    if made and (references or known is not None):
        return
    missing = "reference" if made else "reference or estimate"
    raise BadParameter(f"{path}: no {missing} of it lies beside it; make one: stillpoint reference {path}")


def _choose_targets(recordings: Sequence[Path], out: Path | None) -> list[Path]:
    """Return the page of each recording; raises :class:`BadParameter` where several would share a file."""
    if out is not None and out.suffix == ".html":
        if len(recordings) > 1:
            raise BadParameter(f"-o {out}: {len(recordings)} recordings give as many pages; name a folder")
        inputs.make_output_dir(out.parent)
        return [out]
    folder = None if out is None else inputs.make_output_dir(out)
    targets = [inputs.choose_folder(path, folder) / f"{get_recording_name(path)}{PAGE}" for path in recordings]
    require_distinct(targets)
    return targets
