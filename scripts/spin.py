"""``stillpoint spin design`` and ``stillpoint spin identify``: where accelerometers sit, and how noisy they are."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import matplotlib as mpl
import numpy as np
from cyclopts import App, Parameter
from matplotlib.figure import Figure

from stillpoint.datasets.spin import G_MPS2
from stillpoint.datasets.store import read_recording
from stillpoint.scoring.spin_design import Placement, Rig, limits_m, longest, place
from stillpoint.scoring.spin_figures import draw_both, draw_radial, draw_tangential, draw_variances
from stillpoint.scoring.spin_identify import Identified, Trial
from stillpoint.scoring.spin_identify import identify as identified
from stillpoint.scripts.flags import Inputs, OutDir
from stillpoint.scripts.inputs import output_dir, recordings
from stillpoint.scripts.json_file import STDOUT, JsonFile, write_json
from stillpoint.scripts.tables import print_table

app = App(name="spin", help="Accelerometers on a spinning body: where to put them, and how noisy they are.")
STYLE: dict[Any, Any] = {"axes.grid": True, "grid.alpha": 0.3, "axes.spines.top": False, "axes.spines.right": False}
DPI = 110
TURNING_SHARE = 0.1  # of D4, from which on it is said that it turns with the shaft
DESIGN_COLUMNS = (
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
TRIAL_COLUMNS = (
    "recording",
    "samples",
    "D4",
    "robust",
    "glitches",
    "F4 mean",
    "F4 1x",
    "D5",
    "encoder's",
    "D5 alone",
    "left out",
)


@app.command(sort_key=0)
def design(
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
    """Accuracy over the lever arms d1 of F4 and d2 of F5, with the range's limit (paper 000, section 3.2).

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
        range_mps2=range_g * G_MPS2,
        headroom=headroom,
        room_m=room_m,
        radial_var_m2ps4=radial_var,
        tangential_var_m2ps4=tangential_var,
        period_s=period_s,
    )
    chosen = longest(rig)
    rows = [chosen, *_others(rig, chosen)]
    folder = output_dir(out)
    with mpl.rc_context(STYLE):
        _design_figure(rig, chosen).savefig(folder / "spin-design.png", dpi=DPI, metadata={"Software": None})
    facts = [asdict(rig) | asdict(one) for one in rows]
    write_json(str(folder / "spin-design.json"), facts)
    write_json(json, facts)
    if json == STDOUT:
        return
    d1_m, d2_m = limits_m(rig)
    print_table("placements, the best that fits first", DESIGN_COLUMNS, [[_design_row(one) for one in rows]], texts=0)
    print(f"F4 reads the whole range at d1 = {d1_m:.3f} m, F5 at d2 = {d2_m:.3f} m")
    print(f"{folder / 'spin-design.png'}, {folder / 'spin-design.json'}")


@app.command(sort_key=1)
def identify(
    paths: Inputs,
    /,
    *,
    by_truth: Annotated[bool, Parameter(negative="")] = False,
    out: OutDir = Path(),
    json: JsonFile = None,
) -> None:
    """Noise variances of F4 and F5 from trials with an encoder (paper 000, eqs (28)-(31), figures 7 and 8).

    Writes spin-identify.png and spin-identify.json. The maximum over the trials is taken, as in the paper. D5 by (30)
    holds the noise of the encoder's differences too; what the accelerometer and the encoder share is motion, which
    gives the encoder's part and D5 without it.

    Parameters
    ----------
    paths
        Recordings of one rig: MCAP files, folders or globs.
    by_truth
        Compare with the true rate of simulated trials instead of their encoder.
    out
        Folder to write into; made when it is not there.
    json
        Also write the rows to this file; - is the standard output.
    """
    found = identified([read_recording(path) for path in recordings(paths)], by_truth)
    folder = output_dir(out)
    with mpl.rc_context(STYLE):
        _variance_figure(found).savefig(folder / "spin-identify.png", dpi=DPI, metadata={"Software": None})
    facts: list[dict[str, Any]] = [asdict(one) for one in found.trials]
    facts.append({"recording": "maximum"} | {name: value for name, value in asdict(found).items() if name != "trials"})
    write_json(str(folder / "spin-identify.json"), facts)
    write_json(json, facts)
    if json != STDOUT:
        _show_variances(found)
        print(f"{folder / 'spin-identify.png'}, {folder / 'spin-identify.json'}")


def _show_variances(found: Identified) -> None:
    most = dict.fromkeys(TRIAL_COLUMNS, "") | {"recording": "maximum", "D4": f"{found.d4_m2ps4:.3f}"}
    most |= {"D5": f"{found.d5_m2ps4:.3f}", "D5 alone": f"{found.d5_alone_m2ps4:.3f}"}
    sections: list[list[Sequence[str]]] = [[_trial_row(one) for one in found.trials], [list(most.values())]]
    print_table("variances in (m/s²)², means and what turns once per turn in m/s²", TRIAL_COLUMNS, sections, texts=1)
    for one in found.trials:
        if one.turning_share > TURNING_SHARE:
            tilt_deg = np.rad2deg(np.arcsin(min(one.radial.once_per_turn_mps2 / G_MPS2, 1.0)))
            print(
                f"note: {one.recording}: {100 * one.turning_share:.0f} % of D4 turns with the shaft, as if it were tilted "
                f"by {tilt_deg:.1f} deg: D4 and D5 are no noise of the sensors"
            )
    print(
        f"R = {found.r_rad2ps4:.3g} (1/s²)², Q = {found.q_rad2ps4:.3g} (1/s²)², {found.q_alone_rad2ps4:.3g} by F5 alone"
    )
    print(
        f"for `stillpoint estimate`: --set radial_var_m2ps4={found.d4_m2ps4:.3g} "
        f"--set tangential_var_m2ps4={found.d5_alone_m2ps4:.3g}"
    )


def _others(rig: Rig, chosen: Placement) -> list[Placement]:
    """Shorter and longer arms around the chosen ones, one arm changed at a time."""
    factors = (0.25, 0.5, 0.75, 1.25, 1.5)
    changed = [place(rig, round(chosen.d1_m * factor, 4), chosen.d2_m) for factor in factors]
    return changed + [place(rig, chosen.d1_m, round(chosen.d2_m * factor, 4)) for factor in factors]


def _design_row(one: Placement) -> Sequence[str]:
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
        f"{np.rad2deg(one.rate_per_bias) * G_MPS2 / 1e3:.3f}",
        f"{np.rad2deg(one.rate_per_arm) / 1e3:.1f}",
    )


def _trial_row(one: Trial) -> Sequence[str]:
    return (
        one.recording,
        str(one.samples),
        f"{one.radial.variance_m2ps4:.3f}",
        f"{one.radial.robust_m2ps4:.3f}",
        str(one.radial.glitches),
        f"{one.radial.mean_mps2:.3f}",
        f"{one.radial.once_per_turn_mps2:.3f}",
        f"{one.tangential.variance_m2ps4:.3f}",
        f"{one.encoder_m2ps4:.3f}",
        f"{one.tangential_alone_m2ps4:.3f}",
        str(one.left_out),
    )


def _design_figure(rig: Rig, chosen: Placement) -> Figure:
    figure = Figure(figsize=(13, 4.2), layout="constrained")
    for ax, draw in zip(figure.subplots(1, 3), (draw_radial, draw_tangential, draw_both), strict=True):
        draw(ax, rig, chosen)
    return figure


def _variance_figure(found: Identified) -> Figure:
    figure = Figure(figsize=(10, 4), layout="constrained")
    for ax, which in zip(figure.subplots(1, 2), ("radial", "tangential"), strict=True):
        draw_variances(ax, found, which)
    return figure
