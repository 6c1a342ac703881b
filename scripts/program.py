"""How a module that is run by ``python -m`` reads its arguments: as the verbs do, with errors in one line."""

import re
import sys
from collections.abc import Callable, Sequence
from typing import NoReturn

from cyclopts import App, CycloptsError

from stillpoint.datasets.errors import StillpointError
from stillpoint.scripts.shared.output import print_line

_ROLE = re.compile(r":\w+:`~?([^`]+)`")  # of Sphinx, in a docstring


def run_program(function: Callable[..., int | None], tokens: Sequence[str] | None = None) -> NoReturn:
    """Run the main function of a module as a program, by default with the arguments of this process.

    Its parameters are the arguments, and the docstring of the module is the text of ``--help``. Exit codes are those of
    ``stillpoint``: 2 with one line for wrong arguments, for files that cannot be read and for other errors of the user.
    """
    module = sys.modules[function.__module__]
    name = module.__name__ if module.__spec__ is None else module.__spec__.name
    text = _ROLE.sub(r"``\1``", module.__doc__ or "")
    cli = App(name=f"python -m {name}", help=text, version_flags=[], help_flags=["--help", "-h"])
    cli.default(function)
    try:
        code = cli(tokens, exit_on_error=False, print_error=False, result_action="return_value")
    except CycloptsError as error:
        _stop(f"{' '.join(str(error).split())} See: python -m {name} --help")
    except StillpointError as error:
        _stop(str(error))
    except OSError as error:
        if error.filename is None:
            raise
        _stop(f"{error.filename}: cannot be opened ({error.strerror}); check the name")
    sys.exit(code or 0)


def _stop(message: str) -> NoReturn:
    """Print an error in one line, and end with exit code 2."""
    print_line(f"stillpoint: {message}", file=sys.stderr)
    sys.exit(2)
