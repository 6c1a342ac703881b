"""One self-contained HTML page about a recording: scores, pictures, what was aligned, where everything comes from."""

import platform
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from importlib import metadata
from typing import Any

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined, Template

from stillpoint.datasets.frames import EulerFrame
from stillpoint.datasets.recording import Recording, Truth, rate_hz
from stillpoint.datasets.trajectory import Estimate, Reference
from stillpoint.scoring.align import AlignKind
from stillpoint.scoring.compare import Comparison, compare, name_of
from stillpoint.scoring.report.figures import (
    COLOURS,
    ON_DARK,
    View,
    draw_angles,
    draw_band,
    draw_errors,
    draw_scores,
    view_of,
)
from stillpoint.scoring.report.pictures import Picture, picture
from stillpoint.scoring.report.reference_section import reference_section
from stillpoint.scoring.score import Score, score_of

BUSY_S = 20.0  # length of the stretch that is shown in close-up
VERSIONS_OF = ("stillpoint", "numpy", "scipy", "numba", "gtsam", "vqf", "matplotlib")


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
    return load_template("stillpoint.scoring.report", "page.html.j2").render(
        colours=COLOURS,
        colours_on_dark=ON_DARK,
        name=material.name,
        facts=facts_of_recording(material.recording) if material.recording is not None else {},
        references=[reference_section(reference) for reference in material.references],
        sections=[_section(verdict) for verdict in verdicts],
        shared_gyro=any(isinstance(verdict.truth, Reference) for verdict in verdicts),
        pictures=_pictures(verdicts),
        provenance=_provenance(material),
        versions=versions(),
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


def _pictures(verdicts: tuple[Verdict, ...]) -> list[Picture]:
    """Angles and errors against the first judge, then errors with their stated bands where there are covariances."""
    first = verdicts[0]
    zero_ns = min(int(verdict.truth.t_ns[0]) for verdict in verdicts)
    view = view_of(first.comparisons, first.truth, first.scores[0].frame, zero_ns)
    close = view.busiest(BUSY_S)
    against = name_of(first.truth)
    frame = view.frame.upper()
    angles_note = f"Euler angles in {frame}. Rests are grey. Peaks are kept when samples are thinned out."
    shown = [
        picture(
            f"Angles, the busiest {BUSY_S:g} s",
            f"The stretch in which the {against} turns most. {angles_note}",
            3,
            150,
            lambda axes: draw_angles(axes, close),
        ),
        picture("Angles, whole run", angles_note, 3, 150, lambda axes: draw_angles(axes, view)),
        picture(
            f"Error against the {against}",
            "Total error after alignment, logarithmic; rests are grey and do not count in the scores."
            + (" The grey floor is the reference's own sd." if isinstance(first.truth, Reference) else ""),
            len(view.comparisons),
            105,
            lambda axes: draw_errors(axes, view),
        ),
    ]
    stated = {
        c.estimated: (verdict, c) for verdict in verdicts for c in verdict.comparisons if c.cov_b_rad2 is not None
    }
    shown += [_band(verdict, comparison, zero_ns) for verdict, comparison in stated.values()]
    return shown


def _band(verdict: Verdict, comparison: Comparison, zero_ns: int) -> Picture:
    view: View = view_of([comparison], verdict.truth, verdict.scores[0].frame, zero_ns)
    return picture(
        f"{comparison.estimated} against the {comparison.against}",
        "Error about each axis within the band of three standard deviations that its own covariance states.",
        3,
        120,
        lambda axes: draw_band(axes, view),
    )


def facts_of_recording(recording: Recording) -> dict[str, str]:
    """What the recording is, for the head of a page."""
    info = recording.info
    facts = {
        "duration": f"{recording.duration_s:.1f} s",
        "streams": ", ".join(f"{name} {rate_hz(t_ns):.4g} Hz" for name, t_ns in recording.streams()),
    }
    for title in ("sensor", "source", "date", "licence", "citation"):
        facts[title] = getattr(info, title)
    facts["conversions"] = "; ".join(info.conversions)
    facts["notes"] = "; ".join(info.notes)
    return {title: fact for title, fact in facts.items() if fact}


def _provenance(material: Material) -> dict[str, Any]:
    """Files with their hashes, and parameters of everything that was computed."""
    made: list[Reference | Estimate] = [*material.references, *material.estimates]
    return {
        "files": dict(material.sha256),
        "sources": dict(material.recording.info.sha256) if material.recording is not None else {},
        "params": {name_of(thing): dict(dotted("", thing.params)) for thing in made},
    }


def dotted(prefix: str, params: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Nested parameters in one level: ``rest.window_s``."""
    for key, value in params.items():
        if isinstance(value, Mapping):
            yield from dotted(f"{prefix}{key}.", value)
        else:
            yield f"{prefix}{key}", f"{value:.6g}" if isinstance(value, float) else str(value)


def load_template(package: str, name: str) -> Template:
    """Return a template of ``package``; it may include those beside this module. Undefined names raise an error."""
    return Environment(
        loader=ChoiceLoader([PackageLoader(package, "."), PackageLoader("stillpoint.scoring.report", ".")]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    ).get_template(name)


def versions() -> dict[str, str]:
    """Of stillpoint, Python, and the packages that figures depend on."""
    found = {"python": platform.python_version()}
    for package in VERSIONS_OF:
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            continue
    return found
