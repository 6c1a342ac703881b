"""``stillpoint spin identify``: noise variances of the accelerometers on a shaft."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import matplotlib as mpl
import numpy as np
from cyclopts import Parameter
from matplotlib.figure import Figure

from stillpoint.datasets.constants import STANDARD_GRAVITY_MPS2
from stillpoint.datasets.errors import BadParameter
from stillpoint.filters.spin.noise import SpinParams
from stillpoint.scoring.report.printed import save_figure
from stillpoint.scripts.shared.flags import Inputs, OutDir
from stillpoint.scripts.shared.inputs import find_recordings, make_output_dir
from stillpoint.scripts.shared.output import STDOUT, JsonFile, print_line, write_json
from stillpoint.scripts.shared.recordings import open_recording
from stillpoint.scripts.shared.tables import print_table
from stillpoint.studies.rig.figures import DPI, STYLE, draw_variances
from stillpoint.studies.rig.identify import Identified, Trial, identify_variances

_TRIAL_COLUMNS = (
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
_TURNING_SHARE = 0.1  # of D4, from which on it is said that it turns with the shaft
_ENCODER_SHARE = 0.1  # of D4, from which on it is said that it is the encoder's


def spin_identify(
    paths: Inputs,
    /,
    *,
    by_truth: Annotated[bool, Parameter(negative="")] = False,
    out: OutDir = Path(),
    json: JsonFile = None,
) -> None:
    """Find noise variances of F4 and F5 from trials with an encoder (Asghari et al. 2018, eqs (28)-(31)).

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
    found = identify_variances([open_recording(path) for path in find_recordings(paths)], by_truth)
    folder = make_output_dir(out)
    with mpl.rc_context(STYLE):
        save_figure(_draw_figure(found), folder / "spin-identify.png", dpi=DPI, metadata={"Software": None})
    facts: list[dict[str, Any]] = [asdict(one) for one in found.trials]
    facts.append({"recording": "maximum"} | {name: value for name, value in asdict(found).items() if name != "trials"})
    write_json(str(folder / "spin-identify.json"), facts)
    write_json(json, facts)
    if json != STDOUT:
        _print_variances(found)
        print_line(f"{folder / 'spin-identify.png'}, {folder / 'spin-identify.json'}")


def _print_variances(found: Identified) -> None:
    """Print variances and means of each trial, notes on them, and the settings that follow."""
    most = dict.fromkeys(_TRIAL_COLUMNS, "") | {"recording": "maximum", "D4": f"{found.d4_m2ps4:.3f}"}
    most |= {"D5": f"{found.d5_m2ps4:.3f}", "D5 alone": f"{found.d5_alone_m2ps4:.3f}"}
    sections: list[list[Sequence[str]]] = [[_format_row(one) for one in found.trials], [list(most.values())]]
    print_table("variances in (m/s²)², means and what turns once per turn in m/s²", _TRIAL_COLUMNS, sections, texts=1)
    for one in found.trials:
        if one.turning_share > _TURNING_SHARE:
            tilt_deg = np.rad2deg(np.arcsin(min(one.radial.once_per_turn_mps2 / STANDARD_GRAVITY_MPS2, 1.0)))
            print_line(
                f"note: {one.recording}: {100 * one.turning_share:.0f} % of D4 turns with the shaft, as if it were "
                f"tilted by {tilt_deg:.1f} deg: D4 and D5 are no noise of the sensors"
            )
    for note in _list_notes(found):
        print_line(f"note: {note}")
    alone = f", {found.q_alone_rad2ps4:.3g} by F5 alone" if found.tells_tangential else ""
    print_line(f"R = {found.r_rad2ps4:.3g} (1/s²)², Q = {found.q_rad2ps4:.3g} (1/s²)²{alone}")
    settings = [("radial_var_m2ps4", found.d4_m2ps4)]
    settings += [("tangential_var_m2ps4", found.d5_alone_m2ps4)] if found.tells_tangential else []
    flags = " ".join(f"--set roll-guarded.{name}={value:.3g}" for name, value in settings if _is_allowed(name, value))
    if flags:
        print_line(f"for `stillpoint estimate -e roll-guarded` (or another): {flags}")


def _is_allowed(name: str, value: float) -> bool:
    """Return whether the estimators accept a variance; that of sensors without noise they refuse."""
    setting: dict[str, Any] = {name: float(f"{value:.3g}")}
    try:
        SpinParams(**setting)
    except BadParameter:
        return False
    return True


def _list_notes(found: Identified) -> list[str]:
    """Return notes: the part of the variances that is the encoder's, and trials that differ too much."""
    notes = []
    for one in found.trials:
        if one.smoothed_s:
            notes.append(
                f"{one.recording}: the encoder gives an angle and no rate: smoothed over {one.smoothed_s:.2g} s; "
                "motion that is faster counts as noise of F4 and F5"
            )
        share = one.encoder_radial_m2ps4 / one.radial.variance_m2ps4
        if share > _ENCODER_SHARE:
            notes.append(f"{one.recording}: {100 * share:.0f} % of D4 is the encoder's noise: D4 is too large by it")
        if not one.tells_tangential:
            notes.append(
                f"{one.recording}: the encoder's noise makes up D5 ({one.encoder_m2ps4:.3g} of "
                f"{one.tangential.variance_m2ps4:.3g} (m/s²)²): it cannot tell the noise of F5. Take it from the data "
                "sheet or from a rest, or use a finer encoder"
            )
    for which, name in (("radial", "F4"), ("tangential", "F5")):
        pair = found.find_differing(which)
        if pair is not None:
            low, high = (f"{getattr(one, which).robust_m2ps4:.3g} ({one.recording})" for one in pair)
            notes.append(
                f"the noise of {name} differs between trials, robust variance {low} to {high}: are they one rig?"
            )
    return notes


def _format_row(one: Trial) -> Sequence[str]:
    """Return the row of a trial as text; variances in (m/s^2)^2."""
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


def _draw_figure(found: Identified) -> Figure:
    """Return the figure of the radial and tangential variances."""
    figure = Figure(figsize=(10, 4), layout="constrained")
    for ax, which in zip(figure.subplots(1, 2), ("radial", "tangential"), strict=True):
        draw_variances(ax, found, which)
    return figure
