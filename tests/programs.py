"""The project's programs, run without the seconds that their imports take: by a process that a
server forks, with everything imported, and that ends as any other.

    python tests/programs.py

is that server. Rendering chooses its OpenGL when it is imported, so pictures are drawn by processes
of their own.
"""

import atexit
import gc
import json
import os
import runpy
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any


class Server:
    """Forks a process for each request. script : of which the server is made; it forks in `serve`,
    and goes on with what is asked."""

    def __init__(self, script: str = __file__, **environment: str) -> None:
        self._server = subprocess.Popen([sys.executable, script], text=True, bufsize=1,
                                        stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                                        env=os.environ | environment)  # fmt: skip

    def begin(self, asked: Mapping[str, Any]) -> int:
        """Start what is asked; its process."""
        assert self._server.stdin is not None
        self._server.stdin.write(json.dumps(asked) + "\n")
        return self.end()

    def end(self) -> int:
        """The exit code of what was begun, once it has ended."""
        assert self._server.stdout is not None
        return int(self._server.stdout.readline())

    def close(self) -> None:
        """Let the server end."""
        self._server.communicate()


def serve() -> dict[str, Any]:
    """In the server: fork for each request. In the forked process: return the request."""
    requests, replies = os.fdopen(os.dup(0)), os.fdopen(os.dup(1), "w")
    gc.freeze()  # else each process, when it ends, goes through all that was imported: a second
    for line in requests:
        process = os.fork()
        if process == 0:
            requests.close()
            replies.close()
            return dict(json.loads(line))
        print(process, file=replies, flush=True)
        print(os.waitstatus_to_exitcode(os.waitpid(process, 0)[1]), file=replies, flush=True)
    sys.exit()


def lead(number: int, where: str) -> None:
    """Let a file's number lead to a path, to a closed pipe, or nowhere."""
    if where == "closed":
        os.close(number)
        return
    if where == "closed pipe":
        reader, opened = os.pipe()
        os.close(reader)
    else:
        opened = os.open(where, os.O_RDWR | os.O_CREAT, 0o666)
    os.dup2(opened, number)
    os.close(opened)


def ran(
    script: Path, *arguments: str, cwd: Path, **environment: str
) -> subprocess.CompletedProcess[str]:
    """How `python script arguments` ends in a directory, with these environment variables."""
    with tempfile.TemporaryDirectory() as said:
        out, err = (Path(said) / name for name in ("out", "err"))
        asked = {"cwd": str(cwd), "argv": [str(script), *arguments], "environment": environment,
                 "out": str(out), "err": str(err)}  # fmt: skip
        server = _server()
        server.begin(asked)
        code = server.end()
        return subprocess.CompletedProcess(asked["argv"], code, out.read_text(), err.read_text())


@cache
def _server() -> Server:
    server = Server(MUJOCO_GL="disable")
    atexit.register(server.close)
    return server


def _become(cwd: str, argv: list[str], environment: dict[str, str], out: str, err: str) -> None:
    """Make this process that of a program which is about to begin."""
    os.setsid()
    os.chdir(cwd)
    for number, where in enumerate(("/dev/null", out, err)):
        lead(number, where)
    sys.stdout = open(1, "w", closefd=False)  # noqa: SIM115
    sys.stderr = open(2, "w", closefd=False, buffering=1)  # noqa: SIM115
    os.environ.update(environment)
    added = environment.get("PYTHONPATH", "").split(os.pathsep)
    sys.path[0:1] = [str(Path(argv[0]).parent), *filter(None, added)]
    sys.argv = argv


if __name__ == "__main__":
    import conftest  # noqa: F401 - all of the project's programs
    from helpers import default_config

    default_config()  # what Hydra makes once, its plugins and its grammar, is made here
    wanted = serve()
    _become(**wanted)
    runpy.run_path(wanted["argv"][0], run_name="__main__")
