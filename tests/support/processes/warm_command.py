"""The command `stillpoint` for shell scripts in tests, without its imports: each call is a fork of one warm process.

Importing what a verb needs takes about 1.5 s of CPU, which scripts of many commands would pay for each of them, and for
each process of a batch: batches work in the process of the command where they are not told otherwise. How the installed
command starts is tested in ``tests/scripts/test_command.py``, processes of batches in ``tests/scripts/test_jobs.py``.
"""

import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

# Sends its words, folder, environment and open files, and ends with the code that comes back.
_CLIENT = """#!{python} -IS
import json, os, socket, sys
server = socket.socket(socket.AF_UNIX)
server.connect({address!r})
order = json.dumps({{"words": sys.argv[1:], "folder": os.getcwd(), "environment": dict(os.environ)}}).encode()
socket.send_fds(server, [len(order).to_bytes(8, "big")], [0, 1, 2])
server.sendall(order)
sys.exit(int(server.recv(16) or 70))
"""


@contextmanager
def warm_command(folder: Path) -> Iterator[Path]:
    """Write an executable ``stillpoint`` into a folder; it works until the context ends."""
    folder.mkdir(exist_ok=True)
    with (
        tempfile.TemporaryDirectory() as short,  # the address of a socket has about a hundred characters
        subprocess.Popen([sys.executable, __file__, f"{short}/socket"], stdout=subprocess.PIPE) as server,
    ):
        try:
            assert server.stdout is not None
            assert server.stdout.readline() == b"ready\n"
            command = folder / "stillpoint"
            command.write_text(_CLIENT.format(python=sys.executable, address=f"{short}/socket"), encoding="utf-8")
            command.chmod(0o755)
            yield command
        finally:
            server.kill()


def _serve(address: str) -> None:
    """Import what the verbs use, then run each command that comes in a child."""
    import stillpoint.scoring
    import stillpoint.smoother
    import stillpoint.studies.leaderboard  # noqa: F401
    from stillpoint.scripts.main import main
    from stillpoint.scripts.shared import jobs

    jobs.HERE_UP_TO = 100
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # children leave nothing to wait for
    listener = socket.socket(socket.AF_UNIX)
    listener.bind(address)
    listener.listen()
    print("ready", flush=True)
    while True:
        connection, _ = listener.accept()
        if os.fork() == 0:
            listener.close()
            _run(connection, main)
        connection.close()


def _run(connection: socket.socket, main: Any) -> None:
    """Run one command with the files of the client, and end this process."""
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    code = 1
    try:
        head, files, _, _ = socket.recv_fds(connection, 8, 3)
        order = b""
        while len(order) < int.from_bytes(head, "big"):
            order += connection.recv(65536)
        given = json.loads(order)
        for place, file in enumerate(files):
            os.dup2(file, place)
            os.close(file)
        os.chdir(given["folder"])
        os.environ.clear()
        os.environ.update(given["environment"])
        main(given["words"])
        code = 0
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 0 if end.code is None else 1
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        connection.sendall(str(code).encode())
        os._exit(code)


if __name__ == "__main__":
    _serve(sys.argv[1])
