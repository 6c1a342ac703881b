"""``stillpoint view``: look at recordings, references and estimates in rerun."""

import importlib.util
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from stillpoint.datasets import read
from stillpoint.datasets.errors import BadParameter
from stillpoint.scripts.shared.companions import get_recording_name, list_neighbours, select_files
from stillpoint.scripts.shared.flags import Inputs
from stillpoint.scripts.shared.inputs import find_mcap_files, get_kind
from stillpoint.scripts.shared.output import print_line

_NEEDED = "0.41.0"  # rerun's files and columns change between versions


def view(
    paths: Inputs,
    /,
    *,
    save: Annotated[Path | None, Parameter(negative=())] = None,
    alone: Annotated[bool, Parameter(negative=())] = False,
) -> None:
    """Look at recordings, references and estimates in rerun: attitudes, spins, measurements, covariance, bias, rests.

    Opens a window, or writes a file that rerun opens. Needs the extra "view": pip install 'stillpoint[view]'.

    Parameters
    ----------
    paths
        MCAP files, folders or globs. With a recording come the references and estimates beside it.
    save
        Write to this file, NAME.rrd, instead of opening a window.
    alone
        Show the named files only.
    """
    if importlib.util.find_spec("rerun") is None:
        raise BadParameter(f"view: rerun-sdk is not installed; install it: pip install rerun-sdk=={_NEEDED}")
    from stillpoint.scripts.shared.rerun_scene import finish_scene, open_scene, show_thing

    if save is not None and not save.absolute().parent.is_dir():
        raise BadParameter(f"--save {save}: the folder does not exist; make it or name another")
    files = find_mcap_files(paths)
    if not alone:
        files = _add_companions(files)
    things = [read(file) for file in files]  # all of them before a file or a window is there
    scene = open_scene(save, things)
    for file, thing in zip(files, things, strict=True):
        show_thing(scene, file.name.removesuffix(".mcap"), thing)
    finish_scene(scene)
    if save is not None:
        print_line(f"{save}: {len(files)} files; open it with: rerun {save}")


def _add_companions(files: list[Path]) -> list[Path]:
    """Return the files, each recording followed by the references and estimates beside it."""
    found: dict[Path, None] = {}
    for file in files:
        found[file.absolute()] = None
        if get_kind(file) == "recording":
            around = list_neighbours(file)
            for kind in ("reference", "estimate"):
                found |= dict.fromkeys(select_files(get_recording_name(file), kind, around))
    return list(found)
