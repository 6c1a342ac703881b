"""The facts of a recording, reference or estimate beside its columns, as exact JSON for any reader."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields, is_dataclass
from typing import Any

import numpy as np

from stillpoint.datasets.errors import BadRecording
from stillpoint.datasets.mcap.topics import TOPICS
from stillpoint.datasets.recording import Head, Info, Recording, Series, Spin, SpinGeometry
from stillpoint.datasets.trajectory import BasePoseReturn, Calibration, Estimate, Reference, SpinReference

Kept = Recording | Reference | SpinReference | Estimate
KINDS: dict[str, type[Kept]] = {
    "recording": Recording,
    "reference": Reference,
    "roll reference": SpinReference,
    "estimate": Estimate,
}
_NOT_FINITE = "__float__"  # JSON has no nan and no infinity: {"__float__": "nan"}


def get_kind(thing: Kept) -> str:
    """Return the name of its kind in files."""
    for kind, of_kind in KINDS.items():
        if isinstance(thing, of_kind):
            return kind
    raise TypeError(f"{type(thing).__name__} is not one of {', '.join(of_kind.__name__ for of_kind in KINDS.values())}")


def collect_facts(thing: Kept) -> dict[str, Any]:
    """Return everything that is not a column of a topic."""
    if isinstance(thing, Recording):
        return collect_recording_facts(thing.head, thing.spin, thing.extra)
    in_topics = {column.field for topic in TOPICS if not topic.stream for column in topic.columns} | {"t_ns"}
    facts: dict[str, Any] = {name: value for name, value in _list_fields(thing).items() if name not in in_topics}
    if isinstance(thing, Reference):
        facts["calibration"] = _list_fields(thing.calibration)
        facts["returns"] = [asdict(one) for one in thing.returns]
    return facts


def collect_recording_facts(head: Head, spin: Spin | None, extra: Mapping[str, Series]) -> dict[str, Any]:
    """Return everything of a recording that is not a column of a topic, and the facts of its streams."""
    labels = {name: list(series.labels) for name, series in extra.items()}
    return {
        "name": head.name,
        "base_pose": head.base_pose,
        "spin_geometry": None if spin is None else _list_fields(spin.geometry),
        "info": asdict(head.info),
        **({"extra": labels} if labels else {}),
    }


def parse_info(facts: Mapping[str, Any]) -> Info:
    """Return the :class:`Info` of a recording's facts."""
    info: dict[str, Any] = {
        name: tuple(value) if isinstance(value, list) else value for name, value in facts["info"].items()
    }
    return Info(**info)


def spin_geometry_from(facts: Mapping[str, Any]) -> SpinGeometry:
    """Return the :class:`SpinGeometry` of a recording's facts."""
    geometry = dict(facts["spin_geometry"])
    for name in ("accel_r_b_m", "accel_axis_b", "gyro_axis_b"):
        geometry[name] = np.array(geometry[name], np.float64).reshape(-1, 3)
    if geometry.get("accel_range_mps2") is not None:  # files of the first format have no such key
        geometry["accel_range_mps2"] = np.array(geometry["accel_range_mps2"], np.float64)
    return SpinGeometry(**geometry)


def parse_reference_facts(facts: Mapping[str, Any]) -> dict[str, Any]:
    """Return the keywords of a :class:`Reference` that its facts hold."""
    calibration: dict[str, Any] = {
        name: np.array(value, np.float64) if isinstance(value, list) else value
        for name, value in facts["calibration"].items()
    }
    return {
        **facts,
        "calibration": Calibration(**calibration),
        "returns": tuple(BasePoseReturn(**one) for one in facts["returns"]),
        "rests_ns": np.array(facts["rests_ns"], np.int64).reshape(-1, 2),
        "mounting_cov_b_rad2": np.array(facts.get("mounting_cov_b_rad2", np.zeros((3, 3))), np.float64),
        "origin_lat_lon_alt": None if (origin := facts.get("origin_lat_lon_alt")) is None else tuple(origin),
    }


def to_json(facts: Mapping[str, Any]) -> str:
    """Return one line of JSON; raises :class:`BadRecording` for a value that JSON has no word for."""
    plain = _to_plain(facts, "facts")
    text = json.dumps(plain, ensure_ascii=False, allow_nan=False)
    try:
        text.encode()
    except UnicodeEncodeError:  # a file name that is not UTF-8
        text = json.dumps(plain, ensure_ascii=True, allow_nan=False)
    return text


def from_json(text: str) -> dict[str, Any]:
    """Return the inverse of :func:`to_json`; sequences come back as lists. Raises ``ValueError``."""
    facts = json.loads(text, object_hook=_restore_special)
    if not isinstance(facts, dict):
        raise ValueError("facts are no mapping")
    return facts


def _list_fields(thing: Any) -> dict[str, Any]:
    return {field.name: getattr(thing, field.name) for field in fields(thing)}


def _restore_special(item: dict[str, Any]) -> Any:
    """Return the number that an object of :func:`_to_plain` stands for; other objects stay."""
    return float(item[_NOT_FINITE]) if item.keys() == {_NOT_FINITE} else item


def _to_plain(value: Any, where: str) -> Any:
    """Return a value as plain JSON; raises :class:`BadRecording` for a type that has no JSON form."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    elif isinstance(value, np.generic):
        value = value.item()
    elif is_dataclass(value) and not isinstance(value, type):
        value = _list_fields(value)
    if isinstance(value, float) and not np.isfinite(value):
        return {_NOT_FINITE: str(value)}
    if value is None or isinstance(value, str | bool | int | float):
        return value
    if isinstance(value, Mapping):
        return {str(key): _to_plain(item, f"{where}.{key}") for key, item in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, bytes):
        return [_to_plain(item, f"{where}[{k}]") for k, item in enumerate(value)]
    raise BadRecording(f"{where}: is a {type(value).__name__}; give numbers, strings, lists or mappings")
