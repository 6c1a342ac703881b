"""``stillpoint score``: score estimates against a reference or a truth."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from itertools import chain, groupby
from pathlib import Path
from typing import Any

from stillpoint.datasets import Estimate, Reference, Truth, read
from stillpoint.datasets.errors import BadParameter, StillpointError
from stillpoint.datasets.files.scratch import ScratchStore
from stillpoint.datasets.frames import EulerFrame
from stillpoint.datasets.importers.trajectories import SUFFIXES, read_poses
from stillpoint.datasets.mcap.pieces import PieceReader
from stillpoint.datasets.mcap.store import is_own_file, sha256
from stillpoint.datasets.recording import Recording
from stillpoint.datasets.trajectory import SpinReference
from stillpoint.scoring import AlignKind, Score, score_row
from stillpoint.scoring import score as score_against
from stillpoint.scoring.piecewise import ALIGN_PIECES, score_pieces
from stillpoint.scoring.spin import SpinScore, spin_score_row
from stillpoint.scripts.shared import inputs
from stillpoint.scripts.shared.companions import get_recording_name, list_neighbours, require_same, select_files
from stillpoint.scripts.shared.flags import LOCAL, Columns, Inputs, Workers
from stillpoint.scripts.shared.jobs import SHORT, choose_exit_code
from stillpoint.scripts.shared.kept import REUSE, Deciding, Keeping, Task, run_kept
from stillpoint.scripts.shared.output import STDOUT, JsonFile, print_line, write_json
from stillpoint.scripts.shared.spin_scores import is_spin, print_spin_scores, score_spin_file
from stillpoint.scripts.shared.tables import print_table

_COLUMNS = ("recording", "estimate", "total", "heading", "incl.", "95 %", "max", "found", "roll", "pitch", "yaw")


@dataclass(frozen=True)
class _Job:
    """A file to score, and what judges it: a file, the word for a kind of judge, or None for the usual one."""

    file: Path
    judge: Path | str | None

    def __str__(self) -> str:
        return str(self.file)


@dataclass(frozen=True, eq=False)
class _Scored:
    """The score of one file, and the SHA-256 of what it was made from, by file name."""

    score: Score | SpinScore
    made_from: Mapping[str, str]


@dataclass(frozen=True)
class _Asked:
    """The request of the user."""

    align: AlignKind
    frame: EulerFrame
    over_s: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class Judge:
    """The judge: a reference, or the truth of a recording; and what it was made from."""

    path: Path
    truth: Reference | Truth
    made_from: Mapping[str, str]


def score(
    paths: Inputs,
    /,
    *,
    against: Path | None = None,
    align: AlignKind = "heading",
    frame: EulerFrame = "nwu",
    over: str | None = None,
    workers: Workers = LOCAL,
    keeping: Keeping = REUSE,
    columns: Columns = None,
    json: JsonFile = None,
) -> int:
    """Score estimates against a reference or a truth.

    Prints one row per estimate: RMSE of the total, heading and inclination error over the moving samples, its 95th
    percentile and maximum, and RMSE / largest absolute error of roll, pitch and yaw, all in degrees. Angle and rate of
    a spin are scored by their largest error and RMSE, against the truth or the encoder of the recording.

    Parameters
    ----------
    paths
        Estimates: MCAP files, folders or globs; a recording stands for the estimates beside it. A reference that is
        named by its file is scored too, and so is a trajectory of any program: TUM, KITTI, EuRoC, a CSV table with
        quaternions, or a bag with one pose topic (import trajectory reads those that need options).
    against
        truth, reference or both: the one beside each estimate, the truth in NAME.mcap or NAME.reference.mcap. Or a
        file: a reference, a recording that holds a truth, or such a trajectory. By default the reference beside the
        estimate, else the truth there.
    align
        What may differ without being an error: none, heading, heading+mounting or heading+mounting+time.
    frame
        Frame of roll, pitch and yaw: nwu, ned or enu (ROS).
    over
        Also compare turns over these times in seconds, with commas between: how fast an estimate drifts, whatever its
        heading was to begin with (the relative pose error of other tools).
    columns
        Columns of the table to show: names with commas between, or all. By default those that fit the terminal.
    json
        Also write all figures as JSON to this file; - is the standard output.
    """
    files, asked = _find_files(paths), _Asked(align, frame, _parse_seconds(over))
    kinds = _list_judge_kinds(against)
    if against is not None and not kinds and not inputs.file_exists(against):
        raise BadParameter(
            f"--against {against}: there is no such file; give truth, reference or both, or name a reference or a "
            "recording with a truth"
        )
    work = [_Job(file, kind or against) for file in files for kind in kinds or (None,)]
    rows: list[dict[str, Any]] = []
    scores: list[Score | SpinScore] = []
    outcomes = run_kept(
        partial(_score_job, asked=asked),
        work,
        partial(_decide, asked=asked, beside=cache(list_neighbours)),
        workers,
        keeping,
        "score",
        _Scored,
        here_up_to=SHORT,
    )
    for job, outcome in zip(work, outcomes, strict=True):
        if outcome.value is None:
            if len(work) == 1 and not outcome.defect:
                raise StillpointError(str(outcome.error))
            rows.append({"recording": get_recording_name(job.file), "file": str(job.file), "error": outcome.error})
            continue
        found = outcome.value.score
        scores.append(found)
        row = spin_score_row(found) if isinstance(found, SpinScore) else score_row(found)
        rows.append({**row, "file": str(job.file), "made_from": dict(outcome.value.made_from)})
    if json != STDOUT:
        attitudes = [s for s in scores if isinstance(s, Score)]
        print_scores(attitudes, columns)
        if asked.over_s and attitudes:
            _print_turns(attitudes)
        print_spin_scores([s for s in scores if isinstance(s, SpinScore)])
        for row in rows:
            if row["error"] is not None:
                print_line(f"not scored: {row['error']}")
    write_json(json, rows)
    return choose_exit_code(outcomes)


def print_scores(scores: Sequence[Score], wanted: str | None = None) -> None:
    """Print the scores, a section per recording and judge, best first; then what was left out or means nothing."""

    def place(s: Score) -> tuple[str, str]:
        return s.recording, s.against

    ordered = sorted(scores, key=lambda s: (*place(s), s.total_rmse_deg))
    for against, same in groupby(sorted(ordered, key=lambda s: s.against), key=lambda s: s.against):
        judged = list(same)
        sections = [[_format_cells(s) for s in rows] for _, rows in groupby(judged, key=place)]
        first = 0 if len(sections) > 1 or wanted is not None else 1
        whose = "" if len(sections) > 1 else f"{judged[0].recording} "
        title = f"{whose}against the {against}, aligned: {judged[0].alignment.kind}; RMSE in deg"
        print_table(
            title,
            _COLUMNS[first:],
            [[cells[first:] for cells in rows] for rows in sections],
            texts=2 - first,
            wanted=wanted,
        )
        print_line(f"roll, pitch, yaw: RMSE / largest absolute error in {judged[0].frame.upper()}")
        for note in _list_notes(judged):
            print_line(note)


def _print_turns(scores: Sequence[Score]) -> None:
    """Print the errors of turns over given times: RMSE and largest, a section per recording, best first."""
    named = [f"over {turn.over_s:g} s" for turn in scores[0].turns]
    ordered = sorted(scores, key=lambda s: (s.recording, s.against, s.turns[0].rmse_deg))
    sections = [
        [_format_turns(s) for s in rows] for _, rows in groupby(ordered, key=lambda s: (s.recording, s.against))
    ]
    print_table("errors of turns; RMSE / largest, deg", ["recording", "estimate", "against", *named], sections)


def _format_turns(s: Score) -> list[str]:
    return [s.recording, s.estimated, s.against, *(f"{t.rmse_deg:.3f} / {t.max_deg:.2f}" for t in s.turns)]


def _judge_of(path: Path) -> Judge:
    """Return the reference in a file, or the truth of a recording; raises :class:`BadParameter` when it has neither."""
    if _is_trajectory(path):
        return Judge(path, read_poses(path), {})
    thing = read(path)
    if isinstance(thing, Reference):
        return Judge(path, thing, thing.made_from)
    if isinstance(thing, Recording) and thing.truth is not None:
        return Judge(path, thing.truth, {path.name: sha256(path)})
    what = "a recording without a truth" if isinstance(thing, Recording) else "no reference of an attitude"
    raise BadParameter(f"{path}: is {what}; give a reference (stillpoint reference) or a recording that holds a truth")


def _find_files(paths: Sequence[Path]) -> list[Path]:
    """Return all estimates in the paths, and references and trajectories that are named one by one.

    A recording stands for the estimates beside it.
    """
    named = {path for path in paths if inputs.file_exists(path) and _is_named_alone(path)}
    recordings = {path for path in paths if inputs.file_exists(path) and _is_recording(path)}
    others = [path for path in paths if path not in named | recordings]
    for path in sorted(recordings):
        beside = select_files(get_recording_name(path), "estimate", list_neighbours(path))
        if not beside and not others and not named:
            raise BadParameter(f"{path}: no estimate lies beside it; make one (stillpoint estimate {path})")
        others += [file for file in beside if file not in others]
    return [*sorted(named), *(inputs.find_estimates(others) if others or not named else [])]


def _is_recording(path: Path) -> bool:
    return path.suffix == inputs.SUFFIX and inputs.get_kind(path) == "recording"


def _is_named_alone(path: Path) -> bool:
    return inputs.get_kind(path) == "reference" or _is_trajectory(path)


def _parse_seconds(over: str | None) -> tuple[float, ...]:
    """Return the times in s of ``--over``; raises :class:`BadParameter` with an example."""
    try:
        seconds = () if over is None else tuple(float(part) for part in over.split(","))
        if all(0 < each < float("inf") for each in seconds):
            return seconds
    except ValueError:
        pass
    raise BadParameter(f"--over {over}: give seconds above 0 with commas between, for example 1,10,60")


def _list_judge_kinds(against: Path | None) -> tuple[str, ...]:
    """Return the kinds of judge that a word of --against asks for; none where it names a file or nothing."""
    words = {"truth": ("truth",), "reference": ("reference",), "both": ("truth", "reference")}
    return () if against is None or inputs.file_exists(against) else words.get(str(against), ())


def _decide(job: _Job, asked: _Asked, beside: Callable[[Path], list[Path]]) -> Deciding:
    """Return what decides a score: the file, and its judge, or all files beside it that may be one."""
    settings = {"asked": asked, "judge": None if isinstance(job.judge, Path) else job.judge}
    if isinstance(job.judge, Path):
        return Deciding((job.file, job.judge), settings)
    near = beside(job.file.parent / "*")
    judges = select_files(get_recording_name(job.file), "reference", near)
    judges += [path for path in near if inputs.get_kind(path) == inputs.RECORDING and _is_named_after(job.file, path)]
    return Deciding((job.file, *(path for path in judges if path.name != job.file.name)), settings)


def _is_named_after(file: Path, recording: Path) -> bool:
    return file.name.startswith(recording.name.removesuffix(inputs.SUFFIX) + ".")


def _score_job(task: Task[_Job], asked: _Asked) -> _Scored:
    """Score one file."""
    job = task.item
    named = [one for one in (job.file, job.judge) if isinstance(one, Path)]
    return _Scored(_score_file(job.file, job.judge, asked), {one.name: sha256(one) for one in named})


def _score_file(file: Path, against: Path | str | None, asked: _Asked) -> Score | SpinScore:
    """Score one file against a named file, against one kind of judge beside it, or against the default."""
    if _is_trajectory(file):
        return _score_trajectory(file, against if isinstance(against, Path) else None, asked)
    if asked.align in ALIGN_PIECES and not asked.over_s and (found := _score_in_pieces(file, against, asked)):
        return found
    thing = read(file)
    if isinstance(thing, Estimate | SpinReference) and is_spin(thing):
        if asked.over_s:
            raise BadParameter(f"{file}: is an angle about one axis; --over compares turns of attitudes: leave it out")
        if isinstance(against, str):
            raise BadParameter(f"{file}: is an angle about one axis; leave --against {against} out, or name a file")
        return score_spin_file(file, thing, against, asked.align)
    if not isinstance(thing, Estimate | Reference):
        raise BadParameter(f"{file}: holds no attitude to score; give estimates or references")
    judge = _judge_of(against if isinstance(against, Path) else _find_judge(file, thing, against))
    require_same(file, thing.made_from, judge.path, judge.made_from)
    return score_against(thing, judge.truth, asked.align, asked.frame, over_s=asked.over_s)


def _score_in_pieces(file: Path, against: Path | str | None, asked: _Asked) -> Score | None:
    """Score an estimate of any length, read piece by piece; return None for other files, and for an angle."""
    reader = PieceReader(file)
    if reader.kind != "estimate":
        return None
    pieces = reader.trajectory()
    first = next(pieces)
    if not isinstance(first, Estimate) or is_spin(first):
        return None
    judge, made_from, truths = _open_judge(against if isinstance(against, Path) else _find_judge(file, first, against))
    require_same(file, first.made_from, judge, made_from)
    estimates = (piece for piece in chain([first], pieces) if isinstance(piece, Estimate))
    return score_pieces(estimates, truths, asked.align, asked.frame, ScratchStore)


def _open_judge(path: Path) -> tuple[Path, Mapping[str, str], Iterator[Reference | Truth]]:
    """Return what :func:`_judge_of` does, with the reference or truth in pieces."""
    if not _is_trajectory(path):
        reader = PieceReader(path)
        if reader.kind == "recording" and "truth" in reader.head.samples:
            truths = (piece.truth for piece in reader.recording() if piece.truth is not None)
            return path, {path.name: sha256(path)}, truths
        if reader.kind == "reference":
            pieces = reader.trajectory()
            first = next(pieces)
            references = (piece for piece in chain([first], pieces) if isinstance(piece, Reference))
            return path, first.made_from if isinstance(first, Reference) else {}, references
    judge = _judge_of(path)
    return judge.path, judge.made_from, iter([judge.truth])


def _is_trajectory(path: Path) -> bool:
    """Return whether a file holds a trajectory of another program, by its name; an MCAP file by its content."""
    if path.suffix != ".mcap":
        return path.suffix in SUFFIXES
    return inputs.get_kind(path) == inputs.RECORDING and path.is_file() and not is_own_file(path)


def _score_trajectory(file: Path, against: Path | None, asked: _Asked) -> Score:
    """Score a trajectory of another program; it cannot say which recording it was made from."""
    if against is None:
        raise BadParameter(f"{file}: does not say what it belongs to; name its judge: --against NAME.reference.mcap")
    poses, judge = read_poses(file), _judge_of(against)
    name = judge.truth.name if isinstance(judge.truth, Reference) else against.name.removesuffix(against.suffix)
    made = Estimate(poses.t_ns, file.name.removesuffix(file.suffix), q_nb=poses.q_nb, recording=name)
    return score_against(made, judge.truth, asked.align, asked.frame, over_s=asked.over_s)


def _find_judge(file: Path, thing: Estimate | Reference, kind: str | None = None) -> Path:
    """Return what judges a file: of a kind, or the reference of its recording, else the recording's truth."""
    name = get_recording_name(file) if isinstance(thing, Estimate) else thing.name
    recording = file.parent / f"{name}{inputs.SUFFIX}"
    if kind == "truth":
        return recording
    candidates = select_files(name, "reference", list_neighbours(file)) if isinstance(thing, Estimate) else []
    plain = [path for path in candidates if path.name == f"{name}{inputs.KINDS['reference']}"]
    if plain or len(candidates) == 1:
        return (plain or candidates)[0]
    if candidates:
        raise BadParameter(
            f"{file}: {', '.join(path.name for path in candidates)} lie beside it; name one with --against"
        )
    if kind is None and recording.is_file() and "truth" in PieceReader(recording).head.samples:
        return recording
    missing = "" if kind == "reference" else f" and no truth in {recording.name}"
    raise BadParameter(
        f"{file}: no {name}{inputs.KINDS['reference']}{missing} beside it; "
        "make a reference there (stillpoint reference) or name one with --against"
    )


def _format_cells(s: Score) -> list[str]:
    """Return the row of a score as text, marked where it lies below the judge's own accuracy."""
    found: Mapping[str, Any] = s.alignment.found()
    parts = [f"{found['heading_deg']:+.2f}°"] if s.alignment.kind != "none" else ["-"]
    if "mounting" in s.alignment.kind:
        parts.append(f"mounting {found['mounting_deg']:.2f}°")
    if "time" in s.alignment.kind:
        parts.append(f"{1000 * found['time_s']:+.1f} ms")
    mark = "†" if s.reference_sd_deg is not None and s.total_rmse_deg < s.reference_sd_deg else ""
    return [
        s.recording,
        s.estimated,
        f"{mark}{s.total_rmse_deg:.2f}",
        f"{s.heading_rmse_deg:.2f}",
        f"{s.inclination_rmse_deg:.2f}",
        f"{s.total_p95_deg:.2f}",
        f"{s.total_max_deg:.2f}",
        ", ".join(parts),
        f"{s.roll_rmse_deg:.2f} / {s.roll_maxae_deg:.1f}",
        f"{s.pitch_rmse_deg:.2f} / {s.pitch_maxae_deg:.1f}",
        f"{s.yaw_rmse_deg:.2f} / {s.yaw_maxae_deg:.1f}",
    ]


def _list_notes(scores: Sequence[Score]) -> list[str]:
    """Return what a reader has to know besides the figures: samples left out, conversions, the judge's accuracy."""
    notes = []
    for s in scores:
        left_out = {"outside": s.samples_outside, "in gaps": s.samples_in_gap, "not ready": s.samples_unready}
        counts = ", ".join(f"{count} {why}" for why, count in left_out.items() if count)
        if counts:
            notes.append(f"{s.recording} {s.estimated}: {s.samples} moving samples scored, left out: {counts}")
        if s.conversion is not None:
            notes.append(f"{s.recording} {s.estimated}: {s.conversion}")
    sds = sorted({(s.recording, s.reference_sd_deg) for s in scores if s.reference_sd_deg is not None})
    notes += [f"{name}: the reference's own sd is {sd_deg:.2f} deg (median)" for name, sd_deg in sds]
    if any(s.reference_sd_deg is not None and s.total_rmse_deg < s.reference_sd_deg for s in scores):
        notes.append("† below the reference's own sd: differences down there mean nothing")
    return notes
