"""``stillpoint spin design``: how accurate a rig is over the places of its accelerometers."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from stillpoint.datasets.constants import STANDARD_GRAVITY_MPS2
from stillpoint.scoring.report.printed import save_figure
from stillpoint.scripts.shared.flags import OutDir
from stillpoint.scripts.shared.inputs import make_output_dir
from stillpoint.scripts.shared.output import STDOUT, JsonFile, print_line, write_json
from stillpoint.scripts.shared.tables import print_table
from stillpoint.studies.rig.design import Placement, Rig, compute_limits_m, evaluate_placement, find_longest_arms
from stillpoint.studies.rig.figures import DPI, STYLE, draw_both, draw_radial, draw_tangential

_DESIGN_COLUMNS = (
    "d1, m",
    "d2, m",
    "F4, % of range",
    "F5, %",
    "fits",
    "R",
    "Q",
    "one sample",
    "filtered",
    "per mg",
    "per mm",
)


def spin_design(
    *,
    geometry: str = "bench",
    fastest_degps: float = 2000.0,
    spin_up_s: float = 0.2,
    range_g: float = 16.0,
    headroom: float = 0.2,
    room_m: float = 0.5,
    radial_var: float = 0.8,
    tangential_var: float = 0.12,
    period_s: float = 0.004,
    out: OutDir = Path(),
    json: JsonFile = None,
) -> None:
    """Show accuracy over the arms d1 of F4 and d2 of F5, with the range's limit (Asghari et al. 2018, section 3.2).

    Writes spin-design.png and spin-design.json. The first row is the most accurate placement that fits. Errors of the
    rate are in deg/s at the fastest rate: one sample, filtered, for each mg of F4's bias, for each mm of d1's error.

    Parameters
    ----------
    geometry
        bench (F4, F5 on a shaft) or five (with three at the centre).
    fastest_degps
        The fastest spin.
    spin_up_s
        Time from standstill to it.
    range_g
        Range of the accelerometers.
    headroom
        Share of the range to be left for ripple.
    room_m
        The longest arm there is room for.
    radial_var
        Noise variance D4 of F4, (m/s^2)^2.
    tangential_var
        Noise variance D5 of F5 and of those at the centre.
    period_s
        Time between samples.
    out
        Folder to write into; made when it is not there.
    json
        Also write the rows to this file; - is the standard output.
    """
    rig = Rig(
        geometry=geometry,
        fastest_radps=float(np.deg2rad(fastest_degps)),
        spin_up_s=spin_up_s,
        range_mps2=range_g * STANDARD_GRAVITY_MPS2,
        headroom=headroom,
        room_m=room_m,
        radial_var_m2ps4=radial_var,
        tangential_var_m2ps4=tangential_var,
        period_s=period_s,
    )
    chosen = find_longest_arms(rig)
    rows = [chosen, *_list_neighbours(rig, chosen)]
    folder = make_output_dir(out)
    with mpl.rc_context(STYLE):
        save_figure(_draw_figure(rig, chosen), folder / "spin-design.png", dpi=DPI, metadata={"Software": None})
    facts = [asdict(rig) | asdict(one) for one in rows]
    write_json(str(folder / "spin-design.json"), facts)
    write_json(json, facts)
    if json == STDOUT:
        return
    d1_m, d2_m = compute_limits_m(rig)
    print_table("placements, the best that fits first", _DESIGN_COLUMNS, [[_format_row(one) for one in rows]], texts=0)
    print_line(f"F4 reads the whole range at d1 = {d1_m:.3f} m, F5 at d2 = {d2_m:.3f} m")
    print_line(f"{folder / 'spin-design.png'}, {folder / 'spin-design.json'}")


def _list_neighbours(rig: Rig, chosen: Placement) -> list[Placement]:
    """Return shorter and longer arms around the chosen ones, one arm changed at a time."""
    factors = (0.25, 0.5, 0.75, 1.25, 1.5)
    changed = [evaluate_placement(rig, round(chosen.d1_m * factor, 4), chosen.d2_m) for factor in factors]
    return changed + [evaluate_placement(rig, chosen.d1_m, round(chosen.d2_m * factor, 4)) for factor in factors]


def _format_row(one: Placement) -> Sequence[str]:
    """Return the row of a placement as text; arms in m, shares in percent."""
    return (
        f"{one.d1_m:.3f}",
        f"{one.d2_m:.3f}",
        f"{100 * one.radial_share:.0f}",
        f"{100 * one.tangential_share:.0f}",
        "yes" if one.fits else "no",
        f"{one.r_rad2ps4:.4g}",
        f"{one.q_rad2ps4:.3g}",
        f"{np.rad2deg(one.raw_rate_sd_radps):.2f}",
        f"{np.rad2deg(one.filtered_rate_sd_radps):.2f}",
        f"{np.rad2deg(one.rate_per_bias) * STANDARD_GRAVITY_MPS2 / 1e3:.3f}",
        f"{np.rad2deg(one.rate_per_arm) / 1e3:.1f}",
    )


def _draw_figure(rig: Rig, chosen: Placement) -> Figure:
    """Return the figure of a rig: radial, tangential and both over the arms."""
    figure = Figure(figsize=(13, 4.2), layout="constrained")
    for ax, draw in zip(figure.subplots(1, 3), (draw_radial, draw_tangential, draw_both), strict=True):
        draw(ax, rig, chosen)
    return figure
