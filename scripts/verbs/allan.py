"""``stillpoint allan``: noise density, bias instability and random walk from a long rest."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter

from stillpoint.datasets.calibration.allan import AllanDeviation, find_allan_deviation
from stillpoint.datasets.errors import BadParameter, Unobservable
from stillpoint.datasets.mcap.store import read_recording
from stillpoint.datasets.names import make_drawable
from stillpoint.datasets.recording import Floats, Recording
from stillpoint.scoring.report.printed import save_figure
from stillpoint.scripts.shared.output import STDOUT, JsonFile, print_line, write_document, write_text
from stillpoint.scripts.shared.tables import print_table
from stillpoint.smoother.rest import find_rests

_COLUMNS = ("sensor", "axis", "noise density", "bias instability", "at, s", "random walk of the bias", "unit")
_UNITS = {"gyro": ("deg/s", np.rad2deg(1.0)), "accel": ("m/s²", 1.0)}


@dataclass(frozen=True)
class _Figures:
    """The noise of one sensor in a rest."""

    name: str
    found: AllanDeviation


def allan(
    path: Path,
    /,
    *,
    out: Annotated[Path | None, Parameter(name=["--out", "-o"])] = None,
    plot: Path | None = None,
    json: JsonFile = None,
) -> None:
    """Find noise density, bias instability and random walk of gyro and accelerometer from the longest rest.

    Parameters
    ----------
    path
        A recording with a rest of a minute or more; an hour shows the random walk.
    out
        Write the settings of the smoother and of the ekf that follow from it to this file, as TOML.
    plot
        Draw the Allan deviations into this file: .png, .svg or .pdf.
    json
        Also write the figures and the curves as JSON to this file; - is the standard output.
    """
    recording = read_recording(path)
    figures = _measure(recording)
    if json != STDOUT:
        print_table(f"Allan deviation, {figures[0].found.length_s:.0f} s of rest", _COLUMNS, [_make_rows(figures)])
        for name, value in _make_settings(figures)["reference"].items():
            print_line(f"reference --set {name}={value:.3g}")
    if out is not None:
        write_text(out, _format_toml(recording, figures))
    if plot is not None:
        _draw(plot, recording.name, figures)
    write_document(json, {"recording": recording.name, "sensors": [_list_facts(one) for one in figures]})


def _measure(recording: Recording) -> list[_Figures]:
    """Return the figures of both sensors; raises :class:`Unobservable` without a rest that is long enough."""
    imu = recording.require_imu()
    rests_ns = find_rests(imu)
    if not len(rests_ns):
        raise Unobservable(f"{recording.name}: has no rest; lay the sensor down for a minute or more, best for an hour")
    first, last = rests_ns[np.argmax(rests_ns[:, 1] - rests_ns[:, 0])]
    rows = slice(*np.searchsorted(imu.t_ns, [first, last]))
    try:
        return [
            _Figures("gyro", find_allan_deviation(imu.t_ns[rows], imu.gyro_b_radps[rows])),
            _Figures("accel", find_allan_deviation(imu.t_ns[rows], imu.accel_b_mps2[rows])),
        ]
    except Unobservable as error:
        raise Unobservable(f"{recording.name}: {error}") from None


def _make_rows(figures: list[_Figures]) -> list[list[str]]:
    """Return the rows of the table, one per sensor and axis."""
    rows = []
    for one in figures:
        unit, factor = _UNITS[one.name]
        columns = (one.found.noise_density, one.found.bias_instability, one.found.bias_walk)
        density, floor, walk = (factor * column for column in columns)
        rows += [
            [one.name, axis, f"{density[k]:.3g}", f"{floor[k]:.3g}", f"{one.found.bias_instability_s[k]:.3g}",
             f"{walk[k]:.3g}", f"{unit}/√Hz, {unit}, {unit}/√s"]
            for k, axis in enumerate("xyz")
        ]  # fmt: skip
    return rows


def _make_settings(figures: list[_Figures]) -> dict[str, dict[str, float]]:
    """Return the settings of the smoother at rest and of the ekf that follow from the axis with the most noise."""
    gyro, accel = (one.found for one in figures)

    def find_largest(values: Floats) -> float:
        return float(values.max())

    return {
        "reference": {
            "inertial.gyro_rest_radps_rthz": find_largest(gyro.noise_density),
            "inertial.gyro_bias_walk": find_largest(gyro.bias_walk),
            "inertial.accel_rest_mps2_rthz": find_largest(accel.noise_density),
            "inertial.accel_bias_walk": find_largest(accel.bias_walk),
        },
        "params": {
            "gyro_noise_rad_rts": find_largest(gyro.noise_density),
            "bias_walk_radps": find_largest(gyro.bias_walk),
            "accel_noise_mps_rts": find_largest(accel.noise_density),
        },
    }


def _format_toml(recording: Recording, figures: list[_Figures]) -> str:
    """Return the settings as TOML that ``estimate`` and ``reference`` read, with where they come from."""
    settings = _make_settings(figures)
    return "\n".join(
        [
            "# -e ekf@THIS.toml uses [params]; reference takes [reference] by --set NAME=VALUE.",
            "# They are what the sensor shows at rest. In motion, vibration and scale errors add to them: the",
            "# smoother's densities in motion stay at their defaults.",
            'estimator = "ekf"',
            f'tuned_on = "the longest rest ({figures[0].found.length_s:.0f} s) of {recording.name}"',
            "",
            "[params]",
            *(f"{name} = {value!r}" for name, value in settings["params"].items()),
            "",
            "[reference]",
            *(f'"{name}" = {value!r}' for name, value in settings["reference"].items()),
            "",
        ]
    )


def _list_facts(one: _Figures) -> dict[str, Any]:
    """Return the figures of a sensor for ``--json``, in SI units."""
    found = one.found
    return {
        "sensor": one.name,
        "unit": "rad/s" if one.name == "gyro" else "m/s^2",
        "rest_s": found.length_s,
        "noise_density": found.noise_density.tolist(),
        "bias_instability": found.bias_instability.tolist(),
        "bias_instability_s": found.bias_instability_s.tolist(),
        "bias_walk": found.bias_walk.tolist(),
        "tau_s": found.tau_s.tolist(),
        "deviation": found.deviation.tolist(),
    }


def _draw(path: Path, name: str, figures: list[_Figures]) -> None:
    """Draw the deviations of both sensors with the lines of their noise densities."""
    from matplotlib.figure import Figure

    if path.suffix not in (".png", ".svg", ".pdf"):
        raise BadParameter(f"--plot {path}: give a name that ends in .png, .svg or .pdf")
    figure = Figure(figsize=(9, 4), layout="constrained")
    for axes, one in zip(figure.subplots(1, 2), figures, strict=True):
        unit, factor = _UNITS[one.name]
        for k, axis in enumerate("xyz"):
            (line,) = axes.loglog(one.found.tau_s, factor * one.found.deviation[:, k], label=axis)
            density = factor * one.found.noise_density[k] / np.sqrt(one.found.tau_s)
            axes.loglog(one.found.tau_s, density, ":", color=line.get_color(), linewidth=1)
        axes.set(xlabel="cluster time, s", ylabel=f"Allan deviation, {unit}", title=one.name)
        axes.grid(True, which="both", alpha=0.3)
        axes.legend()
    figure.suptitle(make_drawable(name))
    save_figure(figure, path)
