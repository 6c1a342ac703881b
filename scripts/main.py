"""The command ``stillpoint VERB``: finds the verb, runs it, and turns errors into one line and an exit code.

Exit codes: 0 done; 2 the user can put it right (one line on stderr); 1 a defect of stillpoint (traceback); 130 after
Ctrl-C and 143 after SIGTERM.
Verbs are imported when they are called, so that ``stillpoint --help`` loads neither numpy nor numba nor gtsam.
"""

import errno
import gc
import io
import os
import signal
import sys
import traceback
from collections.abc import Sequence
from typing import TYPE_CHECKING, NoReturn

from stillpoint.scripts.shared.signals import Unwinding

if TYPE_CHECKING:  # imported where Ctrl-C ends it quietly
    from cyclopts import App

# verb -> (function, what it does); the order is the order of the data and of the help page.
VERBS: dict[str, tuple[str, str]] = {
    "demo": ("demo:demo", "Simulate a phone in the hand and follow it the whole way to a report."),
    "fetch": ("fetch:fetch", "Fetch published datasets with optical truth, checked by SHA-256."),
    "import": ("import_:app", "Turn recordings of other formats into MCAP files."),
    "join": ("join:join", "Make one recording of the parts that import --split wrote."),
    "cut": ("cut:cut", "Write a part of a recording as a recording of its own."),
    "simulate": ("simulate:simulate", "Make recordings whose truth is known by construction."),
    "info": ("info:info", "Say what is in a file: streams, rates, gaps, rests, provenance."),
    "allan": ("allan:allan", "Noise density, bias instability and random walk of a sensor, from a long rest."),
    "doctor": ("doctor:doctor", "Test recordings by physics and say what to do."),
    "reference": ("reference:reference", "Make the reference trajectory of recordings."),
    "calibrate": ("calibrate:calibrate", "Find one calibration of a device from several of its recordings."),
    "estimate": ("estimate:estimate", "Run streaming estimators over recordings."),
    "stream": ("stream:stream", "Estimates while the samples come, or a recording live in Foxglove."),
    "score": ("score:score", "Score estimates against a reference or a truth."),
    "validate": ("validate:validate", "Score references against independent truth."),
    "leaderboard": ("leaderboard:leaderboard", "Rank many estimators over many recordings, with verdicts."),
    "tune": ("tune:tune", "Find the parameters with which an estimator errs least."),
    "experiment": ("experiment:app", "Repeat a paper's experiment beside its printed numbers."),
    "spin": ("spin:app", "Place accelerometers on a spinning body, and identify their noise."),
    "report": ("report:report", "Write one HTML page about a recording, its reference and its estimates."),
    "plot": ("plot:plot", "Draw one figure for a paper, of a recording or of a leaderboard."),
    "export": ("export:export", "Write CSV tables, the samples for stream, or TUM trajectories."),
    "export-c": ("export_c:export_c", "Write filters as C99 for microcontrollers."),
    "archive": ("archive:app", "Keep, find, verify and publish datasets."),
    "recover": ("recover:recover", "Save the readable part of a damaged MCAP file."),
    "view": ("view:view", "Look at recordings, references and estimates in rerun."),
    "bench": ("bench:bench", "Time a part of stillpoint beside its peers."),
}
_HELP, _VERSION = ["--help", "-h"], ["--version"]
# Flags of every verb: the traceback of an error, and inputs above the limits of datasets/files/limits.py.
_DEBUG, _LARGE = "--debug", "--large"
# New objects between two searches for cycles. Python's 700 makes 360 searches of the 140 000 objects that imports
# make, none of which ever goes: a tenth of the start.
GARBAGE_THRESHOLD = 50_000
_UNWRITABLE = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)  # of a full or broken standard output


def app() -> "App":
    """Return the command line, whose verbs are imported when called."""
    from importlib import metadata

    from cyclopts import App

    cli = App(
        name="stillpoint",
        help="Reference trajectories from recordings of a moving sensor, and scores of estimators against them.\n\n"
        "Every verb takes --debug (show the traceback of an error) and --large (read inputs above the size limits).",
        version=lambda: metadata.version("stillpoint"),
        version_flags=_VERSION,
        help_flags=_HELP,
        suppress_keyboard_interrupt=False,  # main ends the process
    )
    for place, (verb, (target, summary)) in enumerate(VERBS.items()):
        cli.command(f"stillpoint.scripts.verbs.{target}", name=verb, help=summary, sort_key=place)
    return cli


def main(argv: Sequence[str] | None = None) -> None:
    """Run the command line, as the console script does; never return normally."""
    tokens = list(sys.argv[1:] if argv is None else argv)
    debug = _DEBUG in tokens
    if _LARGE in tokens:
        from stillpoint.datasets.files import limits

        os.environ[limits.LARGE] = "1"
    tokens = [token for token in tokens if token not in (_DEBUG, _LARGE)]
    if argv is None:  # a user waits; see datasets/machine_code.py, which would import numba here
        os.environ["STILLPOINT_SAY_COMPILING"] = "1"
        gc.set_threshold(GARBAGE_THRESHOLD)
    unwinding = Unwinding((signal.SIGINT, signal.SIGTERM))  # half-written files and processes are cleaned up
    try:
        _run(tokens, debug)
    except (KeyboardInterrupt, Exception) as error:
        # The import of a compiled module that a signal interrupts raises ImportError instead.
        if not unwinding.told and not isinstance(error, KeyboardInterrupt):
            raise
        _flush_without_waiting()
        sys.exit(128 + (unwinding.told[0] if unwinding.told else signal.SIGINT))
    finally:
        unwinding.stop(kill=argv is None)  # nothing is half-written now


def _run(tokens: Sequence[str], debug: bool) -> NoReturn:
    from cyclopts import CycloptsError

    if sys.stdout is None:
        _stop("the standard output is closed, so that results would be lost; redirect it to a file or to /dev/null")
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # names of files need not be UTF-8
    if tokens and tokens[0] not in (*VERBS, *_HELP, *_VERSION):
        from stillpoint.datasets.errors import nearest

        _stop(f"no verb {tokens[0]!r}; {nearest(tokens[0], VERBS)}")
    try:
        code = app()(tokens, exit_on_error=False, print_error=False, result_action="return_value")
        sys.stdout.flush()
    except CycloptsError as error:
        _stop(f"{' '.join(str(error).split())} See: stillpoint {tokens[0]} --help")
    except (BrokenPipeError, SystemExit) as end:
        broken = end if isinstance(end, BrokenPipeError) else end.__context__  # rich makes an exit of it
        if not isinstance(broken, BrokenPipeError):
            raise
        _discard_output()
        sys.exit(0)
    except Exception as error:
        from stillpoint.datasets.errors import StillpointError

        if isinstance(error, OSError) and error.filename is None and error.errno in _UNWRITABLE:
            _discard_output()
            _stop(f"the standard output cannot be written ({error.strerror}); what belongs there is lost: give it room")
        if isinstance(error, StillpointError):
            if debug:
                traceback.print_exc()
            _stop(str(error))
        raise
    sys.exit(code if isinstance(code, int) else 0)


def _flush_without_waiting() -> None:
    """Write what the standard output takes at once: the flush at exit would wait for a reader that does not read."""
    try:
        handle = sys.stdout.fileno()
        os.set_blocking(handle, False)
        try:
            sys.stdout.flush()
        except BlockingIOError:
            _discard_output()
        os.set_blocking(handle, True)
    except (OSError, ValueError):  # no file, or closed
        return


def _discard_output() -> None:
    """Leave nothing to be flushed at exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _stop(message: str) -> NoReturn:
    from stillpoint.scripts.shared.output import print_line

    print_line(f"stillpoint: {message}", file=sys.stderr)
    sys.exit(2)
