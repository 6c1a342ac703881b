"""``stillpoint calibrate``: one calibration of a device from several of its recordings."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter

from stillpoint.datasets import Recording, Reference, read
from stillpoint.datasets.calibration.device import SUFFIX, DeviceFile, write_device
from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.mcap.store import sha256
from stillpoint.datasets.names import make_drawable
from stillpoint.scoring.report.printed import save_figure
from stillpoint.scripts.shared import inputs
from stillpoint.scripts.shared.flags import Inputs, Jobs, Workers
from stillpoint.scripts.shared.jobs import run_jobs
from stillpoint.scripts.shared.output import STDOUT, JsonFile, print_line, write_document
from stillpoint.scripts.shared.tables import print_refusals, print_table
from stillpoint.smoother import attitude_reference
from stillpoint.smoother.device import PARTS, DeviceCalibration, calibrate_device, require_several

_COLUMNS = ("recording", *(f"{part}, %" for part in PARTS), "accel bias, m/s²")


def calibrate(
    paths: Inputs,
    /,
    *,
    out: Annotated[Path, Parameter(name=["--out", "-o"])] = Path(f"device{SUFFIX}"),
    plot: Path | None = None,
    jobs: Jobs = None,
    json: JsonFile = None,
) -> int:
    """Find one calibration of a device from several of its recordings.

    What the data of each recording show is summed up; the symmetric parts of the matrices of gyro and accelerometer,
    which motion shows, are written with their sd. Recordings of two devices are refused. Then reference --calibration
    and estimate --calibration take the file.

    Parameters
    ----------
    paths
        Recordings of one device, or references of them (NAME.reference.mcap): files, folders or globs.
    out
        The calibration file, NAME.calibration.toml; the same goes into NAME.calibration.mcap beside it.
    plot
        Draw the parameters of each recording with their sd into this file: .png, .svg or .pdf.
    jobs
        Processes; by default one per core, fewer for few recordings.
    json
        Also write the parameters as JSON to this file; - is the standard output.
    """
    if not out.name.endswith(".toml"):
        raise BadParameter(f"--out {out}: give a name that ends in {SUFFIX}")
    files = [file for file in inputs.find_mcap_files(paths) if inputs.get_kind(file) != "calibration"]
    require_several(len(files))  # before references take minutes
    outcomes = run_jobs(_make_reference, files, Workers(jobs), "calibrate")
    refused = [(outcome.error, file.name) for file, outcome in zip(files, outcomes, strict=True) if outcome.error]
    made = [outcome.value for outcome in outcomes if outcome.value is not None]
    print_refusals("not used", refused)
    device = calibrate_device([reference for reference, _ in made])
    rows = _list_drift(device)
    write_device(out, _make_file(device, [info for _, info in made], files, rows))
    if plot is not None:
        _draw(plot, device)
    if json != STDOUT:
        print_table(
            f"{out}: the device by {len(made)} recordings, deviation ± sd", _COLUMNS, [_make_rows(device)], texts=1
        )
        print_line(
            f"two devices would explain them better by {device.split:.0f}; {device.split_of_one:.0f} may be chance"
        )
    write_document(json, {"file": str(out), "parts": PARTS, "recordings": rows, **_list_facts(device)})
    return 2 if refused else 0


def _make_reference(file: Path) -> tuple[Reference, dict[str, Any]]:
    """Return the reference in a file, or of the recording in it, and what the file says of date and sensor."""
    thing = read(file)
    if isinstance(thing, Reference):
        return thing, {"sensor": "", "date": "", "temperature_degc": float("nan")}
    if not isinstance(thing, Recording):
        raise BadParameter(f"{file}: holds neither a recording nor a reference of an attitude")
    temperature = thing.info.extra.get("temperature_degc", "nan")
    info = {"sensor": thing.info.sensor, "date": thing.info.date, "temperature_degc": float(temperature)}
    return replace(attitude_reference(thing), made_from={file.name: sha256(file)}), info


def _make_file(
    device: DeviceCalibration, infos: Sequence[dict[str, Any]], files: Sequence[Path], rows: list[dict[str, Any]]
) -> DeviceFile:
    """Return the calibration of a device with its sources; raises :class:`BadParameter` for different sensors."""
    sensors = sorted({info["sensor"] for info in infos if info["sensor"]})
    if len(sensors) > 1:
        raise BadParameter(
            f"calibrate: the recordings name different sensors ({', '.join(sensors)}); give those of one"
        )
    return DeviceFile(
        sensor="".join(sensors),
        gyro_matrix=device.gyro_matrix,
        gyro_matrix_sd=device.gyro_matrix_sd,
        accel_matrix=device.accel_matrix,
        accel_matrix_sd=device.accel_matrix_sd,
        accel_bias_b_mps2=device.accel_bias_b_mps2,
        accel_bias_sd_mps2=device.accel_bias_sd_mps2,
        dates=tuple(info["date"] for info in infos),
        temperature_degc=tuple(info["temperature_degc"] for info in infos),
        made_from={file.name: sha256(file) for file in files},
        drift=rows,
    )


def _list_drift(device: DeviceCalibration) -> list[dict[str, Any]]:
    """Return what each recording says by itself."""
    rows = zip(device.names, device.parts, device.parts_sd, device.biases_b_mps2, strict=True)
    return [
        {"name": name, "parts": parts.tolist(), "parts_sd": sd.tolist(), "accel_bias_mps2": bias.tolist()}
        for name, parts, sd, bias in rows
    ]


def _list_facts(device: DeviceCalibration) -> dict[str, Any]:
    """Return the calibration of a device for ``--json``."""
    names = ("gyro_matrix", "gyro_matrix_sd", "accel_matrix", "accel_matrix_sd", "accel_bias_b_mps2")
    columns = {name: getattr(device, name).tolist() for name in (*names, "accel_bias_sd_mps2")}
    return {**columns, "split": device.split, "split_of_one": device.split_of_one}


def _make_rows(device: DeviceCalibration) -> list[list[str]]:
    """Return the rows of the table: each recording by itself, then the device; percent and m/s^2."""

    def format_cells(parts: Any, sd: Any, bias: Any) -> list[str]:
        """Return deviations with their sd in percent, and the bias in m/s^2, as text."""
        pairs = [f"{100 * value:.2f} ± {100 * each:.2f}" for value, each in zip(parts, sd, strict=True)]
        return [*pairs, " ".join(f"{value:.3f}" for value in bias)]

    upper = np.array([0, 4, 8, 1, 2, 5])  # PARTS of a matrix (3, 3)
    matrices = [(device.gyro_matrix, device.gyro_matrix_sd), (device.accel_matrix, device.accel_matrix_sd)]
    parts = np.concatenate([(matrix - np.eye(3)).ravel()[upper] for matrix, _ in matrices])
    sd = np.concatenate([each.ravel()[upper] for _, each in matrices])
    rows = zip(device.names, device.parts, device.parts_sd, device.biases_b_mps2, strict=True)
    alone = [[name, *format_cells(parts, sd, bias)] for name, parts, sd, bias in rows]
    return [*alone, ["the device", *format_cells(parts, sd, device.accel_bias_b_mps2)]]


def _draw(path: Path, device: DeviceCalibration) -> None:
    """Draw the drift of each parameter over the recordings, with its sd."""
    from matplotlib.figure import Figure

    if path.suffix not in (".png", ".svg", ".pdf"):
        raise BadParameter(f"--plot {path}: give a name that ends in .png, .svg or .pdf")
    figure = Figure(figsize=(10, 6), layout="constrained")
    at = np.arange(len(device.names))
    for axes, sensor, first in zip(figure.subplots(2, 1, sharex=True), ("gyro", "accel"), (0, 6), strict=True):
        for k in range(first, first + 6):
            shown = 100 * device.parts[:, k], 100 * device.parts_sd[:, k]
            axes.errorbar(at + 0.08 * (k - first - 2.5), *shown, fmt="o", markersize=3, label=PARTS[k])
        axes.set(ylabel=f"{sensor}, % off")
        axes.grid(True, alpha=0.3)
        axes.legend(ncols=6, fontsize="small")
    axes.set_xticks(at, [make_drawable(name[:30]) for name in device.names], rotation=45, ha="right", fontsize=7)
    save_figure(figure, path)
