"""``python -m stillpoint.scripts.pages.ablation DIR...``: print how much each ingredient of the graph improves it.

Recordings with truth are solved with one ingredient off at a time; docs/history.md holds the tables.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from statistics import mean, median

from stillpoint.datasets.errors import BadParameter, StillpointError
from stillpoint.datasets.mcap.store import read_recording
from stillpoint.datasets.recording import Recording
from stillpoint.datasets.settings import choose_settings
from stillpoint.datasets.trajectory import Estimate, Reference
from stillpoint.scoring import AlignKind, score
from stillpoint.scoring.score import Score
from stillpoint.scripts.program import run_program
from stillpoint.scripts.shared.flags import LOCAL
from stillpoint.scripts.shared.inputs import find_recordings
from stillpoint.scripts.shared.jobs import run_jobs
from stillpoint.smoother.attitude.evidence import gather_evidence
from stillpoint.smoother.attitude.graph import reference_from_evidence
from stillpoint.smoother.attitude.params import HANDHELD

_ALIGNMENTS: tuple[AlignKind, ...] = ("heading+mounting+time", "heading")
_FIGURES = ("total", "heading", "inclination", "worst total", "in 95 %", "NEES/3")


@dataclass(frozen=True)
class Variant:
    """The graph without one ingredient."""

    name: str
    settings: dict[str, float] = field(default_factory=dict)  # dotted names, as for --set
    magnetometer: bool = True
    returns: bool = True
    optimised: bool = True  # else the start value is scored


_NO_CALIBRATION = {
    "inertial.gyro_matrix_sd": 1e-5,
    "inertial.accel_matrix_sd": 1e-5,
    "inertial.free_scale_sd": 0.0,
    "inertial.raw_matrix_sd": 1e-5,
    "inertial.rawest_matrix_sd": 1e-5,
}
VARIANTS = (
    Variant("everything"),
    Variant("no calibration matrices", _NO_CALIBRATION),
    Variant("no delay of the accelerometer", {"inertial.accel_late_sd_s": 1e-5}),
    Variant("neither matrices nor delay", {**_NO_CALIBRATION, "inertial.accel_late_sd_s": 1e-5}),
    Variant("no delay of the magnetometer", {"magnetic.late_sd_s": 1e-5}),
    Variant("no matrix of the magnetometer", {"magnetic.matrix_sd": 1e-6}),
    Variant("gyro bias constant", {"inertial.gyro_bias_walk": 1e-7, "inertial.gyro_bias_shift_radps": 2e-7}),
    Variant("no magnetometer", magnetometer=False),
    Variant("no returns", returns=False),
    Variant("no returns, no magnetometer", returns=False, magnetometer=False),
    Variant(
        "nothing known at rest",
        {
            "motion.rest_velocity_sd_mps": 0.1,
            "motion.rest_turn_sd_rad": 0.1,
            "inertial.gyro_rest_radps_rthz": HANDHELD.inertial.gyro_radps_rthz,
            "inertial.accel_rest_mps2_rthz": HANDHELD.inertial.accel_mps2_rthz,
        },
    ),
    Variant("place and speed unbounded", {"motion.position_sd_m": 1e7, "motion.velocity_sd_mps": 1e4}),
    Variant("no robust weights of the field", {"magnetic.robust": 10.0}),
    Variant("states every 0.2 s", {"keys.moving_s": 0.2}),
    Variant("the start value alone", optimised=False),
)


def main(*folders: Path) -> None:
    """Print one table per folder and alignment. Raises :class:`BadParameter` without a folder."""
    if not folders:
        raise BadParameter("ablation: name folders of recordings with truth")
    for folder in folders:
        sources = find_recordings([folder])
        rows = [(variant.name, _score_variant(variant, sources)) for variant in VARIANTS]
        for align in _ALIGNMENTS:
            print(f"\n{folder.name}, {len(sources)} recordings, aligned: {align}\n")
            print(f"| | {' | '.join(_FIGURES)} | refused |\n|{'---|' * (len(_FIGURES) + 2)}")
            for name, scores in rows:
                found = [each[align] for each in scores if each is not None]
                print(f"| {name} | {' | '.join(_format_cells(found))} | {len(scores) - len(found)} |", flush=True)


def _score_variant(variant: Variant, sources: Sequence[Path]) -> list[dict[AlignKind, Score] | None]:
    """Return one score per recording, None where the variant was refused."""
    outcomes = run_jobs(partial(_score_recording, variant=variant), sources, LOCAL, variant.name)
    return [outcome.value for outcome in outcomes]


def _score_recording(source: Path, variant: Variant) -> dict[AlignKind, Score]:
    """Return the scores of a variant on a recording, by alignment; raises :class:`StillpointError` without truth."""
    recording = read_recording(source)
    if recording.truth is None:
        raise StillpointError(f"{source}: has no independent truth; an ablation needs one")
    given = recording if variant.magnetometer else replace(recording, mag=None)
    made = solve_variant(given, variant)
    return {align: score(made, recording.truth, align) for align in _ALIGNMENTS}


def solve_variant(recording: Recording, variant: Variant) -> Reference | Estimate:
    """Return the reference by this variant of the graph; raises what the graph raises."""
    params = choose_settings(HANDHELD, variant.settings, "graph")
    evidence = gather_evidence(recording, params)
    if not variant.returns:
        evidence = replace(evidence, base=None, returns=None)
    if not variant.optimised:
        t_ns = recording.require_imu().t_ns
        return Estimate(t_ns, "start value", q_nb=evidence.start.q_nb, recording=recording.name)
    return reference_from_evidence(recording, evidence, params)


def _format_cells(scores: Sequence[Score]) -> list[str]:
    """Return means over the recordings with medians in brackets, and the worst total."""
    if not scores:
        return ["–"] * len(_FIGURES)
    errors = {name: [getattr(s, f"{name}_rmse_deg") for s in scores] for name in _FIGURES[:3]}
    cells = [f"{mean(values):.2f} ({median(values):.2f})" for values in errors.values()]
    inside = [s.coverage95 for s in scores if s.coverage95 is not None]
    nees = [s.nees_per_dof for s in scores if s.nees_per_dof is not None]
    stated = [f"{mean(inside):.2f}", f"{mean(nees):.2f}"] if inside and nees else ["–", "–"]
    return [*cells, f"{max(errors['total']):.2f}", *stated]


if __name__ == "__main__":
    run_program(main)
