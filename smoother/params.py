"""Settings: dataclasses of physical values with meaning and range beside each field, changed by dotted names."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from difflib import get_close_matches
from math import isfinite, radians
from typing import Any, TypeVar, get_args, get_type_hints

from stillpoint.datasets.errors import BadParameter


def number(default: float, low: float, high: float, meaning: str) -> Any:
    """A field of :class:`Settings` in the unit of its name, within ``[low, high]``."""
    return field(default=default, metadata={"low": low, "high": high, "meaning": meaning})


def degrees(default_deg: float, low_deg: float, high_deg: float, meaning: str) -> Any:
    """A field in rad or rad/s whose numbers are easier to read in degrees."""
    return number(radians(default_deg), radians(low_deg), radians(high_deg), meaning)


@dataclass(frozen=True)
class Settings:
    """Base of settings dataclasses. Raises :class:`BadParameter` for a number out of its range."""

    def __post_init__(self) -> None:
        for each in fields(self):
            value, limits = getattr(self, each.name), each.metadata
            if "low" in limits and not (isfinite(value) and limits["low"] <= value <= limits["high"]):
                raise BadParameter(
                    f"{each.name} = {value:g} is out of range ({limits['meaning']}); "
                    f"give {limits['low']:.4g} to {limits['high']:.4g}"
                )


Chosen = TypeVar("Chosen", bound=Settings)


def with_settings(defaults: Chosen, changes: Mapping[str, Any], owner: str) -> Chosen:
    """The defaults with ``{"rest.window_s": 2.0}`` put in; values may be text, as from a command line.

    Raises :class:`BadParameter` for a name that is not there (with the nearest one), and for a value of another kind
    or out of range.
    """
    for name, value in changes.items():
        try:
            defaults = _with_one(defaults, name.split("."), value)
        except KeyError:
            raise BadParameter(f"{owner}: no setting {name!r}; {_nearest(name, names_of(defaults))}") from None
        except ValueError as error:
            raise BadParameter(f"{owner}: {name} is {value!r}; {error}") from None
    return defaults


def names_of(settings: Any, prefix: str = "") -> list[str]:
    """All dotted names of a settings object, in order."""
    names: list[str] = []
    for each in fields(settings):
        value = getattr(settings, each.name)
        names += names_of(value, f"{prefix}{each.name}.") if is_dataclass(value) else [f"{prefix}{each.name}"]
    return names


def _with_one(settings: Any, path: list[str], value: Any) -> Any:
    """Raises ``KeyError`` for a name that is not there, ``ValueError`` for a value of another kind."""
    first, *rest = path
    inner = {each.name: getattr(settings, each.name) for each in fields(settings)}[first]
    if is_dataclass(inner) != bool(rest):
        raise KeyError(first)
    new = _with_one(inner, rest, value) if rest else _converted(settings, first, value)
    return replace(settings, **{first: new})


def _converted(settings: Any, name: str, value: Any) -> Any:
    choices = get_args(get_type_hints(type(settings))[name])
    if not choices:
        try:
            return float(value)
        except (TypeError, ValueError):
            raise ValueError("give a number") from None
    if value not in choices:
        raise ValueError(f"it is one of {', '.join(choices)}")
    return value


def _nearest(name: str, names: list[str]) -> str:
    same_end = [known for known in names if known.split(".")[-1] == name.split(".")[-1]]
    near = same_end or get_close_matches(name, names, n=1, cutoff=0.4)
    return f"did you mean {near[0]!r}?" if near else f"there are {', '.join(names)}"
