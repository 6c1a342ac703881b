"""The HTML page of the servo bench (Byambajav et al.): figures 4 to 7 of the paper, drawn from simulated benches."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from stillpoint.scoring.report.figures import COLOURS, ON_DARK
from stillpoint.scoring.report.pictures import Picture, make_picture
from stillpoint.scoring.report.provenance import list_versions
from stillpoint.scoring.report.templates import load_template
from stillpoint.studies.papers.servo.figures import draw_drift, draw_rolls, draw_sensors
from stillpoint.studies.papers.servo.study import ACC, GYRO, KALMAN, PRINTED_DRIFT_DEG, Trial, find_first_swing_s

_COLOUR = {KALMAN: 0, ACC: 4, GYRO: 5}  # places in COLOURS
_SHOWN_S = 20.0
_ROWS = (
    ("roll", ACC, "acc"),
    ("roll", KALMAN, "kf"),
    ("heading", ACC, "acc_heading"),
    ("heading", KALMAN, "kf_heading"),
)
_STRETCHES = ("rest", "low", "high")


def _find_median(trials: Sequence[Trial], key: str) -> float:
    """Return the median over the trials of the absolute value of a figure."""
    return float(np.median([abs(getattr(one.figures, key)) for one in trials]))


def make_servo_page(trials: Sequence[Trial], command: str, recorded: bool = False) -> str:
    """Return the page as text; the same trials give the same bytes. Recorded ones have several judges."""
    first = [one for one in trials if one.judge == trials[0].judge]
    return load_template("stillpoint.studies.papers.servo", "page.html.j2").render(
        colours=COLOURS,
        colours_on_dark=ON_DARK,
        recorded=recorded,
        trials=len(first),
        names=", ".join(one.name for one in first),
        judges=", ".join(dict.fromkeys(one.judge for one in trials)),
        minutes=f"{trials[0].series.t_s[-1] / 60:.0f}",
        printed_drift=f"{PRINTED_DRIFT_DEG:g}",
        drift=f"{_find_median(first, 'drift_deg'):.0f}",
        drifts=", ".join(f"{one.figures.drift_deg:+.0f}" for one in first),
        rows=make_rows(trials),
        pictures=_draw_pictures(first[0]),
        first_name=first[0].name,
        command=command,
        versions=list_versions(),
    )


def make_rows(trials: Sequence[Trial]) -> list[dict[str, Any]]:
    """Return the rms error (deg) of each angle and method at rest, at the low rate and at the high rate, as medians."""
    by_judge = {judge: [one for one in trials if one.judge == judge] for judge in {one.judge: None for one in trials}}
    return [
        {
            "judge": judge,
            "angle": angle,
            "method": method,
            "colour": _COLOUR[method],
            "cells": [f"{_find_median(some, f'{short}_{stretch}_deg'):.2g}" for stretch in _STRETCHES],
        }
        for judge, some in by_judge.items()
        for angle, method, short in _ROWS
    ]


def _draw_pictures(one: Trial) -> list[Picture]:
    """Return the pictures of a trial, as the paper's figures."""
    series = one.series
    low, high = find_first_swing_s(series, series.low_hz), find_first_swing_s(series, series.high_hz)
    rest_s = series.rests_s[0]
    shown_s = (20.0, 30.0) if rest_s[1] > 30.0 else (float(rest_s[0]), float(rest_s[1]))
    middles = [(sum(span) / 2 - _SHOWN_S / 2, sum(span) / 2 + _SHOWN_S / 2) for span in (low, high)]
    return [
        make_picture(
            "Sensors at rest",
            "As the paper's figure 4: gyro, accelerometer and magnetometer in the first rest.",
            3,
            150,
            lambda axes: draw_sensors(axes, series, shown_s),
        ),
        make_picture(
            "The gyro alone",
            "As the paper's figure 5: the trapezoidal integral (13) over the first minute of swings, and its error.",
            2,
            170,
            lambda axes: draw_drift(axes, series, low, _COLOUR[GYRO]),
        ),
        make_picture(
            "The accelerometer alone",
            f"As the paper's figure 6: (14) at {series.low_hz:.2g} Hz and at {series.high_hz:.2g} Hz.",
            2,
            170,
            lambda axes: draw_rolls(axes, series, {ACC: _COLOUR[ACC]}, middles),
            time_axis=False,
        ),
        make_picture(
            "The Kalman filter beside both",
            "As the paper's last figure: the gyro begins at the left edge with the true angle.",
            2,
            190,
            lambda axes: draw_rolls(axes, series, {m: _COLOUR[m] for m in (ACC, GYRO, KALMAN)}, middles),
            time_axis=False,
        ),
    ]
