"""``stillpoint export-c``: filters as C99 for microcontrollers."""

from math import radians
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.importers.spin_csv import SpinOptions, find_geometry
from stillpoint.filters.c.export import EXPORTED, CSource, export_filter
from stillpoint.filters.table import SPINS
from stillpoint.scripts.shared import inputs
from stillpoint.scripts.shared.batch import parse_assignments
from stillpoint.scripts.shared.estimator_choice import EXAMPLE
from stillpoint.scripts.shared.flags import SetFlag, split_names
from stillpoint.scripts.shared.output import print_line, write_text
from stillpoint.studies.leaderboard.entrants import read_settings


def export_c(
    *,
    estimators: Annotated[str, Parameter(name=["--estimators", "-e"])] = ",".join(EXPORTED),
    out: Annotated[Path, Parameter(name=["--out", "-o"])],
    set_: SetFlag = None,
    declination: float = 0.0,
    geometry: str = "bench",
) -> int:
    """Write filters as C99 for microcontrollers: one header and one source per filter, without dependencies.

    The source is translated from the filter that estimate and stream run, and gives the same bits in double precision.
    It allocates nothing. Define STILLPOINT_SINGLE for single precision. The guard of stream against broken samples is
    not part of it.

    Parameters
    ----------
    estimators
        Names with commas between: cf, cf-fixed, kf-axis, ekf, roll-ekf, roll-aekf; by default all of them.
        NAME@FILE.toml takes the parameters that tune saved.
    out
        Folder to write into; made when it is not there.
    set_
        A parameter, ESTIMATOR.NAME=VALUE, for example cf.omega0_radps=0.3; can be given several times.
    declination
        From true to magnetic north at the place of the run, degrees, east positive; 0: north is magnetic.
    geometry
        Where the accelerometers of a spin sit: bench, five, or a .toml file as import spin takes it.
    """
    settings = _read_all_settings(estimators, set_)
    spins = [name for name in settings if name in SPINS]
    where = find_geometry(SpinOptions(geometry=geometry)) if spins else None
    made = [export_filter(name, params, radians(declination), where) for name, params in settings.items()]
    folder = inputs.make_output_dir(out)
    for one in made:
        _write(one, folder)
    print_line(f"written to {folder}: {', '.join(f'{one.stem}.h, {one.stem}.c' for one in made)}")
    return 0


def _read_all_settings(estimators: str, set_: list[str] | None) -> dict[str, dict[str, Any]]:
    """Return the parameters that differ from their defaults, by estimator. Raises :class:`BadParameter`."""
    settings: dict[str, dict[str, Any]] = {}
    for word in split_names(estimators):
        name, at, file = word.partition("@")
        if name not in EXPORTED:
            raise BadParameter(f"{name}: cannot be exported to C; choose among {', '.join(EXPORTED)}")
        settings[name] = dict(read_settings(Path(file), name)[0]) if at else {}
    for path, value in parse_assignments(set_, EXAMPLE).items():
        owner, dot, name = path.partition(".")
        if not dot or owner not in settings:
            raise BadParameter(f"--set {path}={value}: write ESTIMATOR.NAME=VALUE of {', '.join(settings)}")
        settings[owner][name] = value
    return settings


def _write(made: CSource, folder: Path) -> None:
    """Write both files of a filter."""
    write_text(folder / f"{made.stem}.h", made.header)
    write_text(folder / f"{made.stem}.c", made.source)
