"""One self-contained HTML page about a recording: scores, pictures, what was aligned, where everything comes from."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from stillpoint.datasets.frames import EulerFrame
from stillpoint.datasets.recording import Recording, Truth
from stillpoint.datasets.trajectory import Estimate, Reference
from stillpoint.scoring.align import AlignKind
from stillpoint.scoring.compare import Comparison, compare, name_of
from stillpoint.scoring.report.figures import COLOURS, ON_DARK, draw_scores
from stillpoint.scoring.report.pictures import picture
from stillpoint.scoring.report.plot_data import BIAS_PANELS, FIELD_PANELS, Panel, plots_payload, run_plots
from stillpoint.scoring.report.provenance import describe_recording, flatten_params, list_versions
from stillpoint.scoring.report.reference_section import reference_section
from stillpoint.scoring.report.templates import bokeh_scripts, embed_json, load_template, page_script
from stillpoint.scoring.score import Score, score_of


@dataclass(frozen=True, eq=False)
class Material:
    """What there is about one recording. The first of ``references`` and ``recording.truth`` judge the rest."""

    name: str
    recording: Recording | None = None
    references: tuple[Reference, ...] = ()
    estimates: tuple[Estimate, ...] = ()
    sha256: Mapping[str, str] = field(default_factory=dict)  # of the files this was read from, by name


@dataclass(frozen=True, eq=False)
class Verdict:
    """Everything that can be scored against one reference or truth."""

    truth: Reference | Truth
    comparisons: tuple[Comparison, ...]
    scores: tuple[Score, ...]


def judge(material: Material, align: AlignKind = "heading", frame: EulerFrame = "nwu") -> tuple[Verdict, ...]:
    """Score everything else against the first reference, and everything against the truth, where these are there."""
    judges: list[tuple[Reference | Truth, tuple[Reference | Estimate, ...]]] = [
        (first, (*material.references[1:], *material.estimates)) for first in material.references[:1]
    ]
    if material.recording is not None and material.recording.truth is not None:
        judges.append((material.recording.truth, (*material.references, *material.estimates)))
    verdicts = []
    for truth, judged in judges:
        comparisons = tuple(compare(thing, truth, align) for thing in judged)
        if comparisons:
            verdicts.append(Verdict(truth, comparisons, tuple(score_of(c, frame) for c in comparisons)))
    return tuple(verdicts)


def report_html(material: Material, verdicts: tuple[Verdict, ...]) -> str:
    """The page as text. The same material gives the same bytes."""
    panels, entries = _plots(material, verdicts)
    series = list(dict.fromkeys(c.estimated for verdict in verdicts for c in verdict.comparisons))
    keys = {panel.key for panel in panels}
    return load_template("stillpoint.scoring.report", "page.html.j2").render(
        colours=COLOURS,
        colours_on_dark=ON_DARK,
        name=material.name,
        facts=describe_recording(material.recording) if material.recording is not None else {},
        references=[reference_section(reference) for reference in material.references],
        sections=[_section(verdict) for verdict in verdicts],
        shared_gyro=any(isinstance(verdict.truth, Reference) for verdict in verdicts),
        judges=list(entries),
        frame=verdicts[0].scores[0].frame,
        has_bias=any(panel.key in keys for panel in BIAS_PANELS),
        has_field=any(panel.key in keys for panel in FIELD_PANELS),
        series=series,
        provenance=_provenance(material),
        versions=list_versions(),
        data=embed_json(plots_payload(panels, series, entries)),
        bokeh=bokeh_scripts(),
        script=page_script(),
    )


def _section(verdict: Verdict) -> dict[str, Any]:
    """Table and dots of one verdict, best first."""
    ordered = sorted(verdict.scores, key=lambda s: s.total_rmse_deg)
    shown = picture(
        f"Scores against the {name_of(verdict.truth)}",
        "RMSE on a logarithmic axis."
        + (" Grey: below the reference's own standard deviation." if isinstance(verdict.truth, Reference) else ""),
        1,
        46 * len(ordered) + 20,
        lambda axes: draw_scores(axes[0], ordered),
        time_axis=False,
    )
    return {"against": name_of(verdict.truth), "scores": ordered, "picture": shown}


def _plots(material: Material, verdicts: tuple[Verdict, ...]) -> tuple[list[Panel], dict[str, Any]]:
    """The panels that any verdict has curves for, and an entry of curves per judge."""
    panels: dict[Panel, None] = {}
    entries = {}
    first = material.references[0] if material.references else None
    for verdict in verdicts:
        comparisons = {c.estimated: c for c in verdict.comparisons}
        shown, entry = run_plots(
            comparisons, verdict.truth, verdict.scores[0].frame, material.recording, material.estimates, first
        )
        panels |= dict.fromkeys(shown)
        entries[name_of(verdict.truth)] = entry
    return list(panels), entries


def _provenance(material: Material) -> dict[str, Any]:
    """Files with their hashes, and parameters of everything that was computed."""
    made: list[Reference | Estimate] = [*material.references, *material.estimates]
    return {
        "files": dict(material.sha256),
        "sources": dict(material.recording.info.sha256) if material.recording is not None else {},
        "params": {name_of(thing): dict(flatten_params(thing.params)) for thing in made},
    }
