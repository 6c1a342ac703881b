"""Settings of the graph of a spinning body."""

from dataclasses import dataclass, field
from typing import Literal

from stillpoint.datasets.settings import Settings, choice, number


@dataclass(frozen=True)
class SpinNoise(Settings):
    """Noise of the accelerometers, as the channels of acceleration and squared rate see it."""

    source: Literal["data", "given"] = choice("data", "white noise as the recording shows it, or the sizes below")
    accel_sd_radps2: float = number(0.7, 1e-4, 1e4, "angular acceleration, white, per sample (sqrt of the paper's Q)")
    squared_sd_rad2ps2: float = number(9.0, 1e-4, 1e5, "squared rate, white, per sample (sqrt of the paper's R)")
    robust: float = number(5.0, 1.0, 100.0, "residuals above this many sd lose their weight (Geman-McClure)")
    unseen_radps2: float = number(100.0, 0.1, 1e5, "angular acceleration where no sample shows it, or a glitch does")


@dataclass(frozen=True)
class SpinCalibration(Settings):
    """Uncertainty of the sensors: sd around zero, of constants unless said otherwise.

    The defaults are those of a data sheet, and of arms measured with a calliper.
    """

    accel_bias_sd_mps2: float = number(0.4, 1e-6, 10.0, "bias of each accelerometer")
    accel_bias_walk: float = number(1e-4, 1e-7, 0.1, "m/s^2 per sqrt(s): its random walk")
    lever_arm_sd: float = number(5e-3, 1e-7, 1.0, "error of a lever arm, and of its accelerometer's scale, relative")
    step_s: float = number(10.0, 0.1, 600.0, "a bias is constant for so long")


@dataclass(frozen=True)
class HarmonicParams(Settings):
    """A quantity that turns with the shaft: gravity on an axis that is not vertical, or a vibration."""

    search: Literal["auto", "gravity", "off"] = choice(
        "auto", "test what it is; take it for gravity without a test; or do not look for it"
    )
    window_s: float = number(2.0, 0.1, 60.0, "over which its phase is followed to begin with")
    significance: float = number(8.0, 2.0, 100.0, "sd by which it must differ from zero")
    agreement: float = number(0.2, 0.01, 1.0, "part of gravity by which both channels may disagree on it")
    amplitude_sd_mps2: float = number(10.0, 0.1, 100.0, "of its amplitude around the start value")
    ripple: float = number(
        5e-4, 1e-6, 0.1, "true ripple of the rate, once per turn, sd, relative; where a vibration hides it"
    )


@dataclass(frozen=True)
class EncoderParams(Settings):
    """A shaft encoder, where the recording has one."""

    use: bool = choice(False, "take it as a measurement; off, because a truth must not leak into what it is to judge")
    latency_sd_s: float = number(5e-3, 1e-6, 1.0, "by which it may be late")
    sd_rad: float = number(1e-3, 1e-7, 1.0, "of its angle beyond its resolution")


@dataclass(frozen=True)
class SpinGraphParams(Settings):
    """Settings of ``method="roll-graph"``."""

    noise: SpinNoise = field(default_factory=SpinNoise)
    calibration: SpinCalibration = field(default_factory=SpinCalibration)
    harmonic: HarmonicParams = field(default_factory=HarmonicParams)
    encoder: EncoderParams = field(default_factory=EncoderParams)
    direction: Literal["positive", "negative"] = choice(
        "positive", "sense of the spin about x where no sensor tells it: a square has no sign"
    )
    block: float = number(24.0, 4.0, 64.0, "samples between keys; the result does not depend on it")
    rate_limit_radps: float = number(1e-5, 1e-12, 1.0, "the solution is found when the rates change by less, RMS")
    iterations: float = number(30.0, 1.0, 200.0, "that the solution may take")
