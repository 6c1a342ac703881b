"""The report of a recording: one HTML page with scores, plots, alignment and provenance, which needs no network."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from stillpoint.datasets.frames import EulerFrame
from stillpoint.datasets.recording import Recording, Truth
from stillpoint.datasets.trajectory import Estimate, Reference
from stillpoint.scoring.align import AlignKind
from stillpoint.scoring.compare import Comparison, compare, name_of
from stillpoint.scoring.report.figures import COLOURS, ON_DARK, draw_scores
from stillpoint.scoring.report.pictures import make_picture
from stillpoint.scoring.report.plot_data import BIAS_PANELS, FIELD_PANELS, Panel, make_page_data, make_run_plots
from stillpoint.scoring.report.provenance import describe_recording, flatten_params, list_versions
from stillpoint.scoring.report.reference_section import describe_reference
from stillpoint.scoring.report.templates import embed_json, load_bokeh_scripts, load_page_script, load_template
from stillpoint.scoring.score import Score, score_of


@dataclass(frozen=True, eq=False)
class Material:
    """A recording with what was made of it. The first of ``references`` and ``recording.truth`` judge the rest."""

    name: str
    recording: Recording | None = None
    references: tuple[Reference, ...] = ()
    estimates: tuple[Estimate, ...] = ()
    sha256: Mapping[str, str] = field(default_factory=dict)  # of the files this was read from, by name


@dataclass(frozen=True, eq=False)
class Verdict:
    """The scores of everything that one reference or truth judges."""

    truth: Reference | Truth
    comparisons: tuple[Comparison, ...]
    scores: tuple[Score, ...]


def judge(material: Material, align: AlignKind = "heading", frame: EulerFrame = "nwu") -> tuple[Verdict, ...]:
    """Score against the first reference and the truth, where they exist; a reference does not judge itself."""
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


def make_report_html(material: Material, verdicts: tuple[Verdict, ...], home: str = "") -> str:
    """Return the page as text; ``home`` is the address of the page that it belongs to.

    The same material gives the same bytes.
    """
    panels, entries = _make_plots(material, verdicts)
    series = list(dict.fromkeys(c.estimated for verdict in verdicts for c in verdict.comparisons))
    keys = {panel.key for panel in panels}
    return load_template("stillpoint.scoring.report", "page.html.j2").render(
        colours=COLOURS,
        colours_on_dark=ON_DARK,
        name=material.name,
        home=home,
        facts=describe_recording(material.recording) if material.recording is not None else {},
        references=[describe_reference(reference) for reference in material.references],
        sections=[_make_section(verdict) for verdict in verdicts],
        shared_gyro=any(isinstance(verdict.truth, Reference) for verdict in verdicts),
        judges=list(entries),
        frame=verdicts[0].scores[0].frame,
        has_bias=any(panel.key in keys for panel in BIAS_PANELS),
        has_field=any(panel.key in keys for panel in FIELD_PANELS),
        series=series,
        provenance=_list_provenance(material),
        versions=list_versions(),
        data=embed_json(make_page_data(panels, series, entries)),
        bokeh=load_bokeh_scripts(),
        script=load_page_script(),
    )


def _make_section(verdict: Verdict) -> dict[str, Any]:
    """Return the table and the figure of one verdict, best first."""
    ordered = sorted(verdict.scores, key=lambda s: s.total_rmse_deg)
    shown = make_picture(
        f"Scores against the {name_of(verdict.truth)}",
        "RMSE on a logarithmic axis."
        + (" Grey: below the reference's own standard deviation." if isinstance(verdict.truth, Reference) else ""),
        1,
        46 * len(ordered) + 20,
        lambda axes: draw_scores(axes[0], ordered),
        time_axis=False,
    )
    return {"against": name_of(verdict.truth), "scores": ordered, "picture": shown}


def _make_plots(material: Material, verdicts: tuple[Verdict, ...]) -> tuple[list[Panel], dict[str, Any]]:
    """Return the panels that any verdict has curves for, and an entry of curves per judge."""
    panels: dict[Panel, None] = {}
    entries = {}
    first = material.references[0] if material.references else None
    for verdict in verdicts:
        comparisons = {c.estimated: c for c in verdict.comparisons}
        shown, entry = make_run_plots(
            comparisons, verdict.truth, verdict.scores[0].frame, material.recording, material.estimates, first
        )
        panels |= dict.fromkeys(shown)
        entries[name_of(verdict.truth)] = entry
    return list(panels), entries


def _list_provenance(material: Material) -> dict[str, Any]:
    """Return files with their hashes, and the parameters of everything that was computed."""
    made: list[Reference | Estimate] = [*material.references, *material.estimates]
    return {
        "files": dict(material.sha256),
        "sources": dict(material.recording.info.sha256) if material.recording is not None else {},
        "params": {name_of(thing): dict(flatten_params(thing.params)) for thing in made},
    }
