"""A study is a file: recordings, estimators with their parameters, input, judge and alignment, as TOML."""

import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import partial
from pathlib import Path
from typing import Any, Literal, get_args

from stillpoint.datasets.errors import BadParameter, nearest, require_known
from stillpoint.datasets.files.remote import is_url
from stillpoint.scoring import ALIGN_KINDS, AlignKind

Against = Literal["auto", "truth", "reference", "both"]
AGAINST: tuple[str, ...] = get_args(Against)
NONE, REFERENCE = "none", "reference"


@dataclass(frozen=True)
class Study:
    """The recordings, estimators and rules of a leaderboard."""

    recordings: tuple[str, ...]  # files, folders or globs
    estimators: tuple[str, ...] = ()  # empty: every one of attitude whose package is installed
    params: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)  # by estimator
    against: Against = "auto"  # truth where a recording has it, the reference elsewhere
    align: AlignKind = "heading"
    calibration: tuple[str, ...] = (NONE,)  # each kind of input gives its own rows
    groups: tuple[str, ...] | None = None  # tags and devices with a table of their own; None: all
    sha256: Mapping[str, str] = field(default_factory=dict)  # of each recording when the study was made

    def __post_init__(self) -> None:
        """Check the study; raises :class:`BadParameter` for an unknown judge or alignment, or without recordings."""
        require_known(self.against, AGAINST, "--against")
        require_known(self.align, ALIGN_KINDS, "alignment")
        if not self.recordings:
            raise BadParameter("no recordings: name files, folders or globs")
        if not self.calibration:
            raise BadParameter("--calibration: name none, reference or a file, several with commas between")

    def as_dict(self) -> dict[str, Any]:
        """Return the study as plain values."""
        return {each.name: getattr(self, each.name) for each in fields(self)}


def read_study(path: Path) -> Study:
    """Read a study; relative paths in it are relative to its folder. Raises :class:`BadParameter`."""
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise BadParameter(f"{path}: cannot be read ({error.strerror}); check the name") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise BadParameter(f"{path}: is not TOML ({error})") from None
    known = [each.name for each in fields(Study)]
    unknown = next((name for name in content if name not in (*known, "stillpoint")), None)
    if unknown is not None:
        raise BadParameter(f"{path}: has no setting {unknown!r}; {nearest(unknown, known)}")
    content.pop("stillpoint", None)
    recordings = [_resolve_path(path, text) for text in _parse_texts(content, "recordings", path)]
    given: dict[str, Any] = {**content, "recordings": tuple(recordings)}
    for name in ("estimators", "calibration", "groups"):
        if name in content:
            given[name] = tuple(_parse_texts(content, name, path))
    given["calibration"] = tuple(
        text if text in (NONE, REFERENCE) else _resolve_path(path, text) for text in given.get("calibration", (NONE,))
    )
    given["estimators"] = tuple(
        map_own_file(text, partial(_resolve_path, path)) for text in given.get("estimators", ())
    )
    return Study(**given)


def format_study(study: Study, version: str) -> str:
    """Return the study as TOML, with the version of stillpoint that ran it."""
    lines = [
        "# stillpoint leaderboard -c study.toml -o OUT repeats this study.",
        f"stillpoint = {_format_value(version)}",
    ]
    for each in fields(study):
        value = getattr(study, each.name)
        if value is not None and not isinstance(value, Mapping):
            lines.append(f"{each.name} = {_format_value(value)}")
    for name, params in study.params.items():
        lines += [
            "",
            f"[params.{_format_value(name)}]",
            *(f"{key} = {_format_value(value)}" for key, value in params.items()),
        ]
    if study.sha256:
        lines += [
            "",
            "[sha256]",
            *(f"{_format_value(name)} = {_format_value(digest)}" for name, digest in study.sha256.items()),
        ]
    return "\n".join(lines) + "\n"


def _parse_texts(content: Mapping[str, Any], name: str, path: Path) -> Sequence[str]:
    """Return a text or a list of texts as a list; raises :class:`BadParameter` for anything else."""
    value = content.get(name, [])
    if isinstance(value, str):
        return [value]
    if not isinstance(value, list) or not all(isinstance(text, str) for text in value):
        raise BadParameter(f'{path}: {name} is not a list of texts; write {name} = ["…", "…"]')
    return value


def _resolve_path(path: Path, text: str) -> str:
    """Return a path of the study as seen from here."""
    return text if is_url(text) or Path(text).is_absolute() else str(path.parent / text)


def map_own_file(estimator: str, move: Callable[[str], str]) -> str:
    """Return FILE.py:NAME or NAME@FILE.toml with its file moved; any other estimator as it is."""
    place, colon, name = estimator.rpartition(":")
    if place.endswith(".py"):
        return f"{move(place)}{colon}{name}"
    known, at, settings = estimator.partition("@")
    return f"{known}@{move(settings)}" if at else estimator


def _format_value(value: Any) -> str:
    """Return a text, number, truth value or list of these as TOML."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_format_value, value))}]" if len(value) < 3 else _format_long_list(value)
    escaped = str(value).replace("\\", "\\\\").replace('"', '\\"')
    return '"' + "".join(f"\\u{ord(c):04x}" if ord(c) < 32 or ord(c) == 127 else c for c in escaped) + '"'


def _format_long_list(values: Sequence[Any]) -> str:
    return "[\n" + "".join(f"    {_format_value(value)},\n" for value in values) + "]"
