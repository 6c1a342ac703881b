"""The one table of importers: the command line, the documents and the tests loop over it."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from stillpoint.datasets.errors import BadRecording, BadSource
from stillpoint.datasets.importers.bench import find_bench, read_bench
from stillpoint.datasets.importers.broad import find_broad, read_broad
from stillpoint.datasets.importers.clock import check_clock, note_disjoint_clocks
from stillpoint.datasets.importers.csv_log import CsvOptions, read_csv
from stillpoint.datasets.importers.delimited_log import list_logs
from stillpoint.datasets.importers.euroc import find_euroc, read_euroc
from stillpoint.datasets.importers.files import find_itself, reading
from stillpoint.datasets.importers.flatball import read_flatball
from stillpoint.datasets.importers.imported import Imported
from stillpoint.datasets.importers.kitti import find_kitti, read_kitti
from stillpoint.datasets.importers.movella import MovellaOptions, read_movella
from stillpoint.datasets.importers.options import Options, OwnOptions, PhoneOptions, TyrexOptions, apply_place_and_date
from stillpoint.datasets.importers.phyphox import read_phyphox
from stillpoint.datasets.importers.ros import RosOptions, read_ros
from stillpoint.datasets.importers.sensorlog import SensorLogOptions, read_sensorlog
from stillpoint.datasets.importers.sensorlogger import read_sensorlogger
from stillpoint.datasets.importers.spin_csv import SpinOptions, read_spin
from stillpoint.datasets.importers.tyrex import find_tyrex, read_tyrex
from stillpoint.datasets.importers.ulog import find_ulog, read_ulog
from stillpoint.datasets.importers.xio import find_ngimu, find_ximu3, read_ngimu, read_ximu3
from stillpoint.datasets.recording import Recording


@dataclass(frozen=True)
class Importer:
    """A kind of source: how to find and read its recordings, what the user may set, and what it is."""

    kind: str
    find: Callable[[Path], list[Path]]  # the files or folders of single recordings in a source
    read: Callable[[Path, Any], Imported]  # one of them
    options: type[Options]
    summary: str

    def __call__(self, source: Path | str, options: Options | None = None) -> Iterator[Recording]:
        """Yield the recordings of a source; ``options`` is an instance of ``self.options``, None its defaults.

        Raises as :meth:`read_one`.
        """
        yield from (imported.recording for imported in self.read_all(source, options))

    def read_all(self, source: Path | str, options: Options | None = None) -> Iterator[Imported]:
        """Yield the recordings of a source with the estimates that the device itself made; raises as `read_one`."""
        yield from (self.read_one(item, options) for item in self.find_items(source))

    def find_items(self, source: Path | str) -> list[Path]:
        """Return the files or folders of single recordings in a source; raises :class:`BadSource` for none."""
        with reading(source, f"a source of kind {self.kind}"):
            return self.find(Path(source))

    def read_one(self, item: Path, options: Options | None = None) -> Imported:
        """Return the recording of one file or folder with the estimates that the device itself made.

        This is the one boundary of the importers: whatever fails while a source is read, in a library or for arrays
        that break a rule of the vocabulary, becomes a :class:`BadSource` with the name of the file or folder.
        """
        options = options or self.options()
        with reading(item, f"a source of kind {self.kind}"), np.errstate(all="ignore"):  # sizes are judged afterwards
            try:
                imported = self.read(item, options)
                recording = note_disjoint_clocks(imported.recording)
                if not options.units_unchecked:
                    check_clock(recording)
                info = apply_place_and_date(recording, options)
                return replace(imported, recording=replace(recording, info=info))
            except BadRecording as error:
                raise BadSource(f"{item}: {error}") from None


_ALL = (
    Importer(
        "broad", find_broad, read_broad, Options, "BROAD: .mat or .hdf5 trials with optical truth (a file or a folder)"
    ),
    Importer(
        "tyrex",
        find_tyrex,
        read_tyrex,
        TyrexOptions,
        "Tyrex: Android and iOS phones with optical truth (a trial or a folder)",
    ),
    Importer(
        "bench",
        find_bench,
        read_bench,
        Options,
        "bench logs of an MPU6050 and an HMC5883L (folders of MATLAB 7.3 files)",
    ),
    Importer(
        "csv", list_logs, read_csv, CsvOptions, "any delimited log: columns, units and clocks by flags or a TOML file"
    ),
    Importer(
        "sensorlogger",
        find_itself,
        read_sensorlogger,
        PhoneOptions,
        "the phone app Sensor Logger: its zip or its folder",
    ),
    Importer(
        "phyphox", find_itself, read_phyphox, OwnOptions, "the phone app phyphox: its zip, its folder or one CSV file"
    ),
    Importer(
        "spin",
        list_logs,
        read_spin,
        SpinOptions,
        "delimited logs of accelerometers on a spinning body, with its encoder",
    ),
    Importer("flatball", list_logs, read_flatball, Options, "flights of the instrumented disc of flatball-ins"),
    Importer("ros", find_itself, read_ros, RosOptions, "ROS 1 bags, ROS 2 bags and MCAP files of others"),
    Importer("euroc", find_euroc, read_euroc, OwnOptions, "folders in the ASL format: EuRoC MAV, TUM-VI"),
    Importer("kitti", find_kitti, read_kitti, OwnOptions, "KITTI raw data: the OXTS unit of a drive"),
    Importer("ulog", find_ulog, read_ulog, OwnOptions, "logs of the PX4 autopilot (.ulg)"),
    Importer("ngimu", find_ngimu, read_ngimu, OwnOptions, "folders of x-io's NGIMU"),
    Importer("ximu3", find_ximu3, read_ximu3, OwnOptions, "folders of x-io's x-IMU3"),
    Importer(
        "movella",
        list_logs,
        read_movella,
        MovellaOptions,
        "CSV files of Movella DOT, text exports of Xsens MTi and MTw",
    ),
    Importer("sensorlog", list_logs, read_sensorlog, SensorLogOptions, "CSV files of the iOS app SensorLog"),
)
IMPORTERS: dict[str, Importer] = {importer.kind: importer for importer in _ALL}
