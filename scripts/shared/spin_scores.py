"""Scores of angle and rate about a spin axis, for the verbs: their judge, the subtracted angle, and their table."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.mcap.store import read, read_recording, sha256
from stillpoint.datasets.recording import Encoder, Recording
from stillpoint.datasets.trajectory import Estimate, SpinReference
from stillpoint.scoring.align import AlignKind
from stillpoint.scoring.spin import ZERO_WORDS, AngleZero, SpinScore, choose_zero, score_roll
from stillpoint.scripts.shared import inputs
from stillpoint.scripts.shared.companions import get_recording_name, list_neighbours, require_same, select_files
from stillpoint.scripts.shared.output import print_line
from stillpoint.scripts.shared.tables import print_table

_COLUMNS = (
    "recording",
    "estimate",
    "angle max",
    "angle RMSE",
    "rate max",
    "rate RMSE",
    "NEES angle",
    "rate",
    "95 %",
    "rate",
)
_ZEROS: dict[AlignKind, AngleZero | None] = {"heading": None, "none": "none"}  # None: the usual one of each


@dataclass(frozen=True, eq=False)
class SpinJudge:
    """The judge: a roll reference, or the truth or encoder of a recording; and what it was made from."""

    path: Path
    truth: Encoder | SpinReference
    name: str  # "truth", "encoder", "" for a reference
    made_from: Mapping[str, str]


def is_spin(thing: object) -> bool:
    """Return whether a thing is an angle and a rate rather than an attitude."""
    return isinstance(thing, SpinReference) or (isinstance(thing, Estimate) and thing.q_nb is None)


def score_spin_file(file: Path, thing: Estimate | SpinReference, against: Path | None, align: AlignKind) -> SpinScore:
    """Score one file; raises :class:`BadParameter` for an alignment that an angle does not have, or without a judge."""
    zero = find_zero(align, str(file))
    judge = find_spin_judge(_find_judge(file, thing) if against is None else against)
    require_same(file, thing.made_from, judge.path, judge.made_from)
    return score_roll(thing, judge.truth, zero or choose_zero(thing, judge.truth, judge.name), judge.name)


def find_zero(align: AlignKind, where: str) -> AngleZero | None:
    """Return what is subtracted from an angle for ``--align``, None for the usual; raises :class:`BadParameter`."""
    if align not in _ZEROS:
        raise BadParameter(
            f"{where}: --align {align}: an angle about one axis has no mounting and no clock to align; give heading "
            "(the angle counts from the first sample, or is absolute where gravity fixes it) or none"
        )
    return _ZEROS[align]


def find_spin_judge(path: Path) -> SpinJudge:
    """Find the roll reference in a file, or the truth, else the encoder, of a recording, else raise BadParameter."""
    thing = read(path)
    if isinstance(thing, SpinReference):
        return SpinJudge(path, thing, "", thing.made_from)
    if isinstance(thing, Recording) and (thing.roll_truth is not None or thing.encoder is not None):
        made_from = {path.name: sha256(path)}
        if thing.roll_truth is not None:
            return SpinJudge(path, thing.roll_truth, "truth", made_from)
        assert thing.encoder is not None
        return SpinJudge(path, thing.encoder, "encoder", made_from)
    raise BadParameter(
        f"{path}: holds no angle about a spin axis; give a roll reference, or a recording with an encoder"
    )


def print_spin_scores(scores: Sequence[SpinScore]) -> None:
    """Print a table per judge and alignment, a section per recording, best rate first; then what was left out."""
    ordered = sorted(scores, key=lambda s: (s.against, s.recording, s.rate_rmse_degps))
    ordered.sort(key=lambda s: (s.against, s.zero))
    for (against, taken_off), same in groupby(ordered, key=lambda s: (s.against, s.zero)):
        judged = list(same)
        sections = [[_format_cells(s) for s in rows] for _, rows in groupby(judged, key=lambda s: s.recording)]
        print_table(f"roll against the {against}, {ZERO_WORDS[taken_off]}; deg and deg/s", _COLUMNS, sections)
        for s in judged:
            for note in _list_notes(s):
                print_line(note)


def _find_judge(file: Path, thing: Estimate | SpinReference) -> Path:
    """Return what judges a file when nothing was named: as for attitudes, the reference, else the recording."""
    name = get_recording_name(file) if isinstance(thing, Estimate) else thing.name
    candidates = select_files(name, "reference", list_neighbours(file)) if isinstance(thing, Estimate) else []
    if len(candidates) == 1:
        return candidates[0]
    if candidates:
        raise BadParameter(
            f"{file}: {', '.join(path.name for path in candidates)} lie beside it; name one with --against"
        )
    recording = file.parent / f"{name}{inputs.SUFFIX}"
    if recording.is_file():
        found = read_recording(recording)
        if found.roll_truth is not None or found.encoder is not None:
            return recording
    raise BadParameter(
        f"{file}: no {name}{inputs.KINDS['reference']} and no encoder in {recording.name} beside it; name one with "
        "--against"
    )


def _format_cells(s: SpinScore) -> list[str]:
    """Return the row of a score as text: angles in deg, rates in deg/s."""
    figures = (s.angle_max_deg, s.angle_rmse_deg, s.rate_max_degps, s.rate_rmse_degps)
    fits = (s.angle_nees, s.rate_nees, s.angle_coverage95, s.rate_coverage95)
    shown = ["-" if value is None else f"{value:.2f}" for value in fits]
    return [s.recording, s.estimated, *(f"{value:.2f}" for value in figures), *shown]


def _list_notes(s: SpinScore) -> list[str]:
    """Return what a reader has to know besides the figures: samples left out, and the judge's own accuracy."""
    notes = []
    left_out = {"outside": s.samples_outside, "in gaps": s.samples_in_gap, "not ready": s.samples_unready}
    counts = ", ".join(f"{count} {why}" for why, count in left_out.items() if count)
    if counts:
        notes.append(f"{s.recording} {s.estimated}: {s.samples} samples scored, left out: {counts}")
    if s.samples_interpolated:
        notes.append(f"{s.recording} {s.estimated}: {s.samples_interpolated} samples between two of the {s.against}")
    if s.reference_angle_sd_deg is not None and s.reference_rate_sd_degps is not None:
        own = f"{s.reference_angle_sd_deg:.2g} deg and {s.reference_rate_sd_degps:.2g} deg/s"
        notes.append(f"{s.recording} {s.estimated}: the reference's own sd is {own} (median)")
    return notes
