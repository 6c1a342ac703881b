"""Settings: dataclasses of physical values with their meaning and range, changed by dotted names."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import Field, dataclass, field, fields, is_dataclass, replace
from math import degrees as in_degrees
from math import isfinite, radians
from numbers import Real
from typing import Any, Literal, NamedTuple, TypeVar, cast, get_args, get_origin, get_type_hints

from stillpoint.datasets.errors import BadParameter, nearest

_TRUTH_VALUES = {"true": True, "false": False}
_UNITS_IN_DEGREES = {
    "_rad": "deg",
    "_radps": "deg/s",
    "_rad_rts": "deg/√s",
    "_radps_rts": "deg/s/√s",
    "_rad_per_mps2": "deg per m/s^2",
}


def number(default: float, low: float, high: float, meaning: str) -> Any:
    """Declare a field of :class:`Settings` in the unit of its name, within ``[low, high]``."""
    return field(default=default, metadata={"low": low, "high": high, "meaning": meaning})


def degrees(default_deg: float, low_deg: float, high_deg: float, meaning: str) -> Any:
    """Declare a field in rad, rad/s or rad/sqrt(s), by its name, that tables show in degrees."""
    limits = {"low": radians(low_deg), "high": radians(high_deg)}
    return field(default=radians(default_deg), metadata={**limits, "meaning": meaning, "in_degrees": True})


def choice(default: Any, meaning: str) -> Any:
    """Declare a field that is one of the words of its ``Literal``, or a ``bool``."""
    return field(default=default, metadata={"meaning": meaning})


@dataclass(frozen=True)
class Settings:
    """Base of settings dataclasses, which may nest. Raises :class:`BadParameter` for a value out of its range.

    Every field is made by :func:`number`, :func:`degrees` or :func:`choice`, or is itself a :class:`Settings`.
    """

    def __post_init__(self) -> None:
        """Check all values; raises :class:`BadParameter` with the allowed ones."""
        hints = get_type_hints(type(self))
        for each in fields(self):
            if each.metadata:
                object.__setattr__(self, each.name, _check_value(each, hints[each.name], getattr(self, each.name)))


Kind = TypeVar("Kind", bound=Settings)


def choose_settings(defaults: Kind, given: Settings | Mapping[str, Any] | None, owner: str) -> Kind:
    """Return the settings given, or the defaults with changes such as ``{"rest.window_s": 2.0}`` applied; errors name
    ``owner``.

    Values may be text, as from a command line. Raises :class:`BadParameter` for settings of another owner, a name that
    is not there (with the nearest one), and a value of another kind or out of range.
    """
    if isinstance(given, type(defaults)):
        return given
    if given is not None and not isinstance(given, Mapping):
        kinds = type(given).__qualname__, type(defaults).__qualname__
        raise BadParameter(f"{owner}: {kinds[0]} of {type(given).__module__} are not its settings; give its {kinds[1]}")
    for name, value in (given or {}).items():
        try:
            defaults = _replace_one(defaults, name.split("."), value)
        except KeyError:
            raise BadParameter(f"{owner}: no setting {name!r}; {nearest(name, list_names(defaults))}") from None
        except BadParameter as error:
            raise BadParameter(f"{owner}: {name.removesuffix(name.rpartition('.')[2])}{error}") from None
    return defaults


class Description(NamedTuple):
    """One setting as a row of a table, with angles in degrees."""

    name: str  # dotted
    default: str
    allowed: str
    meaning: str


def list_names(settings: Settings) -> list[str]:
    """Return all dotted names of a settings object, in order."""
    return [name for name, _, _ in _list_leaves(settings)]


def describe(settings: Settings) -> list[Description]:
    """Describe all settings of a settings object, with its values as defaults."""
    return [
        Description(
            name,
            f"{_format_readable(each, getattr(owner, each.name))} {_find_unit(each)}".rstrip(),
            _describe_allowed(each, get_type_hints(type(owner))[each.name], _format_readable),
            each.metadata["meaning"],
        )
        for name, each, owner in _list_leaves(settings)
    ]


def _list_leaves(settings: Settings, prefix: str = "") -> Iterator[tuple[str, Field[Any], Settings]]:
    """Yield the dotted name and field of each setting, and the object that has it."""
    for each in fields(settings):
        value = getattr(settings, each.name)
        if is_dataclass(value):
            yield from _list_leaves(cast(Settings, value), f"{prefix}{each.name}.")
        else:
            yield f"{prefix}{each.name}", each, settings


def _replace_one(settings: Kind, path: list[str], value: Any) -> Kind:
    """Return the settings with one value replaced. Raises ``KeyError`` for an unknown name, :class:`BadParameter` for
    a value that is not allowed.
    """
    first, *rest = path
    inner = {each.name: getattr(settings, each.name) for each in fields(settings)}[first]
    if is_dataclass(inner) != bool(rest):
        raise KeyError(first)
    new = _replace_one(cast(Settings, inner), rest, value) if rest else _parse_text(settings, first, value)
    return replace(settings, **{first: new})


def _parse_text(settings: Settings, name: str, value: Any) -> Any:
    """Return the value that a text means for this field; other values are returned unchanged."""
    hint = get_type_hints(type(settings))[name]
    if not isinstance(value, str) or get_origin(hint) is Literal:
        return value
    if hint is bool:
        return _TRUTH_VALUES.get(value.lower(), value)
    try:
        return float(value)
    except ValueError:
        return value


def _check_value(each: Field[Any], hint: Any, value: Any) -> Any:
    """Return a value in the type of its field; raises :class:`BadParameter` where it is not allowed."""
    if get_origin(hint) is Literal:
        good = value in get_args(hint)
    elif hint is bool:
        good = isinstance(value, bool)
    else:
        good = isinstance(value, Real) and not isinstance(value, bool) and isfinite(value)
        good = good and each.metadata["low"] <= value <= each.metadata["high"]
        value = float(value) if good else value
    if not good:
        kind = "a number from " if "low" in each.metadata else ""
        raise BadParameter(
            f"{each.name} = {value!r} is not allowed ({each.metadata['meaning']}); "
            f"give {kind}{_describe_allowed(each, hint, _format_plain)}"
        )
    return value


def _describe_allowed(each: Field[Any], hint: Any, shown: Callable[[Field[Any], Any], str]) -> str:
    """Return the allowed values of a field as text: words, or a range."""
    if get_origin(hint) is Literal:
        return ", ".join(map(str, get_args(hint)))
    if hint is bool:
        return ", ".join(map(str, (True, False)))
    return f"{shown(each, each.metadata['low'])} to {shown(each, each.metadata['high'])}"


def _format_plain(each: Field[Any], value: Any) -> str:
    return f"{value:.4g}"


def _format_readable(each: Field[Any], value: Any) -> str:
    """Return a value as text, angles in deg."""
    if isinstance(value, bool | str):
        return str(value)
    return f"{in_degrees(value) if _find_unit(each) else value:g}"


def _find_unit(each: Field[Any]) -> str:
    """Return the unit of an angle that tables show in degrees; other units stand in the name of the field."""
    if not each.metadata.get("in_degrees"):
        return ""
    return next(unit for suffix, unit in _UNITS_IN_DEGREES.items() if each.name.endswith(suffix))
