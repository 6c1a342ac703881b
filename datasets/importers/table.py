"""The one table of importers: the command line, the documents and the tests loop over it."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stillpoint.datasets.errors import BadRecording, BadSource
from stillpoint.datasets.importers.bench import read_bench
from stillpoint.datasets.importers.broad import read_broad
from stillpoint.datasets.importers.csv_log import CsvOptions, read_csv
from stillpoint.datasets.importers.flatball import read_flatball
from stillpoint.datasets.importers.options import Options, OwnOptions, PhoneOptions, TyrexOptions
from stillpoint.datasets.importers.phyphox import read_phyphox
from stillpoint.datasets.importers.ros import RosOptions, read_ros
from stillpoint.datasets.importers.sensorlogger import read_sensorlogger
from stillpoint.datasets.importers.spin_csv import SpinOptions, read_spin
from stillpoint.datasets.importers.tyrex import read_tyrex
from stillpoint.datasets.recording import Recording


@dataclass(frozen=True)
class Importer:
    """A kind of source: how to read it, what the user may set, and what it is."""

    read: Callable[[Path, Any], Iterator[Recording]]
    options: type[Options]
    summary: str

    def __call__(self, source: Path | str, options: Options | None = None) -> Iterator[Recording]:
        """The recordings of a source, one by one; ``options`` is an instance of ``self.options``, None its defaults.

        Raises :class:`BadSource` with the source's name, also for arrays that break a rule of the vocabulary.
        """
        try:
            yield from self.read(Path(source), options or self.options())
        except BadRecording as error:
            raise BadSource(f"{source}: {error}") from None


IMPORTERS: dict[str, Importer] = {
    "broad": Importer(read_broad, Options, "BROAD: .mat or .hdf5 trials with optical truth (a file or a folder)"),
    "tyrex": Importer(
        read_tyrex, TyrexOptions, "Tyrex: Android and iOS phones with optical truth (a trial or a folder)"
    ),
    "bench": Importer(read_bench, Options, "bench logs of an MPU6050 and an HMC5883L (folders of MATLAB 7.3 files)"),
    "csv": Importer(read_csv, CsvOptions, "any delimited log: columns, units, signs and clock by flags or a TOML file"),
    "sensorlogger": Importer(read_sensorlogger, PhoneOptions, "the phone app Sensor Logger: its zip or its folder"),
    "phyphox": Importer(read_phyphox, OwnOptions, "the phone app phyphox: its zip, its folder or one CSV file"),
    "spin": Importer(read_spin, SpinOptions, "delimited logs of accelerometers on a spinning body, with its encoder"),
    "flatball": Importer(read_flatball, Options, "flights of the instrumented disc of flatball-ins"),
    "ros": Importer(read_ros, RosOptions, "ROS 1 bags, ROS 2 bags and MCAP files of others"),
}
