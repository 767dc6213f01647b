"""A process of its own that reads files of strangers by libraries that may crash, hang, or disturb whoever loads them."""

import atexit
import json
import os
import select
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

IDLE_S = 10.0  # after which the process gives back its memory
LONGEST_LOG = 1 << 20  # bytes of what a library writes about one file


class ReaderError(Exception):
    """The file was refused, or the process did not survive it; the text is the reason, one line."""


class ReaderProcess:
    """Has files read by a script in a process that starts with the first request and is kept for the next ones.

    To start Python and load such a library takes half a second, to read a file milliseconds. The process ends when nothing is
    asked for a while, when this one ends, and when a request takes too long; the next request starts another.

    Args:
        script: run by its file, so that it imports no more than it needs; it calls `serve`.
    """

    def __init__(self, script: Path) -> None:
        self._script = script
        self._lock = threading.Lock()
        self._log: IO[bytes] | None = None
        self._child: subprocess.Popen[str] | None = None
        self._parent_pid = 0
        atexit.register(self.end)

    def ask(self, path: Path, timeout_s: float) -> Any:
        """Return what the script makes of a file or folder; it comes as JSON.

        Raises:
            ReaderError: the script refused it, or the process ended.
            TimeoutError: it took longer than ``timeout_s``.
        """
        with self._lock:
            try:
                line = self._answer(path, timeout_s) or self._answer(path, timeout_s)  # an idle process may just have ended
            except BaseException:  # after Ctrl-C, too, the late answer would be taken for that of the next request
                self.end()
                raise
        if not line:
            raise ReaderError("the reader ended twice without an answer")
        answer = json.loads(line)
        if "refusal" in answer:
            raise ReaderError(answer["refusal"])
        return answer["value"]

    def end(self) -> None:
        """End the process, if any."""
        child, self._child = self._child, None
        if child is not None and self._parent_pid == os.getpid():
            child.kill()
            child.communicate()
        if self._log is not None:
            self._log.close()

    def _answer(self, path: Path, timeout_s: float) -> str:
        """Return the line that answers a request; an empty one if the process had ended, or did so without being at fault."""
        child = self._started()
        assert child.stdin is not None
        assert child.stdout is not None
        assert self._log is not None
        log_start = os.fstat(self._log.fileno()).st_size
        try:
            child.stdin.write(json.dumps(str(path)) + "\n")
            child.stdin.flush()
        except BrokenPipeError:
            self.end()
            return ""
        if not select.select([child.stdout], [], [], timeout_s)[0]:
            raise TimeoutError(f"{path}: took over {timeout_s:g} s")
        line = child.stdout.readline()
        if not line and child.wait() != 0:
            log = os.pread(self._log.fileno(), LONGEST_LOG, log_start).decode("utf-8", "replace").strip()
            raise ReaderError(log.splitlines()[-1] if log else f"the reader ended with {child.returncode}")
        return line

    def _started(self) -> "subprocess.Popen[str]":
        """Return the process; a new one where there is none, it has ended, or it is of the process that this was forked from."""
        if self._child is None or self._parent_pid != os.getpid() or self._child.poll() is not None:
            self.end()
            self._log = tempfile.TemporaryFile()  # noqa: SIM115, closed by `end`
            self._child = subprocess.Popen(
                [sys.executable, "-P", str(self._script)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._log,
                encoding="utf-8",
            )
            self._parent_pid = os.getpid()
        return self._child


def serve(read: Callable[[Path], Any]) -> None:
    """Answer the requests of a `ReaderProcess` until there are none: what the script of such a process calls.

    Args:
        read: makes a value that JSON can hold of a path; what it raises is reported as a refusal.
    """
    with os.fdopen(os.dup(sys.stdout.fileno()), "w", encoding="utf-8") as answers:
        with open(os.devnull, "wb") as nowhere:
            os.dup2(nowhere.fileno(), sys.stdout.fileno())  # what a library prints is neither an answer nor an error
        while select.select([sys.stdin], [], [], IDLE_S)[0] and (line := sys.stdin.readline()):
            try:
                answer = {"value": read(Path(json.loads(line)))}
            except Exception as error:
                answer = {"refusal": _reason(error)}
            answers.write(json.dumps(answer) + "\n")
            answers.flush()


def _reason(error: Exception) -> str:
    text = (str(error).strip().splitlines() or [""])[-1]
    return text if isinstance(error, ValueError) else f"{type(error).__name__}: {text}"
