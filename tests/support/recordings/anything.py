"""Any recording, reference or estimate there can be, for hypothesis to choose from."""

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from stillpoint.datasets import (
    BasePoseReturn,
    Calibration,
    Encoder,
    Estimate,
    Gps,
    Imu,
    Info,
    Mag,
    Recording,
    Reference,
    Spin,
    SpinGeometry,
    SpinReference,
    Truth,
)

ANY = {"allow_nan": False, "allow_infinity": False, "width": 64}


def floats(*shape, elements=None):
    return arrays(np.float64, shape, elements=st.floats(**ANY) if elements is None else elements)


@st.composite
def stamps(draw, least=1):
    steps = draw(st.lists(st.integers(1, 10**12), min_size=least, max_size=6))
    return draw(st.integers(0, 2**60)) + np.cumsum(np.array(steps, np.int64))


@st.composite
def quaternions(draw, n):
    q = draw(floats(n, 4, elements=st.floats(0.1, 1.0)))
    signs = draw(arrays(np.float64, (n, 4), elements=st.sampled_from([-1.0, 1.0])))
    return signs * q / np.linalg.norm(q, axis=1, keepdims=True)


@st.composite
def covariances(draw, n):
    cov = draw(floats(n, 3, 3))
    cov[:, range(3), range(3)] = draw(floats(n, 3, elements=st.floats(1e-300, 1e3)))
    return cov


def maybe(strategy):
    return st.none() | strategy


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=6,
)
json_maps = st.dictionaries(st.text(), json_values, max_size=3).filter(lambda d: "__float__" not in str(d))
words = st.dictionaries(st.text(), st.text(), max_size=2)
nan_floats = st.floats(width=64)


@st.composite
def infos(draw):
    place = st.tuples(st.floats(-90, 90), st.floats(-180, 180), st.floats(-400, 9000))
    return Info(
        source=draw(st.text()),
        licence=draw(st.text()),
        epoch=draw(st.sampled_from(["unix", "source"])),
        place_lat_lon_alt=draw(maybe(place)),
        mag_uncalibrated=draw(st.booleans()),
        units_unchecked=True,
        sha256=draw(words),
        conversions=tuple(draw(st.lists(st.text(), max_size=2))),
        notes=tuple(draw(st.lists(st.text(), max_size=2))),
        extra=draw(words),
    )


@st.composite
def spins(draw):
    t, k, m = draw(stamps()), draw(st.integers(1, 4)), draw(st.integers(0, 2))
    axes = draw(quaternions(k + m))[:, :3]
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    ranges = draw(maybe(floats(k, elements=st.floats(1e-300, 1e300))))
    values = st.floats(**ANY) | st.just(np.nan)
    geometry = SpinGeometry(draw(floats(k, 3, elements=values)), axes[:k], axes[k:], ranges, draw(st.booleans()))
    return Spin(t, draw(floats(len(t), k, elements=values)), draw(floats(len(t), m, elements=values)), geometry)


@st.composite
def encoders(draw):
    t = draw(stamps())
    return Encoder(t, draw(floats(len(t))), draw(floats(len(t))))


@st.composite
def gps_streams(draw):
    t = draw(stamps())
    n = len(t)
    valid = draw(arrays(np.bool_, n))
    lat, lon = draw(floats(n, elements=st.floats(-90, 90))), draw(floats(n, elements=st.floats(-180, 180)))
    lat[~valid] = draw(floats(int((~valid).sum()), elements=nan_floats))
    return Gps(t, lat, lon, *(draw(floats(n, elements=nan_floats)) for _ in range(3)), valid)


@st.composite
def truths(draw):
    t = draw(stamps())
    position = draw(maybe(floats(len(t), 3, elements=nan_floats)))
    return Truth(t, draw(quaternions(len(t))), draw(arrays(np.bool_, len(t))), position)


@st.composite
def recordings(draw):
    t, t_mag = draw(stamps()), draw(stamps())
    imu = Imu(t, draw(floats(len(t), 3)), draw(floats(len(t), 3)))
    spin = draw(maybe(spins()))
    base_pose = draw(maybe(quaternions(1)))
    return Recording(
        name=draw(st.text()),
        imu=draw(maybe(st.just(imu))) if spin else imu,
        mag=draw(maybe(floats(len(t_mag), 3).map(lambda m: Mag(t_mag, m)))),
        gps=draw(maybe(gps_streams())),
        spin=spin,
        encoder=draw(maybe(encoders())),
        truth=draw(maybe(truths())),
        roll_truth=draw(maybe(encoders())),
        base_pose=None if base_pose is None else base_pose[0],
        info=draw(infos()),
    )


@st.composite
def references(draw):
    t = draw(stamps())
    n = len(t)
    calibration = Calibration(
        gyro_matrix=draw(maybe(floats(3, 3))),
        hard_iron_b_ut=draw(maybe(floats(3))),
        clock_offset_s=draw(st.dictionaries(st.text(), st.floats(**ANY), max_size=2)),
    )
    back = st.builds(
        BasePoseReturn, st.integers(0, 2**62), st.integers(0, 2**62), st.floats(**ANY), st.booleans(), st.text()
    )
    rests = np.array(draw(st.lists(st.tuples(st.integers(0, 2**62), st.integers(0, 2**62)), max_size=2)), np.int64)
    return Reference(
        t,
        draw(quaternions(n)),
        draw(covariances(n)),
        draw(floats(n, 3)),
        method=draw(st.text()),
        name=draw(st.text()),
        heading_sd_rad=draw(st.floats(0, 3)),
        calibration=calibration,
        rests_ns=rests.reshape(-1, 2),
        returns=tuple(draw(st.lists(back, max_size=2))),
        params=draw(json_maps),
        diagnostics=draw(json_maps),
        made_from=draw(words),
    )


@st.composite
def spin_references(draw):
    t = draw(stamps())
    columns = [draw(floats(len(t))) for _ in range(4)]
    return SpinReference(t, *columns, method=draw(st.text()), params=draw(json_maps), made_from=draw(words))


@st.composite
def estimates(draw):
    t = draw(stamps())
    n = len(t)
    q_nb, angle = draw(maybe(quaternions(n))), draw(maybe(floats(n)))
    if q_nb is None and angle is None:
        angle = draw(floats(n))
    return Estimate(
        t,
        name=draw(st.text()),
        q_nb=q_nb,
        angle_rad=angle,
        rate_radps=draw(maybe(floats(n))),
        cov_b_rad2=None if q_nb is None else draw(maybe(covariances(n))),
        innovation=draw(maybe(st.integers(0, 3).flatmap(lambda m: floats(n, m, elements=nan_floats)))),
        gyro_bias_b_radps=draw(maybe(floats(n, 3))),
        ready=draw(maybe(arrays(np.bool_, n))),
        recording=draw(st.text()),
        params=draw(json_maps),
        ns_per_sample=draw(st.floats()),
    )
