"""Describe the single-axis accelerometers, gyros and encoder of a spinning body, with presets.

A value marked "sd" is drawn once per recording and accelerometer; the rest are plain values. The presets are the noise
hypotheses that the numbers printed by Asghari et al. (2018) leave open (docs/simulation.md): the paper
states variances of its sensors, and not what they are made of.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from stillpoint.datasets.errors import BadParameter

_ADXL345_NOISE_MPS2 = 0.06  # rms of one sample, as measured on boards of the +-16 g range


@dataclass(frozen=True)
class SpinAccel:
    """The errors of one accelerometer."""

    noise_mps2: float = 0.0  # white, standard deviation of a sample
    vibration_1x_mps2: float = 0.0  # rms of what the motor shakes it with, once per turn
    vibration_2x_mps2: float = 0.0  # twice per turn
    glitches_per_s: float = 0.0  # samples that the slip rings spoil
    glitch_low_g: float = 4.0  # least and largest size of a glitch, either sign
    glitch_high_g: float = 8.0
    offset_mps2: float = 0.0  # what calibration left, as a value
    bias_mg: float = 0.0  # sd
    scale_error: float = 0.0  # sd, fraction
    arm_error: float = 0.0  # sd, fraction of the lever arm: true = stated * (1 + error)


@dataclass(frozen=True)
class EncoderModel:
    """A shaft encoder: angle by counting edges, rate by timing the last edge of every sample."""

    counts_per_turn: int | None = 4096  # None: angle and rate without steps
    timer_s: float = 62.5e-9  # step of the clock that times the edges: 16 MHz
    latency_s: float = 0.5e-3  # a value stamped t describes t - latency


@dataclass(frozen=True)
class SpinSensor:
    """All errors between the true spin and the recorded numbers."""

    name: str
    centre: SpinAccel = field(default_factory=SpinAccel)  # F1, F2, F3
    radial: SpinAccel = field(default_factory=SpinAccel)  # F4
    tangential: SpinAccel = field(default_factory=SpinAccel)  # F5
    range_g: float = 16.0
    bits: int | None = 13  # of the converter, over the range to both sides
    gyro_noise_degps: float = 0.0  # white, standard deviation of a sample
    gyro_bias_degps: float = 0.0  # sd
    tilt_deg: float = 0.0  # of a motor's shaft against the vertical: gravity turns through the accelerometers
    lost_share: float = 0.0  # of the samples that never reach the computer
    encoder: EncoderModel | None = field(default_factory=EncoderModel)  # None: there is none

    def __post_init__(self) -> None:
        """Check all values; raises :class:`BadParameter`."""
        for part, name, value in _list_numbers(self):
            signed = name in ("offset_mps2", "tilt_deg", "latency_s")
            if value is not None and not (np.isfinite(value) and (signed or value >= 0)):
                raise BadParameter(f"sensor {self.name}, {part}{name}: is {value:g}; give a finite value >= 0")
        if not 0 <= self.lost_share < 1:
            raise BadParameter(f"sensor {self.name}, lost_share: is {self.lost_share:g}; give a share below 1")


def _list_numbers(sensor: SpinSensor) -> Iterator[tuple[str, str, float | None]]:
    """Yield part, name and value of every number in a sensor."""
    for each in fields(sensor):
        value: Any = getattr(sensor, each.name)
        if isinstance(value, SpinAccel | EncoderModel):
            yield from ((f"{each.name}.", one.name, getattr(value, one.name)) for one in fields(value))
        elif each.name != "name" and not (each.name == "encoder" and value is None):
            yield "", each.name, value


def make_white_noise(name: str, centre_mps2: float, radial_mps2: float, tangential_mps2: float) -> SpinSensor:
    """Return a sensor with white noise of these standard deviations and no other error."""
    centre, radial, tangential = (SpinAccel(noise_mps2=one) for one in (centre_mps2, radial_mps2, tangential_mps2))
    return SpinSensor(name, centre, radial, tangential, gyro_noise_degps=0.1)


def _add_glitches(sensor: SpinSensor, per_s: float) -> SpinSensor:
    """Return the sensor with glitches of the slip rings on F4, 4 to 8 g."""
    return replace(sensor, radial=replace(sensor.radial, glitches_per_s=per_s))


def _make_presets(white: SpinSensor, quiet: SpinSensor) -> Mapping[str, SpinSensor]:
    """Return the presets of a scenario by name; ``white`` has the printed variances, ``quiet`` is the noise under
    glitches.
    """
    shaken_mps2 = (white.tangential.noise_mps2**2 - _ADXL345_NOISE_MPS2**2) ** 0.5  # D5 once per turn, not white
    shaken = SpinAccel(noise_mps2=_ADXL345_NOISE_MPS2, vibration_1x_mps2=shaken_mps2)
    vibration = replace(white, name="vibration", tangential=shaken)
    turning, rest = (share**0.5 * white.radial.noise_mps2 for share in (_VIBRATION_F4, 1 - _VIBRATION_F4))
    radial = SpinAccel(noise_mps2=rest, vibration_1x_mps2=turning)
    vibration_f4 = replace(white, name="vibration-f4", radial=radial)
    glitch = replace(_add_glitches(quiet, _GLITCHES_PER_S), name="glitch")
    noise = _REPLICA_NOISE * glitch.radial.noise_mps2
    fitted = {"offset_mps2": _RESIDUAL_F4_MPS2, "noise_mps2": noise, "glitch_low_g": _REPLICA_GLITCH_LOW_G}
    replica = replace(glitch, name="replica", radial=replace(glitch.radial, **fitted))
    part = SpinAccel(noise_mps2=_ADXL345_NOISE_MPS2, bias_mg=40.0, scale_error=0.005, arm_error=0.001)
    loose = SpinSensor("adxl345", part, part, part, gyro_noise_degps=0.1, gyro_bias_degps=0.2, lost_share=0.001)
    perfect = SpinSensor("perfect", bits=None, encoder=EncoderModel(counts_per_turn=None, latency_s=0.0))
    return {one.name: one for one in (white, vibration, vibration_f4, glitch, replica, loose, perfect)}


def _make_tilted_presets(white: SpinSensor) -> Mapping[str, SpinSensor]:
    """Return presets of a shaft that is not vertical, with unknown biases and arm errors: gravity shows the angle."""
    radial, tangential = (replace(one, offset_mps2=0.1, arm_error=0.001) for one in (white.radial, white.tangential))
    unknown = replace(white, radial=radial, tangential=tangential)
    return {name: replace(unknown, name=name, tilt_deg=tilt) for name, tilt in (("tilted", 30.0), ("horizontal", 90.0))}


_VIBRATION_F4 = 0.7  # share of D4 that is vibration in the preset "vibration-f4"
_GLITCHES_PER_S = 2 / 30  # about two in a recording of 30 s
# Fitted to the worst of ten trials with the printed AEKF of Asghari et al. 2018: 3 deg, 20.92 deg/s, RMSE 1.25 deg/s.
_RESIDUAL_F4_MPS2 = 0.009  # 0.9 mg: 2.2 deg after 30 s
_REPLICA_NOISE = 1.05  # of the quiet sensor's
_REPLICA_GLITCH_LOW_G = 3.7  # the smaller a glitch, the less alpha keeps it out
# D4 = 0.8 and D5 = 0.12 (m/s^2)^2 in the constant scenario (eqs (29), (31)), 0.4 and 3 in the variable one.
_WHITE_CONSTANT = make_white_noise("white", 0.3, 0.8**0.5, 0.12**0.5)
_WHITE_VARIABLE = make_white_noise("white", 0.3, 0.4**0.5, 3.0**0.5)
CONSTANT = {
    **_make_presets(_WHITE_CONSTANT, make_white_noise("quiet", 0.06, 0.13, 0.08)),
    **_make_tilted_presets(_WHITE_CONSTANT),
}
VARIABLE = {
    **_make_presets(_WHITE_VARIABLE, make_white_noise("quiet", 0.06, 0.3, 3.0**0.5)),
    **_make_tilted_presets(_WHITE_VARIABLE),
}
FLIGHT = _make_presets(make_white_noise("white", 0.3, 0.3, 0.3), make_white_noise("quiet", 0.1, 0.1, 0.1))
