"""The HTML page of the mission of Zia 2022: figures 4 to 11 from simulated missions, and its tables."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from stillpoint.scoring.report.figures import COLOURS, ON_DARK
from stillpoint.scoring.report.pictures import Picture, make_picture
from stillpoint.scoring.report.provenance import flatten_params, list_versions
from stillpoint.scoring.report.templates import load_template
from stillpoint.studies.papers.auv.figures import draw_angle, draw_gains, draw_heading_errors, draw_mission, get_gain
from stillpoint.studies.papers.auv.study import (
    ADAPTIVE,
    FIXED,
    GYRO,
    KALMAN,
    METHODS,
    PRINTED,
    PRINTED_FIGURES,
    RAW,
    RECORDED,
    SETTLED_S,
    SURE,
    Trial,
    summarise_trials,
)

_COLOUR = {ADAPTIVE: 1, PRINTED: 3, FIXED: 2, KALMAN: 0, RAW: 4, GYRO: 5, SURE: 6}  # places in COLOURS
_TITLES = {"waves": "In waves", "calm": "In a calm sea", RECORDED: "As recorded"}
# Of a simulated mission the hull's iron and the gyro's bias are inputs, and with them these figures.
INPUTS = {(RAW, "heading_after_deg"), (GYRO, "heading_after_deg"), (GYRO, "heading_drift_deg")}


class _Column(NamedTuple):
    """An error of the study and what the page calls it."""

    key: str
    name: str
    unit: str


COLUMNS = (
    _Column("roll_off_mean_deg", "roll off", "mean, deg"),
    _Column("roll_off_var_deg2", "roll off", "var, deg²"),
    _Column("pitch_off_mean_deg", "pitch off", "mean, deg"),
    _Column("pitch_off_var_deg2", "pitch off", "var, deg²"),
    _Column("surface_roll_rmse_deg", "roll error", "surface, deg"),
    _Column("below_roll_rmse_deg", "roll error", "below, deg"),
    _Column("pitch_rmse_deg", "pitch error", "deg"),
    _Column("heading_after_deg", "heading error", "at 600 s, deg"),
    _Column("heading_drift_deg", "its change", "in 600 s, deg"),
)


def make_auv_page(trials: Mapping[str, Sequence[Trial]], online: bool, command: str) -> str:
    """Return the page as text; ``trials`` by sea, each with at least one. The same trials give the same bytes."""
    first = next(iter(trials.values()))
    kept = [one.series.gains[PRINTED] for some in trials.values() for one in some]
    return load_template("stillpoint.studies.papers.auv", "page.html.j2").render(
        colours=COLOURS,
        colours_on_dark=ON_DARK,
        online=online,
        recorded=RECORDED in trials,
        facts=_list_facts(first, online),
        kept={
            name: f"{_find_largest_change(kept, f'{name}_per_s{power}'):.1g}" for name, power in (("kp", ""), ("ki", 2))
        },
        trials=len(first),
        columns=COLUMNS,
        rows=_make_rows(trials),
        sections=[
            {"sea": sea, "title": f"{_TITLES[sea]}: {one.name}", "pictures": _draw_pictures(one)}
            for sea, some in trials.items()
            for one in (some if sea == RECORDED else some[:1])
        ],
        command=command,
        parameters={
            name: "; ".join(f"{key} = {value}" for key, value in flatten_params(params))
            for name, params in first[0].params.items()
        },
        versions=list_versions(),
    )


def _list_facts(first: Sequence[Trial], online: bool) -> dict[str, str]:
    """Return facts about the trials by their titles, as text."""
    when, recorded = first[0].series.phases_s, first[0].sea == RECORDED
    below_s = when["ascent_s"] - when["cruise_s"]
    return {
        "missions": f"{', '.join(one.name for one in first)}; the first of {when['end_s'] / 60:.3g} min, "
        f"{below_s:.3g} s of it below",
        "computed": "sample by sample in single precision, as on a microcontroller"
        if online
        else "in double precision",
        "heading": "by the GPS course on the surface, by the magnetometer that it calibrated below; "
        f"{RAW} and {GYRO} have the magnetometer as it is",
        "scored": f"against {'the truth or the graph' if recorded else 'the simulated truth'}, and against the "
        f"measured angles, over all samples from {SETTLED_S:g} s on, moving or not",
    }


def _find_largest_change(kept: Sequence[Any], name: str) -> float:
    """Return by how much a gain of eq (22) as printed ever differs from its first value."""
    return max(float(np.abs(get_gain(each, name) - get_gain(each, name)[0]).max()) for each in kept)


def _make_rows(trials: Mapping[str, Sequence[Trial]]) -> list[dict[str, Any]]:
    """Return the rows of the table: the printed figures, then each method in each sea."""
    rows: list[dict[str, Any]] = []
    for place, (name, printed) in enumerate(PRINTED_FIGURES.items()):
        cells = [f"{printed[c.key]:.2g}" if c.key in printed else "–" for c in COLUMNS]
        sea = "the paper" if place == 0 else ""
        rows.append({"sea": sea, "method": name, "cells": cells, "of_paper": True, "first": False, "colour": None})
    for sea_kind, some in trials.items():
        for place, method in enumerate(METHODS):
            cells = [
                f"{summarise_trials(some, method.name, c.key):.2g}"
                + (" (input)" if sea_kind != RECORDED and (method.name, c.key) in INPUTS else "")
                for c in COLUMNS
            ]
            rows.append(
                {
                    "sea": sea_kind if place == 0 else "",
                    "method": method.name,
                    "cells": cells,
                    "of_paper": False,
                    "first": place == 0,
                    "colour": _COLOUR[method.name],
                }
            )
    return rows


def _draw_pictures(one: Trial) -> list[Picture]:
    """Return the pictures of a trial, in the order of the paper's figures."""
    series, sea = one.series, one.sea
    when = series.phases_s
    whole = (float(series.t_s[0]), float(series.t_s[-1]))
    surface = (when["dive_s"] - 40, when["dive_s"] - 10)
    dive = (when["dive_s"] - 10, when["dive_s"] + 20)
    ascent = (when["surfaced_s"] - 25, when["surfaced_s"] + 5)
    shown = {name: _COLOUR[name] for name in (ADAPTIVE, FIXED, KALMAN)}
    headings = {name: _COLOUR[name] for name in (GYRO, RAW, KALMAN, ADAPTIVE)}
    adapted = {name: _COLOUR[name] for name in (PRINTED, ADAPTIVE)}
    mission = make_picture(
        f"The mission ({sea})",
        "As the paper's figures 4 and 5: from start to end, seen from above, and the depth. Grey: under water.",
        2,
        190,
        lambda axes: draw_mission(axes, series),
        time_axis=False,
    )
    return [
        *([] if series.place_n_m is None else [mission]),
        make_picture(
            f"Roll ({sea})",
            "As the paper's figure 6: the mission, and 30 s on the surface. Grey: under water.",
            2,
            190,
            lambda axes: draw_angle(axes, series, 0, shown, (whole, surface)),
            time_axis=False,
        ),
        make_picture(
            f"Pitch ({sea})",
            "As the paper's figure 7: the mission, the beginning of the dive, the end of the ascent.",
            3,
            170,
            lambda axes: draw_angle(axes, series, 1, shown, (whole, dive, ascent)),
            time_axis=False,
        ),
        make_picture(
            f"Heading ({sea})",
            "As the paper's figure 8. There is no course under water.",
            1,
            260,
            lambda axes: draw_angle(axes, series, 2, headings, (whole,)),
        ),
        make_picture(
            f"Heading less the true one ({sea})",
            "As the paper's figure 9; below, the same within 6 deg. The sway of waves turns the course.",
            2,
            180,
            lambda axes: draw_heading_errors(axes, series, headings),
        ),
        make_picture(
            f"Gain kp ({sea})",
            "As the paper's figure 10: by eq (22) as printed, and by the prediction of the next measurement.",
            3,
            130,
            lambda axes: draw_gains(axes, series, "kp_per_s", adapted, "1/s"),
        ),
        make_picture(
            f"Gain kI ({sea})",
            "As the paper's figure 11. Bounds: 1e-5, and kp²/4.",
            3,
            130,
            lambda axes: draw_gains(axes, series, "ki_per_s2", adapted, "1/s²"),
        ),
    ]
