"""Recordings that are imported in pieces: kept in temporary files until all of them is known, and then written."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.errors import BadRecording, BadSource
from stillpoint.datasets.files.scratch import ScratchStore
from stillpoint.datasets.importers.options import OwnOptions, apply_place_and_date, make_info
from stillpoint.datasets.importers.series import Log
from stillpoint.datasets.plausible import UnitCheck
from stillpoint.datasets.recording import Head, Imu, Info, Mag, Piece, Recording, Times
from stillpoint.datasets.running import ClockFacts, RunningClock
from stillpoint.datasets.times import GAP_STEPS
from stillpoint.datasets.trajectory import Estimate

_LONGEST_STEP_NS = 3 * 3_600_000_000_000  # a longer one may be a stamp that is wrong, which the whole tells
_RATES_HZ = (4.0, 15_000.0)  # well within those that the whole allows
_LONGEST_NS = 30 * 86_400_000_000_000


class NotInPiecesError(Exception):
    """Something depends on the whole of the source, which has to be read whole."""


@dataclass(frozen=True)
class LongRecording:
    """A recording that lies in temporary files, piece by piece, and the attitude of the device where it gives one."""

    head: Head
    clocks: dict[str, ClockFacts]  # of each stream
    _imu: ScratchStore
    _mag: ScratchStore
    estimates: Callable[[], Iterator[Estimate]] | None = None  # its pieces

    def pieces(self) -> Iterator[Piece]:
        """Yield the pieces; can be called several times."""
        fields, waiting = iter(self._mag), np.empty((0, 4), np.int64)
        for imu in self._imu:
            end_ns = int(imu[-1, 0])
            while (not len(waiting) or waiting[-1, 0] <= end_ns) and (more := next(fields, None)) is not None:
                waiting = np.concatenate([waiting, more])
            count = int(np.searchsorted(waiting[:, 0], end_ns, side="right"))
            mag, waiting = waiting[:count], waiting[count:]
            yield Piece(
                imu=Imu(imu[:, 0], imu[:, 1:4].view(np.float64), imu[:, 4:7].view(np.float64)), mag=_make_mag(mag)
            )
        for more in (waiting, *fields):
            if len(more):
                yield Piece(mag=_make_mag(more))


class Collector:
    """Takes a recording piece by piece; raises :class:`NotInPiecesError` where only the whole tells what to do."""

    def __init__(self, name: str, options: OwnOptions) -> None:
        self._name, self._options = name, options
        self._clocks: dict[str, RunningClock] = {}
        self._ends_ns: dict[str, int] = {}
        self._imu, self._mag = ScratchStore(), ScratchStore()
        self._units = UnitCheck(name, options.mag_uncalibrated)
        self._first: Recording | None = None
        self.conversions: list[str] = []  # of the first piece, and so of each

    def add(self, recording: Recording, log: Log) -> None:
        """Keep the samples of a piece, of which the log says what was done; its streams are those of the first."""
        assert recording.imu is not None
        if self._first is None:
            self._first, self.conversions = recording, log.conversions
        if log.conversions != self.conversions or (recording.mag is None) != (self._first.mag is None):
            raise NotInPiecesError
        for name, t_ns in recording.streams():
            before_ns = self._ends_ns.get(name, int(t_ns[0]) - 1)
            if t_ns[0] <= before_ns or np.diff(t_ns, prepend=before_ns).max() > _LONGEST_STEP_NS:
                raise NotInPiecesError
            self._ends_ns[name] = int(t_ns[-1])
            self._clocks.setdefault(name, RunningClock(GAP_STEPS)).add(t_ns)
        imu, mag = recording.imu, recording.mag
        if not self._options.units_unchecked:
            self._units.add(imu, mag)
        self._imu.append(_pack(imu.t_ns, imu.gyro_b_radps, imu.accel_b_mps2))
        if mag is not None:
            self._mag.append(_pack(mag.t_ns, mag.mag_b_ut))

    def close(self, source: str, label: str, sha256: dict[str, str], log: Log) -> LongRecording:
        """Return the recording; ``source`` is for its facts, ``label`` for messages, the log is that of the whole.

        Raises :class:`BadSource` for sizes that do not fit the units.
        """
        if self._first is None or self._first.imu is None:
            raise NotInPiecesError
        clocks = {name: clock.facts() for name, clock in self._clocks.items()}
        imu = clocks["imu"]
        span_ns = max(one.last_ns for one in clocks.values()) - min(one.first_ns for one in clocks.values())
        apart = any(one.first_ns > imu.last_ns or one.last_ns < imu.first_ns for one in clocks.values())
        if apart or span_ns > _LONGEST_NS or not _RATES_HZ[0] <= 1e9 / max(imu.step_ns, 1.0) <= _RATES_HZ[1]:
            raise NotInPiecesError
        if not self._options.units_unchecked:
            try:
                self._units.raise_doubt()
            except BadRecording as error:
                raise BadSource(f"{label}: {error}") from error
        info = self._make_info(make_info(source, self._options, self._first.imu.t_ns, sha256, log))
        samples = {name: one.samples for name, one in clocks.items()}
        return LongRecording(Head(self._name, info, samples), clocks, self._imu, self._mag)

    def _make_info(self, info: Info) -> Info:
        """Return the description with place and date of the options."""
        assert self._first is not None
        info = apply_place_and_date(replace(self._first, info=replace(info, units_unchecked=True)), self._options)
        return replace(info, units_unchecked=self._options.units_unchecked)


def _make_mag(rows: NDArray[np.int64]) -> Mag | None:
    """Return the magnetometer from rows (N, 4) of ns and the bits of µT; None without rows."""
    return Mag(rows[:, 0], rows[:, 1:4].view(np.float64)) if len(rows) else None


def _pack(t_ns: Times, *columns: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return stamps and columns (N, k) side by side, as the bits of integers."""
    return np.column_stack([t_ns, *(np.ascontiguousarray(column).view(np.int64) for column in columns)])
