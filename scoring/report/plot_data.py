"""The data of interactive plots of one recording: the panels, and curves by panel and estimator."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

from stillpoint.datasets.frames import EulerFrame, euler, rotation
from stillpoint.datasets.recording import Floats, Recording, Times, Truth
from stillpoint.datasets.trajectory import Estimate, Reference, compute_total_sd_rad
from stillpoint.scoring.compare import Comparison, find_moving
from stillpoint.scoring.errors import compute_attitude_error, compute_rotation_error_n
from stillpoint.scoring.match import Mask
from stillpoint.scoring.report.curves import Curve, encode_curve, reduce_angle, reduce_series

_JUDGE = "judge"  # the key of the judge's own curve, beside the names of the estimators
_BAND_SDS = 3.0  # standard deviations that a band shows
_CURVE_BYTES = 1_000_000  # of all curves of one recording against one judge
_FEWEST_COLUMNS, _MOST_COLUMNS = 500, 8000
_BYTES_PER_COLUMN = 8  # three 16-bit integers in base64

Curves = dict[str, dict[str, dict[str, Any]]]  # panel -> series -> encoded curve


@dataclass(frozen=True)
class Panel:
    """One plot over time."""

    key: str  # of its curves in the page's data
    title: str
    unit: str
    scale: Literal["log", "linear"] = "linear"
    judge: Literal["line", "band"] = "band"  # how the judge's own curve is drawn
    height: int = 220


ERROR_PANELS = (
    Panel("total", "Total error", "deg", "log", height=280),
    Panel("heading", "Heading error", "deg", "log"),
    Panel("inclination", "Inclination error", "deg", "log"),
)
_ANGLE_PANELS = tuple(Panel(name, name.capitalize(), "deg", judge="line") for name in ("roll", "pitch", "yaw"))
_AXIS_PANELS = tuple(Panel(name, f"Error about {name}", "deg", height=190) for name in ("east", "north", "up"))
BIAS_PANELS = tuple(Panel(f"bias_{axis}", f"Gyro bias {axis}", "deg/s", judge="line", height=190) for axis in "xyz")
FIELD_PANELS = (
    Panel("field", "Strength of the magnetic field", "µT", judge="line", height=190),
    Panel("dip", "Dip of the magnetic field", "deg", judge="line", height=190),
)


def reduce_errors(comparison: Comparison, zero_ns: int, columns: int) -> dict[str, Curve]:
    """Return curves of the total, heading and inclination error; ``total:sd`` and so on are the judge's band."""
    error = compute_attitude_error(comparison.q_est, comparison.q_true)
    curves = {}
    for panel in ERROR_PANELS:
        size_deg = np.rad2deg(getattr(error, f"{panel.key}_rad"))
        curves[panel.key] = reduce_series(comparison.t_ns, size_deg, zero_ns, columns, "rms")
        if comparison.true_cov_b_rad2 is not None:
            band_deg = _BAND_SDS * np.rad2deg(_compute_judge_sd_rad(comparison, panel.key))
            curves[f"{panel.key}:sd"] = reduce_series(comparison.t_ns, band_deg, zero_ns, columns, "rms")
    return curves


def encode_errors(reduced: Mapping[str, Mapping[str, Curve]]) -> Curves:
    """Encode the curves of :func:`reduce_errors` by label. The judge's band is the same for all, so one is kept."""
    curves: Curves = {}
    for label, of_label in reduced.items():
        for key, curve in of_label.items():
            if key.endswith(":sd"):
                curves.setdefault(key, {_JUDGE: encode_curve(curve, "log")})
            else:
                curves.setdefault(key, {})[label] = encode_curve(curve, "log")
    return curves


def make_recording_entry(span_s: tuple[float, float], rests_s: Floats, curves: Curves) -> dict[str, Any]:
    """Return the entry of one recording in a page's data: its span, its rests (R, 2), and its curves."""
    return {"span": list(span_s), "rests": np.round(rests_s, 3).tolist(), "curves": curves}


def find_rest_spans(truth: Reference | Truth) -> Times:
    """Return first and last stamp (R, 2) of each rest. A truth rests where it does not count as moving."""
    return truth.rests_ns if isinstance(truth, Reference) else find_spans(~find_moving(truth), truth.t_ns)


def find_spans(chosen: Mask, t_ns: Times) -> Times:
    """Return first and last stamp (R, 2) of each unbroken run of chosen samples (N,)."""
    edges = np.diff(chosen.astype(np.int8), prepend=0, append=0)
    first, last = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1
    return np.stack([t_ns[first], t_ns[last]], axis=1)


def make_run_plots(
    comparisons: Mapping[str, Comparison],
    truth: Reference | Truth,
    frame: EulerFrame,
    recording: Recording | None = None,
    estimates: Sequence[Estimate] = (),
    reference: Reference | None = None,
) -> tuple[tuple[Panel, ...], dict[str, Any]]:
    """Return the panels that the material has curves for, and the recording's entry in the page's data."""
    zero_ns = int(truth.t_ns[0])
    panels = (*ERROR_PANELS, *_ANGLE_PANELS, *_AXIS_PANELS)
    columns = _choose_columns(len(panels) * (len(comparisons) + 1))
    curves = encode_errors({name: reduce_errors(c, zero_ns, columns) for name, c in comparisons.items()})
    curves |= _make_angle_curves(comparisons, truth, frame, zero_ns, columns)
    curves |= _make_axis_curves(comparisons, zero_ns, columns)
    biases = {_JUDGE: reference, **{each.name: each for each in estimates}}
    curves |= _make_bias_curves({name: made for name, made in biases.items() if made is not None}, zero_ns, columns)
    if recording is not None and recording.mag is not None and reference is not None:
        curves |= _make_field_curves(recording, reference, zero_ns, columns)
    shown = tuple(panel for panel in (*panels, *BIAS_PANELS, *FIELD_PANELS) if curves.get(panel.key))
    rests_s = (find_rest_spans(truth) - zero_ns) / 1e9
    return shown, make_recording_entry((0.0, float(truth.t_ns[-1] - zero_ns) / 1e9), rests_s, curves)


def make_page_data(
    panels: Sequence[Panel], series: Sequence[str], recordings: Mapping[str, Any], **more: Any
) -> dict[str, Any]:
    """Return the data of a page as ``page.js`` reads it."""
    return {"panels": [asdict(panel) for panel in panels], "series": list(series), "recordings": recordings, **more}


def _choose_columns(series: int) -> int:
    return int(np.clip(_CURVE_BYTES // (_BYTES_PER_COLUMN * max(series, 1)), _FEWEST_COLUMNS, _MOST_COLUMNS))


def _compute_judge_sd_rad(comparison: Comparison, what: str) -> Floats:
    """Return the judge's own standard deviation (N,) of total, heading or inclination."""
    cov_b = comparison.true_cov_b_rad2
    assert cov_b is not None
    if what == "total":
        return compute_total_sd_rad(cov_b)
    to_n = rotation(comparison.q_true).as_matrix()
    variance_n = np.einsum("nij,njk,nik->ni", to_n, cov_b, to_n)
    return np.sqrt(variance_n[:, 2] if what == "heading" else variance_n[:, 0] + variance_n[:, 1])


def _make_angle_curves(
    comparisons: Mapping[str, Comparison], truth: Reference | Truth, frame: EulerFrame, zero_ns: int, columns: int
) -> Curves:
    """Return the curves of roll, pitch and yaw in deg of the judge and of each estimate."""
    curves: Curves = {panel.key: {} for panel in _ANGLE_PANELS}
    attitudes = {_JUDGE: (truth.t_ns, truth.q_nb), **{name: (c.t_ns, c.q_est) for name, c in comparisons.items()}}
    for name, (t_ns, q_nb) in attitudes.items():
        for panel, angle_rad in zip(_ANGLE_PANELS, euler(q_nb, frame).T, strict=True):
            curves[panel.key][name] = encode_curve(reduce_angle(t_ns, np.rad2deg(angle_rad), zero_ns, columns))
    return curves


def _make_axis_curves(comparisons: Mapping[str, Comparison], zero_ns: int, columns: int) -> Curves:
    """Return signed errors about east, north and up, and three standard deviations where an estimate states them."""
    curves: Curves = {panel.key: {} for panel in _AXIS_PANELS}
    curves |= {f"{panel.key}:sd": {} for panel in _AXIS_PANELS}
    for name, comparison in comparisons.items():
        error_deg = np.rad2deg(compute_rotation_error_n(comparison.q_est, comparison.q_true))
        for axis, panel in enumerate(_AXIS_PANELS):
            reduced = reduce_angle(comparison.t_ns, error_deg[:, axis], zero_ns, columns)
            curves[panel.key][name] = encode_curve(reduced)
            if comparison.cov_b_rad2 is None:
                continue
            row = rotation(comparison.q_est).as_matrix()[:, axis]
            sd_deg = np.rad2deg(np.sqrt(np.einsum("ni,nij,nj->n", row, comparison.cov_b_rad2, row)))
            band = reduce_series(comparison.t_ns, _BAND_SDS * sd_deg, zero_ns, columns)
            curves[f"{panel.key}:sd"][name] = encode_curve(band)
    return curves


def _make_bias_curves(made: Mapping[str, Estimate | Reference], zero_ns: int, columns: int) -> Curves:
    """Return the curves of the gyro bias in deg/s of everything that states one."""
    curves: Curves = {panel.key: {} for panel in BIAS_PANELS}
    for name, thing in made.items():
        if thing.gyro_bias_b_radps is None:
            continue
        for panel, bias_radps in zip(BIAS_PANELS, thing.gyro_bias_b_radps.T, strict=True):
            curves[panel.key][name] = encode_curve(reduce_series(thing.t_ns, np.rad2deg(bias_radps), zero_ns, columns))
    return curves


def _make_field_curves(recording: Recording, reference: Reference, zero_ns: int, columns: int) -> Curves:
    """Return strength and dip of the magnetic field by the reference's calibration and attitude."""
    mag = recording.mag
    if mag is None:
        return {}
    within = (mag.t_ns >= reference.t_ns[0]) & (mag.t_ns <= reference.t_ns[-1])
    t_ns, field_b_ut = mag.t_ns[within], mag.mag_b_ut[within]
    if len(t_ns) == 0:
        return {}
    found = reference.calibration
    if found.hard_iron_b_ut is not None:
        field_b_ut = field_b_ut - found.hard_iron_b_ut
    if found.mag_matrix is not None:
        field_b_ut = field_b_ut @ found.mag_matrix.T
    nearest = np.clip(np.searchsorted(reference.t_ns, t_ns), 0, len(reference.t_ns) - 1)
    field_n_ut = rotation(reference.q_nb[nearest]).apply(field_b_ut.copy())
    strength_ut = np.linalg.norm(field_n_ut, axis=1)
    dip_deg = np.rad2deg(np.arctan2(-field_n_ut[:, 2], np.hypot(field_n_ut[:, 0], field_n_ut[:, 1])))
    return {
        "field": {_JUDGE: encode_curve(reduce_series(t_ns, strength_ut, zero_ns, columns))},
        "dip": {_JUDGE: encode_curve(reduce_series(t_ns, dip_deg, zero_ns, columns))},
    }
