"""The one table of importers: the command line, the documents and the tests loop over it."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from stillpoint.datasets.errors import BadRecording, BadSource
from stillpoint.datasets.importers.bench import read_bench
from stillpoint.datasets.importers.broad import read_broad
from stillpoint.datasets.importers.clock import check_clock, note_disjoint_clocks
from stillpoint.datasets.importers.csv_log import CsvOptions, read_csv
from stillpoint.datasets.importers.euroc import read_euroc
from stillpoint.datasets.importers.files import reading
from stillpoint.datasets.importers.flatball import read_flatball
from stillpoint.datasets.importers.imported import Imported
from stillpoint.datasets.importers.kitti import read_kitti
from stillpoint.datasets.importers.movella import MovellaOptions, read_movella
from stillpoint.datasets.importers.options import Options, OwnOptions, PhoneOptions, TyrexOptions, apply_place_and_date
from stillpoint.datasets.importers.phyphox import read_phyphox
from stillpoint.datasets.importers.ros import RosOptions, read_ros
from stillpoint.datasets.importers.sensorlog import SensorLogOptions, read_sensorlog
from stillpoint.datasets.importers.sensorlogger import read_sensorlogger
from stillpoint.datasets.importers.spin_csv import SpinOptions, read_spin
from stillpoint.datasets.importers.tyrex import read_tyrex
from stillpoint.datasets.importers.ulog import read_ulog
from stillpoint.datasets.importers.xio import read_ngimu, read_ximu3
from stillpoint.datasets.recording import Recording


@dataclass(frozen=True)
class Importer:
    """A kind of source: how to read it, what the user may set, and what it is."""

    kind: str
    read: Callable[[Path, Any], Iterator[Imported]]
    options: type[Options]
    summary: str

    def __call__(self, source: Path | str, options: Options | None = None) -> Iterator[Recording]:
        """Yield the recordings of a source; ``options`` is an instance of ``self.options``, None its defaults.

        Raises as :meth:`read_all`.
        """
        yield from (imported.recording for imported in self.read_all(source, options))

    def read_all(self, source: Path | str, options: Options | None = None) -> Iterator[Imported]:
        """Yield the recordings of a source with the estimates that the device itself made.

        This is the one boundary of the importers: whatever fails while a source is read, in a library or for arrays
        that break a rule of the vocabulary, becomes a :class:`BadSource` with the name of the source.
        """
        options = options or self.options()
        with (
            reading(source, f"a source of kind {self.kind}"),
            np.errstate(all="ignore"),
        ):  # absurd sizes are judged afterwards
            try:
                for imported in self.read(Path(source), options):
                    recording = note_disjoint_clocks(imported.recording)
                    if not options.units_unchecked:
                        check_clock(recording)
                    info = apply_place_and_date(recording, options)
                    known = recording if info is recording.info else replace(recording, info=info)
                    yield replace(imported, recording=known)
            except BadRecording as error:
                raise BadSource(f"{source}: {error}") from None


_ALL = (
    Importer("broad", read_broad, Options, "BROAD: .mat or .hdf5 trials with optical truth (a file or a folder)"),
    Importer(
        "tyrex", read_tyrex, TyrexOptions, "Tyrex: Android and iOS phones with optical truth (a trial or a folder)"
    ),
    Importer("bench", read_bench, Options, "bench logs of an MPU6050 and an HMC5883L (folders of MATLAB 7.3 files)"),
    Importer("csv", read_csv, CsvOptions, "any delimited log: columns, units and clocks by flags or a TOML file"),
    Importer("sensorlogger", read_sensorlogger, PhoneOptions, "the phone app Sensor Logger: its zip or its folder"),
    Importer("phyphox", read_phyphox, OwnOptions, "the phone app phyphox: its zip, its folder or one CSV file"),
    Importer("spin", read_spin, SpinOptions, "delimited logs of accelerometers on a spinning body, with its encoder"),
    Importer("flatball", read_flatball, Options, "flights of the instrumented disc of flatball-ins"),
    Importer("ros", read_ros, RosOptions, "ROS 1 bags, ROS 2 bags and MCAP files of others"),
    Importer("euroc", read_euroc, OwnOptions, "folders in the ASL format: EuRoC MAV, TUM-VI"),
    Importer("kitti", read_kitti, OwnOptions, "KITTI raw data: the OXTS unit of a drive"),
    Importer("ulog", read_ulog, OwnOptions, "logs of the PX4 autopilot (.ulg)"),
    Importer("ngimu", read_ngimu, OwnOptions, "folders of x-io's NGIMU"),
    Importer("ximu3", read_ximu3, OwnOptions, "folders of x-io's x-IMU3"),
    Importer("movella", read_movella, MovellaOptions, "CSV files of Movella DOT, text exports of Xsens MTi and MTw"),
    Importer("sensorlog", read_sensorlog, SensorLogOptions, "CSV files of the iOS app SensorLog"),
)
IMPORTERS: dict[str, Importer] = {importer.kind: importer for importer in _ALL}
