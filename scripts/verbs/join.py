"""``stillpoint join``: the parts of a recording as one again."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from stillpoint.datasets.mcap.parts import read_parts
from stillpoint.datasets.mcap.store import write
from stillpoint.scripts.shared import inputs
from stillpoint.scripts.shared.flags import Inputs
from stillpoint.scripts.shared.output import print_line


def join(paths: Inputs, /, *, out: Annotated[Path, Parameter(name=["--out", "-o"])]) -> None:
    """Write the parts that import --split made as the one recording that they come from, bit for bit.

    Parameters
    ----------
    paths
        All parts: MCAP files, folders or globs.
    out
        Folder to write NAME.mcap into; made when it is not there.
    """
    files = inputs.find_recordings(paths)
    joined = read_parts(files)
    target = inputs.make_output_dir(out) / f"{joined.name}.mcap"
    write(target, joined)
    print_line(f"{target}: {joined.duration_s:.3f} s from {len(files)} parts")
