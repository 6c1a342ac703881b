"""The calibration of a device as a file: ``NAME.calibration.toml``, readable and exact, and the same inside an MCAP."""

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from stillpoint.datasets.errors import BadFile, BadParameter
from stillpoint.datasets.files.atomic import write_atomically
from stillpoint.datasets.mcap.reader import survey
from stillpoint.datasets.mcap.writer import write_mcap
from stillpoint.datasets.recording import Floats
from stillpoint.datasets.trajectory import Calibration

SUFFIX = ".calibration.toml"
_KIND = "device calibration"
_RECORD = "stillpoint-calibration"  # name of the metadata record


@dataclass(frozen=True, eq=False)
class DeviceFile:
    """The contents of a calibration file: corrected = matrix (measured - bias) for gyro and accelerometer.

    The gyro's bias is not in it: it changes each time the sensor is turned on.
    """

    sensor: str  # as the recordings name it, "" when they do not
    gyro_matrix: Floats  # (3, 3)
    gyro_matrix_sd: Floats  # (3, 3)
    accel_matrix: Floats  # (3, 3)
    accel_matrix_sd: Floats  # (3, 3)
    accel_bias_b_mps2: Floats  # (3,) mean over the recordings
    accel_bias_sd_mps2: Floats  # (3,) scatter from recording to recording
    dates: tuple[str, ...]  # of the recordings, "" where unknown: how old the calibration is
    temperature_degc: tuple[float, ...]  # of the recordings; NaN where unknown
    made_from: Mapping[str, str] = field(default_factory=dict)  # file name -> sha256
    drift: Sequence[Mapping[str, Any]] = ()  # of each recording: its name and what it says alone

    @property
    def calibration(self) -> Calibration:
        """The part that readings are corrected by."""
        return Calibration(
            gyro_matrix=self.gyro_matrix,
            gyro_matrix_sd=self.gyro_matrix_sd,
            accel_matrix=self.accel_matrix,
            accel_matrix_sd=self.accel_matrix_sd,
            accel_bias_b_mps2=self.accel_bias_b_mps2,
        )


def write_device(path: Path, device: DeviceFile) -> None:
    """Write a calibration file, whole or not at all, and the same as an MCAP file beside it; raises :class:`BadFile`.

    The MCAP file holds the text as its attachment, and the matrices in a metadata record, which any MCAP tool shows.
    """
    text = _format_text(device)
    with write_atomically(path) as file:
        file.write(text)
    shown = {
        "kind": _KIND,
        "sensor": device.sensor,
        "gyro_matrix": _format_rows(device.gyro_matrix),
        "gyro_matrix_sd": _format_rows(device.gyro_matrix_sd),
        "accel_matrix": _format_rows(device.accel_matrix),
        "accel_matrix_sd": _format_rows(device.accel_matrix_sd),
        "accel_bias_b_mps2": _format_rows(device.accel_bias_b_mps2),
        "accel_bias_sd_mps2": _format_rows(device.accel_bias_sd_mps2),
    }
    write_mcap(path.with_suffix(".mcap"), [], {_RECORD: shown}, {path.name: text})


def _format_text(device: DeviceFile) -> bytes:
    """Return the calibration as TOML, with comments about its use."""
    known = [date for date in device.dates if date]
    warm = [value for value in device.temperature_degc if np.isfinite(value)]
    lines = [
        "# stillpoint reference --calibration THIS.toml and estimate --calibration THIS.toml apply it:",
        "# corrected = matrix (measured - bias). The gyro's bias is found anew in each recording.",
        f'kind = "{_KIND}"',
        f"sensor = {_quote(device.sensor)}",
        f"first_date = {_quote(min(known, default=''))}",
        f"last_date = {_quote(max(known, default=''))}",
        f"temperature_degc = [{', '.join(repr(float(value)) for value in warm)}]  # empty: not known",
        "",
        "[gyro]",
        f"matrix = {_format_rows(device.gyro_matrix)}",
        f"matrix_sd = {_format_rows(device.gyro_matrix_sd)}",
        "",
        "[accel]",
        f"matrix = {_format_rows(device.accel_matrix)}",
        f"matrix_sd = {_format_rows(device.accel_matrix_sd)}",
        f"bias_mps2 = {_format_rows(device.accel_bias_b_mps2)}",
        f"bias_sd_mps2 = {_format_rows(device.accel_bias_sd_mps2)}  # from recording to recording",
        "",
        "[made_from]",
        *(f"{_quote(name)} = {_quote(digest)}" for name, digest in device.made_from.items()),
    ]
    for one in device.drift:
        lines += ["", "[[recording]]", *(f"{key} = {_format_value(value)}" for key, value in one.items())]
    return ("\n".join(lines) + "\n").encode()


def read_device(path: Path) -> DeviceFile:
    """Return what a calibration file holds, TOML or MCAP; raises :class:`BadFile` for any other file."""
    try:
        given = tomllib.loads(_read_text(path))
        if given.get("kind") != _KIND:
            raise ValueError(f"its kind is {given.get('kind')!r}, not {_KIND!r}")
        gyro, accel = given["gyro"], given["accel"]
        return DeviceFile(
            sensor=str(given["sensor"]),
            gyro_matrix=_make_array(gyro["matrix"], (3, 3)),
            gyro_matrix_sd=_make_array(gyro["matrix_sd"], (3, 3)),
            accel_matrix=_make_array(accel["matrix"], (3, 3)),
            accel_matrix_sd=_make_array(accel["matrix_sd"], (3, 3)),
            accel_bias_b_mps2=_make_array(accel["bias_mps2"], (3,)),
            accel_bias_sd_mps2=_make_array(accel["bias_sd_mps2"], (3,)),
            dates=(str(given["first_date"]), str(given["last_date"])),
            temperature_degc=tuple(float(value) for value in given["temperature_degc"]),
            made_from={str(name): str(digest) for name, digest in given["made_from"].items()},
            drift=tuple(given.get("recording", ())),
        )
    except OSError as error:
        raise BadParameter(f"{path}: cannot be opened ({error.strerror}); check the name") from error
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise BadFile(f"{path}: is not a calibration of a device ({error}); make it by stillpoint calibrate") from error


def _read_text(path: Path) -> str:
    """Return the text of a calibration file, or of the one that is attached to an MCAP file."""
    if path.suffix != ".mcap":
        return path.read_text(encoding="utf-8")
    attached = [data for name, data in survey(path).attachments.items() if name.endswith(SUFFIX)]
    if not attached:
        raise ValueError("nothing that ends in .calibration.toml is attached to it")
    return attached[0].decode()


def _make_array(values: Any, shape: tuple[int, ...]) -> Floats:
    """Return values as an array of this shape; raises ``ValueError`` for another shape or for non-finite values."""
    array = np.array(values, dtype=np.float64)
    if array.shape != shape or not np.isfinite(array).all():
        raise ValueError(f"a matrix has the shape {array.shape} or is not finite; {shape} is needed")
    return array


def _format_rows(values: Floats) -> str:
    return repr(np.asarray(values).tolist())


def _format_value(value: Any) -> str:
    return _quote(value) if isinstance(value, str) else repr(value)


def _quote(text: str) -> str:
    """Return the text as a basic string of TOML."""
    escaped = "".join(f"\\u{ord(c):04x}" if c < " " or c in '"\\\x7f' else c for c in text)
    return f'"{escaped}"'
