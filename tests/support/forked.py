"""The command line in processes that are forked from one which has imported the libraries, and so start at once.

`command_line` is a program that is used as the installed `xfreqbench`. The package itself is imported anew by every
command, under no import hook; the process has the folder, the environment and the streams that its caller gives it.
Only the numbers of threads are those of the server, one, and a SIGKILL reaches the command a moment later: wait for
the end of its output.
"""

from __future__ import annotations

import atexit
import gc
import importlib
import json
import os
import select
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import traceback
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import NoReturn

LIBRARIES = (  # none that starts threads when it is imported, as Dr.Jit does
    *("cyclopts", "filelock", "h5py", "jinja2", "matplotlib.figure", "numba", "numpy", "PIL.Image", "pydantic"),
    *("rich.console", "rich.progress", "rich.table", "safetensors.torch", "scipy.ndimage", "scipy.optimize"),
    *("scipy.spatial", "scipy.special", "skimage.metrics", "torch", "trimesh", "yaml"),
)
ONE_THREAD = dict.fromkeys(["OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"], "1")
CLIENT = """#!{python} -IS
import json, os, signal, socket, sys
server = socket.socket(socket.AF_UNIX)
server.connect({address!r})
for number in (signal.SIGINT, signal.SIGTERM):
    signal.signal(number, lambda number, _: server.sendall(bytes([number])))
socket.send_fds(server, [b"."], [0, 1, 2])
asked = {{"words": sys.argv, "folder": os.getcwd(), "environment": dict(os.environ)}}
server.sendall(json.dumps(asked).encode() + b"\\n")
code = int(server.makefile().readline())
if code < 0:
    signal.signal(-code, signal.SIG_DFL)
    os.kill(os.getpid(), -code)
os._exit(code)
"""


@cache
def command_line() -> str:
    """Path of the program; its server ends with this process."""
    folder = Path(tempfile.mkdtemp(prefix="xfreqbench-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    address = str(folder / "server")
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"} | ONE_THREAD
    server = subprocess.Popen(
        [sys.executable, "-P", __file__, address],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env=environment,
        start_new_session=True,  # Ctrl-C is for the commands
    )
    assert server.stdout
    assert server.stdin
    assert server.stdout.readline() == b"ready\n"
    server.stdout.close()
    atexit.register(_end, server)
    program = folder / "xfreqbench"
    program.write_text(CLIENT.format(python=sys.executable, address=address))
    program.chmod(0o755)
    return str(program)


def _end(server: subprocess.Popen[bytes]) -> None:
    assert server.stdin
    server.stdin.close()
    server.wait(timeout=30)


def serve(address: str) -> None:
    """Fork for everyone who connects, until standard input ends; returns in each process that is to be a command."""
    for library in LIBRARIES:
        importlib.import_module(library)
    listener = socket.socket(socket.AF_UNIX)
    listener.bind(address)
    listener.listen()
    gc.freeze()
    os.write(1, b"ready\n")
    while 0 not in select.select([0, listener], [], [])[0]:
        connection, _ = listener.accept()
        if os.fork() == 0:
            listener.close()
            _keep(connection)
            return
        connection.close()
        with suppress(ChildProcessError):  # no keeper is left
            while os.waitpid(-1, os.WNOHANG)[0]:
                pass
    os._exit(0)


def _keep(connection: socket.socket) -> None:
    """Start what was asked for, pass signals on to it, and tell its exit code; returns in its process alone."""
    _, streams, _, _ = socket.recv_fds(connection, 1, 3)
    asked = json.loads(connection.makefile().readline())
    ended, alive = os.pipe()  # the write end is open while the command runs
    process = os.fork()
    if process == 0:
        connection.close()
        os.close(ended)
        return _become(asked["words"], asked["folder"], asked["environment"], streams)
    for descriptor in (*streams, alive):
        os.close(descriptor)
    while ended not in select.select([ended, connection], [], [])[0]:
        sent = connection.recv(1)
        os.kill(process, sent[0] if sent else signal.SIGKILL)
        if not sent:
            break
    code = os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])
    with suppress(BrokenPipeError):  # whoever asked was killed
        connection.sendall(b"%d\n" % code)
    os._exit(0)


def _become(words: list[str], folder: str, environment: dict[str, str], streams: list[int]) -> None:
    for number, descriptor in enumerate(streams):
        os.dup2(descriptor, number)
        os.close(descriptor)
    os.chdir(folder)
    os.environ.clear()
    # Numba reads its number of threads again when it compiles, and fails where it is no longer the server's
    os.environ.update({"NUMBA_NUM_THREADS": ONE_THREAD["NUMBA_NUM_THREADS"]} | environment)
    sys.argv = words
    sys.path[:0] = filter(None, environment.get("PYTHONPATH", "").split(os.pathsep))
    sys.stdin, sys.stdout = os.fdopen(0), os.fdopen(1, "w")
    sys.stderr = os.fdopen(2, "w", buffering=1, errors="backslashreplace")
    sys.__stdin__, sys.__stdout__, sys.__stderr__ = sys.stdin, sys.stdout, sys.stderr


def _run() -> NoReturn:
    """Run the command line, and end as an interpreter does that need not take every library apart."""
    from xfreqbench.cli.main import main

    code = 0
    try:
        main()
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else int(end.code is not None)
    except BaseException:
        traceback.print_exc()
        code = 1
    threading._shutdown()  # type: ignore[attr-defined]
    atexit._run_exitfuncs()
    sys.stdout.flush()
    os._exit(code)


if __name__ == "__main__":
    serve(sys.argv[1])
    _run()
