"""What every verb writes for machines: ``--json FILE``, ``-`` for the standard output."""

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from stillpoint.datasets.errors import BadParameter

STDOUT = "-"
# A lone hyphen would be read as an option otherwise.
JsonFile = Annotated[str | None, Parameter(name="--json", allow_leading_hyphen=True)]


def write_json(target: str | None, rows: Sequence[Mapping[str, Any]]) -> None:
    """``{"rows": [...]}`` to a file or to the standard output; nothing when ``target`` is None.

    A number that is not finite becomes null. Raises :class:`BadParameter` when the file cannot be written.
    """
    if target is None:
        return
    text = json.dumps({"rows": _plain(rows)}, indent=2, ensure_ascii=False, allow_nan=False)
    if target == STDOUT:
        print(text)
        return
    try:
        Path(target).write_text(text + "\n", encoding="utf-8")
    except OSError as error:
        raise BadParameter(f"--json {target}: cannot be written ({error.strerror}); name another file") from None


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
