"""``gains(recording, name)``: the gains of an adaptive filter over time (Zia 2022, figures 10 and 11)."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from stillpoint.datasets import BadParameter, Recording
from stillpoint.datasets.recording import Floats, Times
from stillpoint.datasets.settings import Settings, choose_settings
from stillpoint.filters.complementary import least_squares
from stillpoint.filters.front.heading_source import Heading
from stillpoint.filters.front.sources import find_sources, prepare_log
from stillpoint.filters.precision import Precision, to_precision
from stillpoint.filters.table import ESTIMATORS, Estimator


@dataclass(frozen=True, eq=False)
class Gains:
    """The gains of eq (10) after each sample; columns are roll, pitch, heading."""

    t_ns: Times  # (N,)
    kp_per_s: Floats  # (N, 3)
    ki_per_s2: Floats  # (N, 3)


def gains(
    recording: Recording,
    name: str,
    params: Settings | Mapping[str, Any] | None = None,
    precision: Precision = "double",
    heading: Heading = "mag",
) -> Gains:
    """Return the gains that ``estimate(recording, name, params, precision, heading)`` uses at each sample.

    Raises :class:`BadParameter` also for an estimator that does not adapt gains of its own.
    """
    entry = ESTIMATORS.get(name)
    if not isinstance(entry, Estimator) or entry.step is not least_squares.step:
        raise BadParameter(f"{name}: has no adaptive gains; cf-lse and cf-lse-literal have")
    settings = choose_settings(entry.params(), params, name)
    sources = find_sources(recording, heading, None, None)
    imu = recording.require_imu()
    log, _ = prepare_log(imu, sources, precision)
    c = to_precision(entry.coefficients(settings, sources.plan.declination_rad), precision)
    kp_per_s, ki_per_s2 = np.empty((2, len(imu.t_ns), 3))
    least_squares.run_gains(log, to_precision(entry.start(c), precision), c, kp_per_s, ki_per_s2)
    return Gains(imu.t_ns, kp_per_s, ki_per_s2)
