"""One self-contained HTML page about a spinning body: angle and rate about its axis, and their errors."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from stillpoint.datasets.recording import Encoder, Recording
from stillpoint.datasets.trajectory import Estimate, RollReference
from stillpoint.scoring.report.figures import COLOURS, ON_DARK
from stillpoint.scoring.report.pictures import Picture, picture
from stillpoint.scoring.report.provenance import describe_recording, flatten_params, list_versions
from stillpoint.scoring.report.spin_figures import draw_accelerometers, draw_error_band, draw_rates, series_of
from stillpoint.scoring.report.templates import load_template
from stillpoint.scoring.spin import (
    ZERO_WORDS,
    AngleZero,
    RollComparison,
    RollScore,
    compare_roll,
    roll_score_of,
    usual_zero,
)


@dataclass(frozen=True, eq=False)
class SpinMaterial:
    """What there is about one recording of a spinning body."""

    recording: Recording
    references: tuple[RollReference, ...] = ()
    estimates: tuple[Estimate, ...] = ()
    sha256: Mapping[str, str] = field(default_factory=dict)  # of the files this was read from, by name


@dataclass(frozen=True, eq=False)
class SpinVerdict:
    """Everything that can be scored against one reference, truth or encoder."""

    against: str
    truth: Encoder | RollReference
    comparisons: tuple[RollComparison, ...]
    scores: tuple[RollScore, ...]


def judge_spin(material: SpinMaterial, zero: AngleZero | None = None) -> tuple[SpinVerdict, ...]:
    """Score everything against the truth, else the encoder, and everything else against the first reference.

    ``zero`` as in :func:`stillpoint.scoring.spin.score_roll`; None takes what is usual for each.
    """
    recording, first = material.recording, material.references[:1]
    made: tuple[RollReference | Estimate, ...] = (*material.references, *material.estimates)
    judges: list[tuple[str, Encoder | RollReference | None, tuple[RollReference | Estimate, ...]]] = [
        ("truth", recording.roll_truth, made),
        ("encoder", recording.encoder if recording.roll_truth is None else None, made),
        *(("", reference, made[1:]) for reference in first),
    ]
    verdicts = []
    for name, truth, judged in judges:
        if truth is None or not judged:
            continue
        comparisons = tuple(
            compare_roll(thing, truth, zero or usual_zero(thing, truth, name), name) for thing in judged
        )
        scores = tuple(roll_score_of(c) for c in comparisons)
        verdicts.append(SpinVerdict(comparisons[0].against, truth, comparisons, scores))
    return tuple(verdicts)


def spin_report_html(material: SpinMaterial, verdicts: tuple[SpinVerdict, ...]) -> str:
    """The page as text; at least one verdict. The same material gives the same bytes."""
    made: list[RollReference | Estimate] = [*material.references, *material.estimates]
    return load_template("stillpoint.scoring.report", "spin_page.html.j2").render(
        colours=COLOURS,
        colours_on_dark=ON_DARK,
        name=material.recording.name,
        facts=_facts(material.recording),
        references=[{"name": _name(one), "facts": _reference_facts(one)} for one in material.references],
        met={_name(one): _met(one) for one in material.estimates},
        sections=[
            {
                "against": verdict.against,
                "scores": sorted(verdict.scores, key=lambda s: s.rate_rmse_degps),
                "zero": _zeros(verdict.scores),
            }
            for verdict in verdicts
        ],
        pictures=_pictures(material.recording, verdicts[0]),
        files=dict(material.sha256),
        params={_name(thing): dict(flatten_params(thing.params)) for thing in made},
        versions=list_versions(),
    )


def _zeros(scores: Sequence[RollScore]) -> str:
    """What is taken off the angles, in words; by name where it is not the same for all."""
    zeros = dict.fromkeys(s.zero for s in scores)
    if len(zeros) == 1:
        return ZERO_WORDS[scores[0].zero]
    return "; ".join(
        f"{', '.join(s.estimated for s in scores if s.zero == zero)}: {ZERO_WORDS[zero]}" for zero in zeros
    )


def _name(thing: RollReference | Estimate) -> str:
    return f"reference ({thing.method})" if isinstance(thing, RollReference) else thing.name


def _facts(recording: Recording) -> dict[str, str]:
    facts = describe_recording(recording)
    assert recording.spin is not None
    geometry = recording.spin.geometry
    arms = (
        f"{k + 1}: arm ({', '.join(f'{x:g}' for x in arm)}) m, axis ({', '.join(f'{x:g}' for x in axis)})"
        for k, (arm, axis) in enumerate(zip(geometry.accel_r_b_m, geometry.accel_axis_b, strict=True))
    )
    return facts | {"accelerometers": "; ".join(arms)}


def _reference_facts(reference: RollReference) -> dict[str, str]:
    """Its standard deviations, and what it says of itself in words and counts."""
    angle_deg, rate_degps = np.rad2deg(reference.angle_sd_rad), np.rad2deg(reference.rate_sd_radps)
    said = reference.diagnostics
    return {
        "sd of the rate": f"{np.median(rate_degps):.2g} deg/s (median), {rate_degps.max():.2g} deg/s (largest)",
        "sd of the angle": f"{np.median(angle_deg):.2g} deg (median), {angle_deg[-1]:.2g} deg at the end",
        **{key: str(value) for key, value in said.items() if isinstance(value, str)},
        "met": _counted(said),
    }


def _met(estimate: Estimate) -> str:
    """What an estimator met, in words and counts."""
    words = [str(value) for key, value in estimate.diagnostics.items() if key == "direction"]
    return "; ".join([_counted(estimate.diagnostics), *words])


def _counted(diagnostics: Mapping[str, Any]) -> str:
    counts = [f"{key[2:].replace('_', ' ')} {n}" for key, n in diagnostics.items() if key.startswith("n_") and n]
    return ", ".join(counts) or "nothing unusual"


def _pictures(recording: Recording, verdict: SpinVerdict) -> list[Picture]:
    """Rates with their errors, then errors with their stated bands, then what was measured."""
    assert recording.spin is not None
    spin = recording.spin
    zero_ns = int(spin.t_ns[0])
    colours = {c.estimated: k for k, c in enumerate(verdict.comparisons)}
    series = series_of(verdict.truth, verdict.comparisons, zero_ns)
    shown = [
        picture(
            "Rate over time",
            f"Above, the rates over the {verdict.against}; below, estimate minus {verdict.against}.",
            1 + len(colours),
            105,
            lambda axes: draw_rates(axes, series, colours, verdict.against),
        )
    ]
    shown += [
        picture(
            f"{c.estimated} against the {verdict.against}",
            "Errors of angle and rate"
            + (
                " within the band of three standard deviations that it states."
                if c.angle_sd_rad is not None
                else "; it states no standard deviation."
            ),
            2,
            130,
            _drawn_band(c, colours[c.estimated], zero_ns),
        )
        for c in verdict.comparisons
    ]
    sensors = picture(
        "What the accelerometers read",
        "Dotted: the range that the recording states.",
        spin.accel_mps2.shape[1],
        120,
        lambda axes: draw_accelerometers(axes, spin),
    )
    return [*shown, sensors]


def _drawn_band(comparison: RollComparison, colour: int, zero_ns: int) -> Callable[[Sequence[Axes]], None]:
    return lambda axes: draw_error_band(axes, comparison, colour, zero_ns)
