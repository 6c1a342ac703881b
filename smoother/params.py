"""Settings by name: a dataclass of physical values, changed by a mapping of dotted names, with errors that help."""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from difflib import get_close_matches
from typing import Any, TypeVar, get_args, get_type_hints

from stillpoint.datasets.errors import BadParameter

Params = TypeVar("Params")


def with_settings(defaults: Params, settings: Mapping[str, Any], owner: str) -> Params:
    """The defaults with ``{"rest.window_s": 2.0}`` put in; values may be text, as from a command line.

    Raises :class:`BadParameter` for a name that is not there (with the nearest one) or a value of another kind.
    """
    for name, value in settings.items():
        defaults = _with_one(defaults, name.split("."), value, owner, name)
    return defaults


def names_of(params: object, prefix: str = "") -> list[str]:
    """All dotted names of a settings object, in order."""
    names: list[str] = []
    for entry in fields(params):  # type: ignore[arg-type]
        value = getattr(params, entry.name)
        names += names_of(value, f"{prefix}{entry.name}.") if is_dataclass(value) else [f"{prefix}{entry.name}"]
    return names


def _with_one(params: Any, path: list[str], value: Any, owner: str, name: str) -> Any:
    first, *rest = path
    known = {entry.name for entry in fields(params)}
    nested = first in known and is_dataclass(getattr(params, first))
    if first not in known or nested != bool(rest):
        raise BadParameter(f"{owner}: no setting {name!r}; {_nearest(name, params)}")
    if nested:
        return replace(params, **{first: _with_one(getattr(params, first), rest, value, owner, name)})
    return replace(params, **{first: _converted(params, first, value, owner, name)})


def _converted(params: Any, field_name: str, value: Any, owner: str, name: str) -> Any:
    choices = get_args(get_type_hints(type(params))[field_name])
    if choices:
        if value not in choices:
            raise BadParameter(f"{owner}: {name} is {value!r}; it is one of {', '.join(map(str, choices))}")
        return value
    try:
        return type(getattr(params, field_name))(value)
    except (TypeError, ValueError):
        raise BadParameter(f"{owner}: {name} is {value!r}; give a number") from None


def _nearest(name: str, params: object) -> str:
    names = names_of(params)
    by_leaf = [known for known in names if known.split(".")[-1] == name.split(".")[-1]]
    near = by_leaf or get_close_matches(name, names, n=1, cutoff=0.4)
    return f"did you mean {near[0]!r}?" if near else f"there are {', '.join(names)}"
