"""The HTML page of an experiment of Elmi Aziz and Mohseni Araste 2021: their tables and figures beside ours."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from stillpoint.scoring.report.figures import COLOURS, ON_DARK
from stillpoint.scoring.report.pictures import Picture, make_picture
from stillpoint.scoring.report.provenance import flatten_params, list_versions
from stillpoint.scoring.report.templates import load_template
from stillpoint.studies.papers.phone.figures import Span, draw_angles, draw_gains, draw_judges, draw_map
from stillpoint.studies.papers.phone.parameters import (
    HIGHEST_HZ,
    LOWEST_HZ,
    OMEGA0_RADPS,
    PRINTED,
    SLOWER,
    ZETA,
    find_frequencies_below_mean,
)
from stillpoint.studies.papers.phone.study import (
    ACC,
    ACC_MA,
    ACC_MA_CENTRED,
    AXES,
    CF,
    CF_LITERAL,
    CF_SLOWER,
    DRIFT_S,
    ESTIMATORS,
    GYRO,
    JUDGES,
    KALMAN,
    KALMAN_AXIS,
    LEAD_S,
    METHODS,
    PRINTED_KALMAN_GAIN,
    RECORDED,
    RUNS,
    LongRun,
    Scenario,
    Trial,
    compute_mean,
    compute_rms_drift_deg,
)

_COLOUR = {CF: 0, ACC: 1, ACC_MA: 2, KALMAN: 3, GYRO: 4, CF_SLOWER: 5, CF_LITERAL: 6, KALMAN_AXIS: 7}  # in COLOURS
_SHORT = {ACC: "acc", ACC_MA: "ma"}  # in the text
_OF_JUDGE = {"benchmark": 1, "graph": 0}
_EULER = tuple(f"{axis}_{figure}_deg" for axis in AXES for figure in ("rmse", "maxae"))  # as the paper's tables
_BESIDE = ("inclination_rmse_deg", "heading_rmse_deg")


class _Shown(NamedTuple):
    """One of the paper's figures."""

    number: str
    title: str
    methods: tuple[str, ...]
    parts: tuple[str, ...]
    span: Span | None  # None: the whole recording


_FIGURES: dict[str, tuple[_Shown, ...]] = {
    "phone-1": (
        _Shown("5", "CF and Acc", (ACC, CF), AXES, None),
        _Shown("6", "Roll, CF and Acc", (ACC, CF), ("roll",), (10.0, 20.0)),
        _Shown("7", "Roll, CF and Acc_MA", (ACC_MA, CF), ("roll",), (10.0, 30.0)),
        _Shown("8", "Yaw by all", (ACC, ACC_MA, CF), ("yaw",), (10.0, 20.0)),
    ),
    "phone-2": (
        _Shown("10", "The gyro alone", (GYRO,), AXES, (LEAD_S, LEAD_S + DRIFT_S)),
        _Shown("11", "CF and Acc", (ACC, CF), AXES, None),
        _Shown("12", "Roll, CF and Acc", (ACC, CF), ("roll",), (35.0, 45.0)),
    ),
    "phone-3": (
        _Shown("13", "The benchmark", (), AXES, None),
        _Shown("14", "Roll by Acc", (ACC,), ("roll",), (10.0, 30.0)),
        _Shown("15", "Roll by CF", (CF,), ("roll",), (10.0, 30.0)),
    ),
}


def make_phone_page(
    scenario: Scenario,
    trials: Mapping[str, Sequence[Trial]],
    long_runs: Sequence[LongRun],
    minutes: float,
    command: str,
) -> str:
    """Return the page; ``trials`` by how the phone is moved, each with at least one; ``long_runs`` of ``minutes``.

    Recorded trials are those of the hand RECORDED.
    """
    first = next(iter(trials.values()))
    below = {"printed": find_frequencies_below_mean(PRINTED), "slower": find_frequencies_below_mean(SLOWER)}
    return load_template("stillpoint.studies.papers.phone", "page.html.j2").render(
        colours=COLOURS,
        colours_on_dark=ON_DARK,
        scenario=scenario,
        facts=_list_facts(first),
        rows=make_method_rows(scenario, trials),
        judges=make_judge_rows(trials),
        drifts=[(hand, *(f"{x:.1f}" for x in compute_rms_drift_deg(some))) for hand, some in trials.items()],
        found={hand: _quote_figures(some) for hand, some in trials.items()},
        recorded=RECORDED in trials,
        has_benchmark=all(_find_judge(some) == "benchmark" for some in trials.values()),
        has_truth=all(_has_truth(some) for some in trials.values()),
        mag_left_out=[one.name for some in trials.values() for one in some if one.mag_left_out],
        gain={name: f"{int(some.sum())}" for name, some in below.items()}
        | {"count": len(below["printed"]), "low": f"{LOWEST_HZ:g}", "high": f"{HIGHEST_HZ:g}"},
        gains=_draw_gain_picture(),
        maps={hand: _draw_map_picture(scenario, hand, some) for hand, some in trials.items()},
        long_hand=next(iter(trials)),
        runs=RUNS,
        kalman_gain=PRINTED_KALMAN_GAIN,
        long_runs=long_runs,
        slower=[run.ns_per_sample / long_runs[0].ns_per_sample for run in long_runs],
        minutes=minutes,
        sections=[
            {"hand": hand, "name": one.name, "pictures": _draw_pictures(scenario, one)}
            for hand, some in trials.items()
            for one in (some if hand == RECORDED else some[:1])
        ],
        command=command,
        parameters={
            name: "; ".join(f"{key} = {value}" for key, value in flatten_params(params))
            for name, params in first[0].params.items()
        },
        versions=list_versions(),
    )


def make_method_rows(scenario: Scenario, trials: Mapping[str, Sequence[Trial]]) -> list[dict[str, Any]]:
    """Return the paper's rows, then each method against each judge: errors of each angle, tilt and heading."""
    rows = [
        {"hand": "the paper", "judge": "its benchmark", "method": method, "euler": printed, "beside": (None, None)}
        for method, printed in scenario.printed.items()
    ]
    for hand, some in trials.items():
        judges = [judge for judge in JUDGES if all((CF, judge) in one.scores for one in some)]
        rows += [_make_row(some, hand, method, judge) for judge in judges for method in METHODS]
    return [_mark_row(row, rows[k - 1] if k else None) for k, row in enumerate(rows)]


def make_judge_rows(trials: Mapping[str, Sequence[Trial]]) -> list[dict[str, Any]]:
    """Return the errors of the judges: benchmark and graph against the truth, and against each other."""
    pairs = (("benchmark", "truth"), ("graph", "truth"), ("benchmark", "graph"))
    rows = []
    for hand, some in trials.items():
        for name, judge in pairs:
            if not all((name, judge) in one.scores for one in some):
                continue
            tilt = float(np.mean([one.common_tilt_deg[name] for one in some])) if judge == "truth" else None
            rows.append(_make_row(some, hand, name, judge) | {"common_tilt_deg": tilt})
    return [_mark_row(row, rows[k - 1] if k else None) for k, row in enumerate(rows)]


def _make_row(trials: Sequence[Trial], hand: str, method: str, judge: str) -> dict[str, Any]:
    """Return a row of the table: errors about each Euler angle, total, heading and inclination."""
    return {
        "hand": hand,
        "judge": judge,
        "method": method,
        "euler": tuple(compute_mean(trials, method, judge, figure) for figure in _EULER),
        "beside": tuple(compute_mean(trials, method, judge, figure) for figure in _BESIDE),
    }


def _mark_row(row: dict[str, Any], above: dict[str, Any] | None) -> dict[str, Any]:
    """Return the row with its colour, and whether it begins a block."""
    new = above is None or (row["hand"], row["judge"]) != (above["hand"], above["judge"])
    return row | {"first": new, "of_paper": row["hand"] == "the paper", "colour": _COLOUR.get(row["method"])}


def _has_truth(trials: Sequence[Trial]) -> bool:
    return all((CF, "truth") in one.scores for one in trials)


def _find_judge(trials: Sequence[Trial]) -> str:
    """Return the benchmark, or the graph where there is none."""
    return "benchmark" if all((CF, "benchmark") in one.scores for one in trials) else "graph"


def _list_facts(first: Sequence[Trial]) -> dict[str, str]:
    """Return facts about the trials by their titles, as text."""
    series, score = first[0].series, first[0].scores[CF, _find_judge(first)]
    pitched = max(one.scores[CF, _find_judge(first)].near_gimbal_share for one in first)
    long_min = (series.t_s[-1] - series.t_s[0]) / 60
    used = [
        f"{method} ({' '.join([name, *(f'{key}={value:g}' for key, value in params.items())])})"
        for method, (name, params) in ESTIMATORS.items()
    ]
    return {
        "trials": f"{', '.join(one.name for one in first)}; the first of {long_min:.1f} min",
        "methods": f"{', '.join(used)}; {ACC_MA_CENTRED} is Acc_MA with the stamp of the middle of its window",
        "scored": f"over the moving samples ({100 * score.moving_share:.0f} % of the first run), nothing aligned; "
        f"Euler angles North-West-Up; {100 * pitched:.1f} % of the samples pitch beyond 80 deg at most",
        "references": "made from the recording alone, without a base pose that it may know"
        + "".join(f"; {one.name} has no {name}: {why}" for one in first for name, why in one.refused.items()),
    }


def _quote_figures(trials: Sequence[Trial]) -> dict[str, str]:
    """Return the figures that the text of the page quotes."""
    quoted = {
        f"{name}_{part}": (method, judge, f"{part}_rmse_deg")
        for name, method, judge in (
            ("cf", CF, "benchmark"),
            ("acc", ACC, "benchmark"),
            ("ma", ACC_MA, "benchmark"),
            ("centred", ACC_MA_CENTRED, "benchmark"),
            ("slow", CF_SLOWER, "benchmark"),
            ("literal", CF_LITERAL, "benchmark"),
            ("kalman", KALMAN, "benchmark"),
            ("kalman_true", KALMAN, "truth"),
            ("bench", "benchmark", "truth"),
            ("graph", "graph", "truth"),
        )
        for part in ("roll", "pitch", "yaw", "heading", "inclination")
        if all((method, judge) in one.scores for one in trials)
    }
    figures = {name: compute_mean(trials, *place) for name, place in quoted.items()}
    at = OMEGA0_RADPS.index(SLOWER.omega0_radps), ZETA.index(SLOWER.zeta)
    all_deg = np.mean([one.map_deg[at] for one in trials], axis=0)
    figures |= {f"slow_all_{axis}": float(error) for axis, error in zip(AXES, all_deg, strict=True)}
    scored = [one.scores[CF_SLOWER, _find_judge(trials)] for one in trials]
    figures["slow_left_out"] = 100 * float(
        np.mean([s.samples_unready / (s.samples_unready + s.samples) for s in scored])
    )
    for method in (ACC, ACC_MA):
        folded = np.mean([one.folded_yaw[method] for one in trials], axis=0)
        figures |= zip((f"{_SHORT[method]}_folded", f"{_SHORT[method]}_folded_max"), folded, strict=True)
    return {name: f"{figure:.2f}" if figure < 10 else f"{figure:.1f}" for name, figure in figures.items()}


def _draw_pictures(scenario: Scenario, one: Trial) -> list[Picture]:
    """Return the pictures of a trial, as the paper's figures."""
    series = one.series
    whole = (0.0, float(series.t_s[-1]))
    drawn = [_draw_picture(one, shown, whole) for shown in _FIGURES[scenario.name]]
    if not series.errors:
        return drawn
    made = {name: colour for name, colour in _OF_JUDGE.items() if name in series.errors}  # one of them may be refused
    judges = make_picture(
        f"The error of the {' and the '.join(made)} ({one.hand})",
        "Total error of each reference against the truth, which the paper could not draw. Rests are grey.",
        1,
        200,
        lambda axes: draw_judges(axes[0], series, made),
    )
    return [*drawn, judges]


def _draw_picture(one: Trial, shown: _Shown, whole: Span) -> Picture:
    """Return one picture of a trial over a span of time in s."""
    return make_picture(
        f"{shown.title} ({one.hand})",
        f"As the paper's figure {shown.number}: {one.name}, seconds from {LEAD_S:g} s before the first motion. "
        "Rests are grey.",
        len(shown.parts),
        230 if len(shown.parts) == 1 else 140,
        lambda axes: draw_angles(
            axes, one.series, {name: _COLOUR[name] for name in shown.methods}, shown.parts, shown.span or whole
        ),
    )


def _draw_gain_picture() -> Picture:
    """Return the picture of the gains over frequency."""
    return make_picture(
        "Gain of CF and of the moving average",
        "Size of F(jω) for the printed parameters and for a slower pair, and of a mean over 7 s.",
        1,
        260,
        lambda axes: draw_gains(axes[0]),
        time_axis=False,
    )


def _draw_map_picture(scenario: Scenario, hand: str, trials: Sequence[Trial]) -> Picture:
    """Return the picture of the RMSE in deg over the two parameters of CF."""
    map_deg = np.mean([one.map_deg for one in trials], axis=0)
    printed = [value for value in scenario.printed[CF][::2] if value is not None]
    return make_picture(
        f"RMSE of CF over its two parameters ({hand})",
        "Against the benchmark over all moving samples, also those of the start; deg, mean over the trials. Framed: "
        "the printed pair (ω₀ = 0.25, ζ = 3), and ω₀ = 0.08, ζ = 0.707.",
        3,
        210,
        lambda axes: draw_map(axes, map_deg, printed),
        time_axis=False,
    )
