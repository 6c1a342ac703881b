"""The one table of estimators: the command line, tests, sweeps, reports and documents all read it."""

from collections.abc import Callable
from dataclasses import dataclass
from types import ModuleType
from typing import Any, Protocol, TypeAlias

from stillpoint.datasets.errors import require_known
from stillpoint.datasets.recording import SpinGeometry
from stillpoint.datasets.settings import Settings
from stillpoint.filters import peers
from stillpoint.filters.complementary import (
    complementary,
    euler_blend,
    fixed_gain,
    gyro,
    least_squares,
    moving_average,
    tilt,
)
from stillpoint.filters.kalman import aekf, ekf, kf_axis
from stillpoint.filters.loop import make_run, make_spin_run
from stillpoint.filters.sample import Log, Output, Sample, Track
from stillpoint.filters.spin import aekf as spin_aekf
from stillpoint.filters.spin import ekf as spin_ekf
from stillpoint.filters.spin import guarded as spin_guarded
from stillpoint.filters.spin import observation as spin_observation
from stillpoint.filters.spin.noise import SpinParams
from stillpoint.filters.spin.sample import SpinLog, SpinOutput, SpinSample, SpinTrack

# Each estimator has named tuples of its own for these two.
Constants: TypeAlias = tuple[Any, ...]
State: TypeAlias = tuple[Any, ...]


class Derive(Protocol):
    """Derive an estimator's constants from its parameters and the local declination, rad east of true north."""

    def __call__(self, params: Any, declination_rad: float, /) -> Constants: ...  # noqa: D102


class DeriveSpin(Protocol):
    """Derive the constants of an estimator of a spin from its parameters and the geometry of its sensors."""

    def __call__(self, params: Any, geometry: SpinGeometry, /) -> Constants: ...  # noqa: D102


class Start(Protocol):
    """Return the state before the first sample."""

    def __call__(self, c: Any, /) -> State: ...  # noqa: D102


class Step(Protocol):
    """Return state and output after one more sample."""

    def __call__(self, state: Any, sample: Sample, c: Any, /) -> tuple[State, Output]: ...  # noqa: D102


class SpinStep(Protocol):
    """Return state and output after one more sample of a spin."""

    def __call__(self, state: Any, sample: SpinSample, c: Any, /) -> tuple[State, SpinOutput]: ...  # noqa: D102


class Run(Protocol):
    """Run the step over a log, write the outputs into the track and return the last state."""

    def __call__(self, log: Log, state: State, c: Constants, track: Track, /) -> State: ...  # noqa: D102


class SpinRun(Protocol):
    """Run the step over a log of a spin, write the outputs into the track and return the last state."""

    def __call__(self, log: SpinLog, state: State, c: Constants, track: SpinTrack, /) -> State: ...  # noqa: D102


@dataclass(frozen=True)
class Estimator:
    """One of our estimators; see :mod:`stillpoint.filters.sample` for what its functions take and return."""

    summary: str
    params: type[Settings]
    coefficients: Derive
    start: Start
    step: Step
    run: Run
    module: ModuleType  # of the step, over which the compiled loops close
    gives_bias: bool = False
    gives_cov: bool = False
    innovations: int = 0  # how many normalised innovations an output has
    is_peer: bool = False
    offline: bool = False  # True: it sees the future
    chosen_on: str = ""  # the recordings in sight of which its default parameters were chosen; "": its paper's


@dataclass(frozen=True)
class SpinEstimator:
    """One of our estimators of a spin; :mod:`stillpoint.filters.spin.sample` says what its functions take."""

    summary: str
    params: type[SpinParams]
    coefficients: DeriveSpin
    start: Start
    step: SpinStep
    run: SpinRun
    module: ModuleType
    innovations: int = 1
    is_peer: bool = False
    offline: bool = False


@dataclass(frozen=True)
class Peer:
    """An estimator of another project, which takes a whole recording at a time."""

    summary: str
    params: type[Settings]
    batch: Callable[[peers.PeerInput, Any], peers.PeerTrack]
    is_peer: bool = True
    offline: bool = False
    has_heading: bool = True  # False: its heading has no meaning, even with a magnetometer


def _describe(module: Any, summary: str, **facts: Any) -> Estimator:
    """Return the entry of the estimator in a module; ``facts`` are fields of :class:`Estimator`."""
    functions = module.Params, module.coefficients, module.start, module.step, make_run(module)
    return Estimator(summary, *functions, module, **facts)


def _describe_spin(module: Any, summary: str, innovations: int = 1) -> SpinEstimator:
    """Return the entry of the estimator of a spin in a module."""
    functions = module.Params, module.coefficients, module.start, module.step, make_spin_run(module)
    return SpinEstimator(summary, *functions, module, innovations)


_BROAD = "12 trials of BROAD"

ESTIMATORS: dict[str, Estimator | SpinEstimator | Peer] = {
    "acc": _describe(
        tilt, "tilt and heading by accelerometer and magnetometer alone (Elmi Aziz and Mohseni Araste 2021)"
    ),
    "acc-ma": _describe(moving_average, "moving average of acc over 7 s (Elmi Aziz and Mohseni Araste 2021)"),
    "gyro": _describe(gyro, "integrated rate, never corrected (Elmi Aziz and Mohseni Araste 2021)"),
    "cf": _describe(
        complementary,
        "second-order complementary filter (Elmi Aziz and Mohseni Araste 2021, eq 11)",
        gives_bias=True,
    ),
    "cf-literal": _describe(
        euler_blend,
        "cf as printed: per Euler angle, the gyro's angles never corrected (Elmi Aziz and Mohseni Araste 2021)",
    ),
    "kf-axis": _describe(
        kf_axis,
        "Kalman filter of angle and bias per Euler axis (Byambajav et al.)",
        gives_bias=True,
        gives_cov=True,
        innovations=3,
        chosen_on=_BROAD,
    ),
    "cf-fixed": _describe(
        fixed_gain, "PI complementary filter, fixed gains (Zia 2022, eq 10)", gives_bias=True, chosen_on=_BROAD
    ),
    "cf-lse": _describe(
        least_squares,
        "PI complementary filter, least-squares gains by one-step prediction (Zia 2022)",
        gives_bias=True,
    ),
    "cf-lse-literal": Estimator(
        "PI complementary filter, least-squares gains by eq 22 as printed: keeps its gains (Zia 2022)",
        least_squares.LiteralParams,
        least_squares.literal_coefficients,
        least_squares.start,
        least_squares.step,
        make_run(least_squares),
        least_squares,
        gives_bias=True,
    ),
    "ekf": _describe(
        ekf,
        "extended Kalman filter of attitude and gyro bias, right-invariant error",
        gives_bias=True,
        gives_cov=True,
        innovations=3,
        chosen_on=_BROAD,
    ),
    "aekf": _describe(
        aekf,
        "ekf that adapts to accelerations, magnets, bias steps and vibration (after Asghari et al. 2018)",
        gives_bias=True,
        gives_cov=True,
        innovations=3,
        chosen_on=_BROAD,
    ),
    "iekf": _describe(
        ekf,
        "ekf by the name of its form: the same filter",
        gives_bias=True,
        gives_cov=True,
        innovations=3,
        chosen_on=_BROAD,
    ),
    "vqf": Peer("VQF of the package vqf (Laidig and Seel 2023)", peers.VqfParams, peers.vqf),
    "offline-vqf": Peer(
        "offline VQF of the package vqf: sees the future", peers.VqfParams, peers.offline_vqf, offline=True
    ),
    "madgwick": Peer("gradient descent (Madgwick 2010) of the package ahrs", peers.MadgwickParams, peers.madgwick),
    "mahony": Peer("PI filter on SO(3) (Mahony 2008) of the package ahrs", peers.MahonyParams, peers.mahony),
    "ahrs-ekf": Peer("quaternion EKF of the package ahrs", peers.AhrsEkfParams, peers.ahrs_ekf),
    "fusion": Peer("revised Madgwick of the package imufusion", peers.FusionParams, peers.fusion),
    "riann": Peer(
        "neural network of the package riann (Weber et al. 2021): inclination only",
        peers.RiannParams,
        peers.riann,
        has_heading=False,
    ),
    "roll-obs": _describe_spin(
        spin_observation, "spin: root of the observed square of the rate (Asghari et al. 2018)", innovations=0
    ),
    "roll-ekf": _describe_spin(spin_ekf, "spin: extended Kalman filter of the rate (Asghari et al. 2018, eqs 11-14)"),
    "roll-aekf": _describe_spin(spin_aekf, "spin: adaptive extended Kalman filter (Asghari et al. 2018, eqs 15-23)"),
    "roll-guarded": _describe_spin(spin_guarded, "spin: angle, rate and bias, guarded against bad samples"),
}


ATTITUDES = tuple(name for name, entry in ESTIMATORS.items() if not isinstance(entry, SpinEstimator))
SPINS = tuple(name for name in ESTIMATORS if name not in ATTITUDES)


def find_estimator(name: str) -> Estimator | SpinEstimator | Peer:
    """Return the entry of this name; raises :class:`BadParameter` with the nearest one."""
    require_known(name, ESTIMATORS, "estimator")
    return ESTIMATORS[name]
