"""Turn recordings, references and estimates into tables of named columns for CSV: one table per clock."""

from collections.abc import Iterator, Mapping

import numpy as np

from stillpoint.datasets.recording import Encoder, Floats, Piece, Recording, Spin
from stillpoint.datasets.trajectory import Estimate, Reference, SpinReference

_XYZ, _WXYZ = "xyz", ("qw", "qx", "qy", "qz")
_UPPER = tuple((i, j) for i in range(3) for j in range(i, 3))

ROWS_AT_ONCE = 1 << 14  # of a text: numbers as Python objects take ten times the memory of the column

Table = dict[str, np.ndarray]  # column -> (N,); t_ns comes first


def make_tables(thing: Recording | Piece | Reference | SpinReference | Estimate) -> Mapping[str, Table]:
    """Return stream -> table for a recording or a piece of it, one table named "" for anything made from it. SI units.

    The sensors' columns are called as ``stillpoint stream`` reads them.
    """
    if isinstance(thing, Recording | Piece):
        return _list_tables(thing)
    table: Table = {"t_ns": thing.t_ns}
    if isinstance(thing, Reference) and thing.position_n_m is not None:
        assert thing.velocity_n_mps is not None
        assert thing.position_cov_n_m2 is not None
        assert thing.velocity_cov_n_m2ps2 is not None
        table |= _name_columns([f"{axis}_m" for axis in _XYZ], thing.position_n_m)
        table |= _name_columns([f"v{axis}_mps" for axis in _XYZ], thing.velocity_n_mps)
        table |= {f"cov_{_XYZ[i]}{_XYZ[j]}_m2": thing.position_cov_n_m2[:, i, j] for i, j in _UPPER}
        table |= {f"cov_v{_XYZ[i]}v{_XYZ[j]}_m2ps2": thing.velocity_cov_n_m2ps2[:, i, j] for i, j in _UPPER}
    if not isinstance(thing, SpinReference) and thing.q_nb is not None:
        table |= _name_columns(_WXYZ, thing.q_nb)
        if thing.cov_b_rad2 is not None:
            table |= {f"cov_{_XYZ[i]}{_XYZ[j]}_rad2": thing.cov_b_rad2[:, i, j] for i, j in _UPPER}
        if thing.gyro_bias_b_radps is not None:
            table |= _name_columns([f"gyro_bias_{axis}_radps" for axis in _XYZ], thing.gyro_bias_b_radps)
    for name in ("angle_rad", "rate_radps", "angle_sd_rad", "rate_sd_radps", "ready"):
        column = getattr(thing, name, None)
        table |= {} if column is None else {name: column}
    return {"": table}


def format_csv(table: Table) -> str:
    """Return a header and a line per sample; every number has as many digits as reading it back exactly takes."""
    return "".join([format_csv_header(table), *format_csv_rows(table)])


def format_csv_header(table: Table) -> str:
    """Return the line of a table's names."""
    return f"{','.join(table)}\n"


def format_csv_rows(table: Table) -> Iterator[str]:
    """Yield the lines of a table without its header, some thousand at a time."""
    columns = [column.astype(int) if column.dtype == np.bool_ else column for column in table.values()]
    for first in range(0, len(columns[0]), ROWS_AT_ONCE):
        rows = zip(*(map(repr, column[first : first + ROWS_AT_ONCE].tolist()) for column in columns), strict=True)
        yield "\n".join([*map(",".join, rows), ""])


def _list_tables(recording: Recording | Piece) -> Mapping[str, Table]:
    """Return one table per stream of a recording or a piece of it, in SI units."""
    tables: dict[str, Table] = {}
    if (imu := recording.imu) is not None:
        columns = np.hstack([imu.gyro_b_radps, imu.accel_b_mps2])
        tables["imu"] = {"t_ns": imu.t_ns, **_name_columns(("gx", "gy", "gz", "ax", "ay", "az"), columns)}
    if (mag := recording.mag) is not None:
        tables["mag"] = {"t_ns": mag.t_ns, **_name_columns(("mx", "my", "mz"), mag.mag_b_ut)}
    if (gps := recording.gps) is not None:
        names = ("t_ns", "lat_deg", "lon_deg", "alt_m", "course_rad", "speed_mps", "valid")
        tables["gps"] = {name: getattr(gps, name) for name in names}
    if recording.spin is not None:
        tables["spin"] = _make_spin_table(recording.spin)
    if (truth := recording.truth) is not None:
        tables["truth"] = {"t_ns": truth.t_ns, **_name_columns(_WXYZ, truth.q_nb)}
        if truth.position_n_m is not None:
            tables["truth"] |= _name_columns(("x_m", "y_m", "z_m"), truth.position_n_m)
        tables["truth"]["moving"] = truth.moving
    for name, series in recording.extra.items():
        tables[f"extra.{name}"] = {"t_ns": series.t_ns, **_name_columns(series.labels, series.values)}
    shafts: dict[str, Encoder | None] = {"encoder": recording.encoder, "roll_truth": recording.roll_truth}
    for name, shaft in shafts.items():
        if shaft is not None:
            tables[name] = {"t_ns": shaft.t_ns, "angle_rad": shaft.angle_rad, "rate_radps": shaft.rate_radps}
    return tables


def _make_spin_table(spin: Spin) -> Table:
    """Return stamps, accelerometers a1, a2 … and gyros g1, g2 … of a spin stream."""
    table = {"t_ns": spin.t_ns}
    for letter, values in (("a", spin.accel_mps2), ("g", spin.gyro_radps)):
        table |= _name_columns([f"{letter}{k + 1}" for k in range(values.shape[1])], values)
    return table


def _name_columns(names: "list[str] | tuple[str, ...]", values: Floats) -> Table:
    """Return the columns of values (N, k) by their names."""
    return dict(zip(names, values.T, strict=True))
