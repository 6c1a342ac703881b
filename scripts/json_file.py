"""The option ``--json`` of every verb: the facts of its table, for machines."""

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter
from stillpoint.datasets.errors import BadParameter

STDOUT = "-"
# A lone hyphen would be read as an option otherwise.
JsonFile = Annotated[str | None, Parameter(name="--json", allow_leading_hyphen=True)]


def write_json(target: str | None, rows: Sequence[dict[str, Any]]) -> None:
    """Write ``{"rows": [...]}`` to the file ``target``, to standard output for ``-``, nowhere for None.

    Raises :class:`BadParameter` when the file cannot be written.
    """
    if target is None:
        return
    text = json.dumps({"rows": list(rows)}, indent=2, allow_nan=False) + "\n"
    if target == STDOUT:
        sys.stdout.write(text)
        return
    try:
        Path(target).write_text(text, encoding="utf-8")
    except OSError as error:
        raise BadParameter(
            f"--json {target}: cannot be written ({error.strerror}); name a file you may write"
        ) from None
