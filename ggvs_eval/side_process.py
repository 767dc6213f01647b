"""A process of its own for code that may crash, hang, write wherever it likes, or disturb whoever
loads it.

Libraries that read files of strangers run in one, and metrics of plug-ins.
"""

import atexit
import os
import pickle
import select
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Sized
from pathlib import Path
from typing import IO, Any

IDLE_S = 10.0  # after which the process gives back its memory
LONGEST_LOG = 1 << 20  # bytes of what a library writes about one file


class SideProcessError(Exception):
    """A request was refused, or the process did not survive it.

    The text is the reason, one line.
    """


class SideProcess:
    """Has requests answered by a script in a process that starts with the first one and is kept for
    the next ones.

    To start Python and load a library takes half a second, to read a file milliseconds. The process
    ends when nothing is asked for a while, when this one ends, and when a request takes too long;
    the next request starts another.

    Args:
        script: run by its file, so that it imports no more than it needs; it calls `serve`.
        quiet: what the process prints is not shown; the last line of its errors is the reason why
            it ended.
    """

    def __init__(self, script: Path, quiet: bool = True) -> None:
        self._script = script
        self._quiet = quiet
        self._lock = threading.Lock()
        self._log: IO[bytes] | None = None
        self._child: subprocess.Popen[bytes] | None = None
        self._parent_pid = 0
        atexit.register(self.end)

    def ask(self, request: Any, timeout_s: float | None = None) -> Any:
        """Return what the script makes of a copy of a request, such as the path of a file.

        Raises:
            SideProcessError: the script refused it, or the process ended.
            TimeoutError: it took longer than ``timeout_s``.
        """
        with self._lock:
            try:
                # an idle one may just have ended
                answer = self._answer(request, timeout_s) or self._answer(request, timeout_s)
            # after Ctrl-C, too, the late answer would be taken for that of the next request
            except BaseException:
                self.end()
                raise
        if not answer:
            raise SideProcessError("its process ended twice without an answer")
        refusal, value = answer
        if refusal:
            raise SideProcessError(refusal)
        return value

    def end(self) -> None:
        """End the process, if any."""
        child, self._child = self._child, None
        if child is not None and self._parent_pid == os.getpid():
            child.kill()
            child.communicate()
        if self._log is not None:
            self._log.close()

    def _answer(self, request: Any, timeout_s: float | None) -> tuple[str, Any] | None:
        """Return a refusal or the answer.

        None if the process had ended, or did so without being at fault.
        """
        child = self._started()
        assert child.stdin is not None
        assert child.stdout is not None
        log_start = os.fstat(self._log.fileno()).st_size if self._log else 0
        try:
            pickle.dump(request, child.stdin, pickle.HIGHEST_PROTOCOL)
            child.stdin.flush()
        except BrokenPipeError:
            self.end()
            return None
        if not select.select([child.stdout], [], [], timeout_s)[0]:
            named = f"{request}: " if isinstance(request, Path) else ""
            raise TimeoutError(f"{named}took over {timeout_s:g} s")
        try:
            answer: tuple[str, Any] = pickle.load(child.stdout)
        except EOFError:
            if (status := child.wait()) == 0:
                return None
            log = (
                os.pread(self._log.fileno(), LONGEST_LOG, log_start)
                .decode("utf-8", "replace")
                .strip()
                if self._log
                else ""
            )
            ending = f"signal {-status}" if status < 0 else f"status {status}"
            raise SideProcessError(
                log.splitlines()[-1] if log else f"its process ended with {ending}"
            ) from None
        return answer

    def _started(self) -> "subprocess.Popen[bytes]":
        """Return the process; a new one where there is none, it has ended, or it is of the process
        that this was forked from.
        """
        if self._child is None or self._parent_pid != os.getpid() or self._child.poll() is not None:
            self.end()
            self._log = tempfile.TemporaryFile() if self._quiet else None  # noqa: SIM115, closed by `end`
            self._child = subprocess.Popen(
                [sys.executable, "-uP", str(self._script)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._log,
                start_new_session=True,  # Ctrl-C is for the process that asks
            )
            self._parent_pid = os.getpid()
        return self._child


def serve(read: Callable[[Any], Any], unfinished: Sized = (), prints: bool = False) -> None:
    """Answer the requests of a `SideProcess` until there are none: what the script of such a
    process calls.

    Args:
        read: answers a request; what it raises is reported as a refusal.
        unfinished: while it holds something more requests are waited for.
        prints: show what libraries print, among the errors.
    """
    requests, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    nowhere, process = os.open(os.devnull, os.O_RDWR), os.getpid()
    os.dup2(nowhere, 0)
    os.dup2(2 if prints else nowhere, 1)  # what a library prints is neither an answer nor an error
    while select.select([requests], [], [], None if unfinished else IDLE_S)[0]:
        try:
            request = pickle.load(requests)
        except EOFError:
            return
        try:
            answer = "", read(request)
        except Exception as error:
            answer = _reason(error), None
        # a copy that the request has made of this process; its answer would be the next one's
        if os.getpid() != process:
            os._exit(0)
        try:
            pickle.dump(answer, answers, pickle.HIGHEST_PROTOCOL)
            answers.flush()
        except BrokenPipeError:  # nobody waits any more
            os._exit(1)


def _reason(error: Exception) -> str:
    text = (str(error).strip().splitlines() or [""])[-1]
    return text if isinstance(error, ValueError) else f"{type(error).__name__}: {text}"
