"""``python -m stillpoint.scripts.pages.figures.spin [DISC.csv]``: draw docs/roll.md, and print the numbers of the disc.

Geometry and graph are drawings; the errors are of simulated trials, by the graph told of a calibrated rig; the flight
is that of the log given, which is left out without one.
"""

from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Arc, Circle, Rectangle

from stillpoint.datasets.simulate import simulate
from stillpoint.datasets.simulate.spin_sensor import CONSTANT, SpinSensor
from stillpoint.datasets.trajectory import SpinReference
from stillpoint.scoring.report.figures import COLOURS
from stillpoint.scripts.pages.disc_flight import DiscFlight, read_disc_flight
from stillpoint.scripts.pages.figures.demo import STYLE
from stillpoint.scripts.program import run_program
from stillpoint.smoother import reference

_FOLDER = Path("docs/figures")
_DPI = 80
_ERRORS = {"bias_mg": 10.0, "arm_error": 1e-3}  # sd of what is drawn for each trial: a calibrated rig
_RIG = {"calibration.accel_bias_sd_mps2": 0.1, "calibration.lever_arm_sd": 1e-3}  # the same as the graph's prior
_BAND_SD = 2.0


def main(*logs: Path) -> None:
    """Draw all figures of docs/roll.md."""
    _FOLDER.mkdir(parents=True, exist_ok=True)
    pictures = {"roll_geometry": _draw_geometry, "roll_graph": _draw_graph, "roll_errors": _draw_errors}
    with mpl.rc_context(STYLE):
        for name, draw in pictures.items():
            _save_figure(draw(), name)
        for log in logs:
            flight = read_disc_flight(log)
            _save_figure(_draw_disc(flight), "roll_disc")
            print("\n".join(_describe_disc(flight)))


def _save_figure(figure: Figure, name: str) -> None:
    figure.savefig(_FOLDER / f"{name}.png", dpi=_DPI, metadata={"Software": None})


def _draw_geometry() -> Figure:
    """Draw the body seen along its spin axis, and the direction of gravity at angle 0."""
    figure = Figure(figsize=(10, 4.4), layout="constrained")
    general, bench = figure.subplots(1, 2)
    _draw_body(general, centre=True)
    general.set_title("five accelerometers, two gyros: in flight", loc="left", fontsize=10)
    _draw_body(bench, centre=False)
    bench.set_title("bench of two: on a motor's shaft", loc="left", fontsize=10)
    bench.annotate("", (0.62, 0.62), (0.62, 0.30), arrowprops={"arrowstyle": "->", "color": COLOURS[3], "lw": 2})
    bench.text(0.65, 0.30, "up, across the axis,\nat angle 0:\ng sin(tilt)", color=COLOURS[3], fontsize=9)
    return figure


def _draw_body(ax: Axes, centre: bool) -> None:
    """Draw the accelerometers on the spinning body, with those at its centre where there are some."""
    arrow = {"arrowstyle": "-|>", "lw": 2}
    ax.add_patch(Circle((0, 0), 0.6, fill=False, color="0.6"))
    ax.add_patch(Arc((0, 0), 0.5, 0.5, theta1=200, theta2=290, color="0.3", lw=1.5))
    ax.annotate("", (0.11, -0.225), (0.05, -0.245), arrowprops={"arrowstyle": "->", "color": "0.3"})
    ax.text(-0.34, -0.36, r"$\omega_x$, angle", color="0.3")
    for tip, name in (((0.85, 0), "y"), ((0, 0.85), "z")):
        ax.annotate("", tip, (0, 0), arrowprops={"arrowstyle": "->", "color": "0.7"})
        ax.text(tip[0] + 0.02, tip[1], name, color="0.5")
    ax.annotate("", (0, 0.36), (0, 0.2), arrowprops={**arrow, "color": COLOURS[0]})
    ax.plot(0, 0.2, "s", color=COLOURS[0])
    ax.text(-0.34, 0.25, "F4 at d1\nradial", color=COLOURS[0], fontsize=9)
    ax.annotate("", (0.5, 0.16), (0.5, 0), arrowprops={**arrow, "color": COLOURS[1]})
    ax.plot(0.5, 0, "s", color=COLOURS[1])
    ax.text(0.36, -0.14, "F5 at d2\ntangential", color=COLOURS[1], fontsize=9)
    if centre:
        ax.annotate("", (0.16, 0), (0, 0), arrowprops={**arrow, "color": COLOURS[2]})
        ax.annotate("", (0, 0.14), (0, 0), arrowprops={**arrow, "color": COLOURS[2]})
        ax.plot(0, 0, "s", color=COLOURS[2])
        ax.text(-0.55, 0.02, "F1 (along x),\nF2, F3; g1, g2", color=COLOURS[2], fontsize=9)
    else:
        ax.plot(0, 0, "o", color="0.3")
    ax.set(xlim=(-0.75, 1.05), ylim=(-0.7, 0.95), aspect="equal")
    ax.axis("off")


def _draw_graph() -> Figure:
    """Draw the keys, the constants, and the factors between them."""
    figure = Figure(figsize=(10, 3.6), layout="constrained")
    ax = figure.subplots()
    keys = np.arange(6) * 1.7
    for i, x in enumerate(keys):
        ax.add_patch(Circle((x, 0), 0.33, facecolor="white", edgecolor=COLOURS[0], lw=2, zorder=3))
        ax.text(x, 0, f"$K_{i}$", ha="center", va="center", zorder=4)
    for c, x in enumerate((2.5, 6.8)):
        ax.add_patch(Circle((x, 1.9), 0.33, facecolor="white", edgecolor=COLOURS[1], lw=2, zorder=3))
        ax.text(x, 1.9, f"$C_{c}$", ha="center", va="center", zorder=4)
        for k in range(3 * c, min(3 * c + 3, 5)):
            ax.plot([x, keys[k] + 0.85], [1.9, 0.14], color="0.8", zorder=1)
    for x in keys[:-1] + 0.85:
        ax.plot([x - 0.85, x + 0.85], [0, 0], color="0.3", zorder=1)
        ax.add_patch(Rectangle((x - 0.14, -0.14), 0.28, 0.28, color="0.3", zorder=3))
    for x, y, to in ((-0.95, 0.0, (0, 0)), (1.2, 1.9, (2.5, 1.9)), (4.65, 1.9, None)):
        ax.add_patch(Rectangle((x - 0.1, y - 0.1), 0.2, 0.2, color="0.3", zorder=3))
        ends = [(2.5, 1.9), (6.8, 1.9)] if to is None else [to]
        for end in ends:
            ax.plot([x, end[0]], [y, end[1]], color="0.3", zorder=1)
    ax.text(-0.95, -0.45, "where the\nangle begins", ha="center", va="top", fontsize=9)
    ax.text(1.2, 2.15, "prior", ha="center", fontsize=9)
    ax.text(4.65, 2.15, "walk of the biases", ha="center", fontsize=9)
    ax.text(keys[2] + 0.85, -0.45, "a block of 24 samples: acceleration, squared rate, encoder;\n"
            "the 23 rates inside are taken out exactly", ha="center", va="top", fontsize=9)  # fmt: skip
    ax.text(
        8.9,
        1.9,
        "K: angle, rate\nC: biases, lever arms,\ngravity, vibration,\nencoder's zero, delay",
        va="center",
        fontsize=9,
    )
    ax.set(xlim=(-1.8, 11.2), ylim=(-1.3, 2.5), aspect="equal")
    ax.axis("off")
    return figure


def _draw_errors() -> Figure:
    """Draw errors of angle and rate within the stated bands, on a vertical and on a horizontal axis."""
    figure = Figure(figsize=(10, 4.6), layout="constrained")
    axes = figure.subplots(2, 2, sharex=True)
    for column, tilt_deg in zip(axes.T, (0.0, 90.0), strict=True):
        recording = simulate("spin-constant", seed=1, sensor=_add_errors(CONSTANT["white"], tilt_deg))
        made, truth = reference(recording, params=_RIG), recording.roll_truth
        assert isinstance(made, SpinReference)
        assert truth is not None
        _draw_band(column[0], made, made.angle_rad - truth.angle_rad, made.angle_sd_rad)
        _draw_band(column[1], made, made.rate_radps - truth.rate_radps, made.rate_sd_radps)
        column[0].set_title(f"axis {'vertical' if tilt_deg == 0 else 'horizontal'}", loc="left", fontsize=10)
        column[1].set_xlabel("time (s)")
    axes[0, 0].set_ylabel("angle error (deg)")
    axes[1, 0].set_ylabel("rate error (deg/s)")
    axes[0, 1].legend(loc="upper right", frameon=False, ncols=2, fontsize=8)
    return figure


def _add_errors(sensor: SpinSensor, tilt_deg: float) -> SpinSensor:
    """Return the sensor with errors of its accelerometers and a tilted shaft."""
    radial, tangential = replace(sensor.radial, **_ERRORS), replace(sensor.tangential, **_ERRORS)
    return replace(sensor, name="docs", tilt_deg=tilt_deg, radial=radial, tangential=tangential)


def _draw_band(ax: Axes, made: SpinReference, error_rad: np.ndarray, sd_rad: np.ndarray) -> None:
    """Draw the error (N,) in deg over the band of two stated standard deviations."""
    t_s = (made.t_ns - made.t_ns[0]) / 1e9
    whole = 2 * np.pi * np.round(np.median(error_rad) / (2 * np.pi))
    band = _BAND_SD * np.rad2deg(sd_rad)
    ax.fill_between(t_s, -band, band, color="0.88", label="2 sd, as stated")
    ax.plot(t_s, np.rad2deg(error_rad - whole), color=COLOURS[0], lw=0.8, label="error")


def _draw_disc(flight: DiscFlight) -> Figure:
    """Return the figure of the disc: rates by gyro, accelerometer and graph, and what the graph differs by."""
    figure = Figure(figsize=(10, 5), layout="constrained")
    rate, error = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    plain = np.sqrt(flight.all_force_mps2 / flight.arm_m[0])
    rate.plot(flight.all_t_s, np.rad2deg(flight.all_gyro_radps), color="0.3", label="gyro")
    rate.plot(flight.all_t_s, np.rad2deg(plain), color=COLOURS[1], lw=1, label="sqrt(F / r), r as found")
    rate.plot(flight.t_s, np.rad2deg(flight.reference.rate_radps), color=COLOURS[0], label="graph")
    rate.set_ylabel("spin rate (deg/s)")
    rate.legend(frameon=False, ncols=3)
    left = np.rad2deg(flight.reference.rate_radps - flight.gyro_radps)
    band = _BAND_SD * np.rad2deg(flight.sd_radps)
    error.fill_between(flight.t_s, -band, band, color="0.88", label="2 sd, with the wobble")
    error.plot(flight.t_s, left, color=COLOURS[0], label="graph less gyro")
    parting = flight.t_s[flight.taught][-1]
    for ax in (rate, error):
        ax.axvline(parting, color="0.6", ls="--", lw=1)
    error.text(parting + 0.02, error.get_ylim()[0] * 0.9, "from here on without the gyro", fontsize=9, color="0.4")
    error.set_ylabel("difference (deg/s)")
    error.set_xlabel("time since the release (s)")
    error.legend(frameon=False, ncols=2, loc="upper right")
    return figure


def _describe_disc(flight: DiscFlight) -> list[str]:
    """Return the numbers of the flight, for the page."""
    left = np.rad2deg(flight.reference.rate_radps - flight.gyro_radps)
    lines = [
        f"lever arm {1e3 * flight.arm_m[0]:.2f} mm, sd {1e3 * flight.arm_m[1]:.2f}; settled from {flight.t_s[0]:.2f} s"
    ]
    for name, part in (("with the gyro's angle", flight.taught), ("without it", ~flight.taught)):
        sd, wobble, both = (
            np.median(np.rad2deg(one[part]))
            for one in (flight.reference.rate_sd_radps, flight.wobble_radps, flight.sd_radps)
        )
        rmse = np.sqrt(np.mean(left[part] ** 2))
        lines.append(
            f"{name}: {part.sum()} samples, mean {left[part].mean():+.2f}, RMSE {rmse:.2f}, "
            f"largest {np.abs(left[part]).max():.2f}, sd {both:.2f} deg/s (graph {sd:.2f}, wobble {wobble:.2f})"
        )
    return lines


if __name__ == "__main__":
    run_program(main)
