"""Figures for papers: PDF, SVG or PNG at the width of a column, with type that stays readable there."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.files.atomic import write_atomically

COLUMN_IN = 3.5  # width of a column of a two-column page
_FORMATS = (".pdf", ".svg", ".png")
_STYLE: dict[Any, Any] = {
    "font.size": 8,
    "axes.titlesize": 8,
    "axes.labelsize": 8,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "legend.fontsize": 7,
    "legend.frameon": False,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "0.88",
    "grid.linewidth": 0.5,
    "axes.linewidth": 0.6,
    "lines.linewidth": 0.9,
    "pdf.fonttype": 42,  # text stays text, in a font that journals accept
    "svg.fonttype": "none",
    "svg.hashsalt": "stillpoint",
    "savefig.dpi": 300,
    "text.usetex": False,
}


def write_figure(
    file: Path,
    rows: int,
    row_in: float,
    draw: Callable[[Sequence[Axes]], None],
    width_in: float = COLUMN_IN,
    time_axis: bool = False,
) -> None:
    """Draw ``rows`` axes under each other and write them; the ending of the file chooses the format.

    ``draw`` gets the axes from top to bottom. The same drawing gives the same bytes. Raises :class:`BadParameter` for
    another ending and for a file that cannot be written.
    """
    if file.suffix not in _FORMATS:
        raise BadParameter(f"-o {file}: ends in none of {', '.join(_FORMATS)}")
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(width_in, rows * row_in + 0.45), layout="constrained")
        axes = list(figure.subplots(rows, 1, sharex=time_axis, squeeze=False)[:, 0])
        draw(axes)
        if time_axis:
            axes[-1].set_xlabel("time (s)")
        handles, labels = axes[0].get_legend_handles_labels()
        if len(labels) > 1:
            figure.legend(handles, labels, loc="outside upper left", ncols=min(len(labels), 4), handlelength=1.2)
        dates = {".pdf": {"CreationDate": None}, ".svg": {"Date": None}, ".png": {}}
        save_figure(figure, file, metadata=dates[file.suffix])


def save_figure(figure: Figure, file: Path, **options: Any) -> None:
    """Draw a figure into a file, of the format that its name ends in: the whole file or none of it.

    ``options`` go to matplotlib. Raises :class:`BadParameter` when the file cannot be written.
    """
    try:
        with write_atomically(file) as target:
            figure.savefig(target, format=file.suffix.removeprefix("."), **options)
    except OSError as error:
        raise BadParameter(f"{file}: cannot be written ({error.strerror}); name another place") from None
