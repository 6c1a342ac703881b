"""The report of a spinning body: one HTML page with angle and rate about its axis and their errors."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from stillpoint.datasets.recording import Encoder, Recording
from stillpoint.datasets.trajectory import Estimate, SpinReference
from stillpoint.scoring.report.figures import COLOURS, ON_DARK
from stillpoint.scoring.report.pictures import Picture, make_picture
from stillpoint.scoring.report.provenance import describe_recording, flatten_params, list_versions
from stillpoint.scoring.report.spin_figures import draw_accelerometers, draw_error_band, draw_rates, make_rate_series
from stillpoint.scoring.report.templates import load_template
from stillpoint.scoring.spin import (
    ZERO_WORDS,
    AngleZero,
    SpinComparison,
    SpinScore,
    choose_zero,
    compare_spin,
    score_spin_comparison,
)


@dataclass(frozen=True, eq=False)
class SpinMaterial:
    """A recording of a spinning body with what was made of it."""

    recording: Recording
    references: tuple[SpinReference, ...] = ()
    estimates: tuple[Estimate, ...] = ()
    sha256: Mapping[str, str] = field(default_factory=dict)  # of the files this was read from, by name


@dataclass(frozen=True, eq=False)
class SpinVerdict:
    """The scores of everything that one reference, truth or encoder judges."""

    against: str
    truth: Encoder | SpinReference
    comparisons: tuple[SpinComparison, ...]
    scores: tuple[SpinScore, ...]


def judge_spin(material: SpinMaterial, zero: AngleZero | None = None) -> tuple[SpinVerdict, ...]:
    """Score against the truth, or without one against the encoder, and against the first reference.

    ``zero`` as in :func:`stillpoint.scoring.spin.score_roll`; None takes what is usual for each.
    """
    recording, first = material.recording, material.references[:1]
    made: tuple[SpinReference | Estimate, ...] = (*material.references, *material.estimates)
    judges: list[tuple[str, Encoder | SpinReference | None, tuple[SpinReference | Estimate, ...]]] = [
        ("truth", recording.roll_truth, made),
        ("encoder", recording.encoder if recording.roll_truth is None else None, made),
        *(("", reference, made[1:]) for reference in first),
    ]
    verdicts = []
    for name, truth, judged in judges:
        if truth is None or not judged:
            continue
        comparisons = tuple(
            compare_spin(thing, truth, zero or choose_zero(thing, truth, name), name) for thing in judged
        )
        scores = tuple(score_spin_comparison(c) for c in comparisons)
        verdicts.append(SpinVerdict(comparisons[0].against, truth, comparisons, scores))
    return tuple(verdicts)


def make_spin_report_html(material: SpinMaterial, verdicts: tuple[SpinVerdict, ...]) -> str:
    """Return the page as text; there is at least one verdict. The same material gives the same bytes."""
    made: list[SpinReference | Estimate] = [*material.references, *material.estimates]
    return load_template("stillpoint.scoring.report", "spin_page.html.j2").render(
        colours=COLOURS,
        colours_on_dark=ON_DARK,
        name=material.recording.name,
        facts=_list_facts(material.recording),
        references=[{"name": _get_name(one), "facts": _describe_reference(one)} for one in material.references],
        met={_get_name(one): _describe_estimate(one) for one in material.estimates},
        sections=[
            {
                "against": verdict.against,
                "scores": sorted(verdict.scores, key=lambda s: s.rate_rmse_degps),
                "zero": _describe_zeros(verdict.scores),
            }
            for verdict in verdicts
        ],
        pictures=_make_pictures(material.recording, verdicts[0]),
        files=dict(material.sha256),
        params={_get_name(thing): dict(flatten_params(thing.params)) for thing in made},
        versions=list_versions(),
    )


def _describe_zeros(scores: Sequence[SpinScore]) -> str:
    """Return in words what is subtracted from the angles; by name where it differs."""
    zeros = dict.fromkeys(s.zero for s in scores)
    if len(zeros) == 1:
        return ZERO_WORDS[scores[0].zero]
    return "; ".join(
        f"{', '.join(s.estimated for s in scores if s.zero == zero)}: {ZERO_WORDS[zero]}" for zero in zeros
    )


def _get_name(thing: SpinReference | Estimate) -> str:
    return f"reference ({thing.method})" if isinstance(thing, SpinReference) else thing.name


def _list_facts(recording: Recording) -> dict[str, str]:
    """Return facts about a spin recording by their titles, with its accelerometers."""
    facts = describe_recording(recording)
    assert recording.spin is not None
    geometry = recording.spin.geometry
    arms = (
        f"{k + 1}: arm ({', '.join(f'{x:g}' for x in arm)}) m, axis ({', '.join(f'{x:g}' for x in axis)})"
        for k, (arm, axis) in enumerate(zip(geometry.accel_r_b_m, geometry.accel_axis_b, strict=True))
    )
    return facts | {"accelerometers": "; ".join(arms)}


def _describe_reference(reference: SpinReference) -> dict[str, str]:
    """Return the standard deviations of a reference, and its diagnostics in words."""
    angle_deg, rate_degps = np.rad2deg(reference.angle_sd_rad), np.rad2deg(reference.rate_sd_radps)
    diagnostics = reference.diagnostics
    return {
        "sd of the rate": f"{np.median(rate_degps):.2g} deg/s (median), {rate_degps.max():.2g} deg/s (largest)",
        "sd of the angle": f"{np.median(angle_deg):.2g} deg (median), {angle_deg[-1]:.2g} deg at the end",
        **{key: str(value) for key, value in diagnostics.items() if isinstance(value, str)},
        "met": _describe_counts(diagnostics),
    }


def _describe_estimate(estimate: Estimate) -> str:
    """Return the diagnostics of an estimate in words."""
    words = [str(value) for key, value in estimate.diagnostics.items() if key == "direction"]
    return "; ".join([_describe_counts(estimate.diagnostics), *words])


def _describe_counts(diagnostics: Mapping[str, Any]) -> str:
    """Return the counts of an estimator that are not 0 as text."""
    counts = [f"{key[2:].replace('_', ' ')} {n}" for key, n in diagnostics.items() if key.startswith("n_") and n]
    return ", ".join(counts) or "nothing unusual"


def _make_pictures(recording: Recording, verdict: SpinVerdict) -> list[Picture]:
    """Return figures of rates with their errors, of errors with their stated bands, and of the readings."""
    assert recording.spin is not None
    spin = recording.spin
    zero_ns = int(spin.t_ns[0])
    colours = {c.estimated: k for k, c in enumerate(verdict.comparisons)}
    series = make_rate_series(verdict.truth, verdict.comparisons, zero_ns)
    shown = [
        make_picture(
            "Rate over time",
            f"Above, the rates over the {verdict.against}; below, estimate minus {verdict.against}.",
            1 + len(colours),
            105,
            lambda axes: draw_rates(axes, series, colours, verdict.against),
        )
    ]
    shown += [
        make_picture(
            f"{c.estimated} against the {verdict.against}",
            "Errors of angle and rate"
            + (
                " within the band of three standard deviations that it states."
                if c.angle_sd_rad is not None
                else "; it states no standard deviation."
            ),
            2,
            130,
            _make_band_drawer(c, colours[c.estimated], zero_ns),
        )
        for c in verdict.comparisons
    ]
    sensors = make_picture(
        "What the accelerometers read",
        "Dotted: the range that the recording states.",
        spin.accel_mps2.shape[1],
        120,
        lambda axes: draw_accelerometers(axes, spin),
    )
    return [*shown, sensors]


def _make_band_drawer(comparison: SpinComparison, colour: int, zero_ns: int) -> Callable[[Sequence[Axes]], None]:
    return lambda axes: draw_error_band(axes, comparison, colour, zero_ns)
