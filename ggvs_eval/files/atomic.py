"""Write files and folders atomically: under a temporary name next to the target, renamed when
complete.

A kill leaves the old file or the new one. What a killed process was filling stays next to the
target until `remove_leftovers` or, in a folder of many files, `sweep_files`.
"""

import errno
import fcntl
import glob
import os
import re
import shutil
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from secrets import token_hex

# .<name>.<host>.<pid>.tmp; of a file what libraries go by may follow.
TEMPORARY = re.compile(r"\..*\.(?P<host>[^.]+)\.(?P<pid>\d+)\.tmp(\.\w+)?")
# messages of numpy and HDF5 on a full disk, without its number
FULL = re.compile(r"\d+ requested and \d+ written|No space left")
KEPT_OF_NAME = 40  # signs, so that a temporary name is not too long where the name is not
SILENT_S = 3600.0  # after that without a new file, what another machine began is taken for given up


@contextmanager
def atomic_file(path: Path, ending: str = "") -> Iterator[Path]:
    """Give a path to write to, which takes the place of `path` when the block ends.

    After an error nothing is left of it.

    Args:
        path: the file to write; its folder is made.
        ending: of the temporary name, for libraries that go by it: ``.ply``.

    Yields:
        A name in the same folder that no other process uses.

    Raises:
        OSError: the file cannot be written. The error names it, where it would name no file or the
            temporary one.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    owner = f"{_host()}.{os.getpid()}"
    temporary = path.with_name(f".{path.name[:KEPT_OF_NAME]}.{token_hex(4)}.{owner}.tmp{ending}")
    try:
        with _named(path, temporary):
            yield temporary
            temporary.replace(path)
    finally:
        with suppress(OSError):  # it is in place, was never made, or its folder is gone
            temporary.unlink()


@contextmanager
def _named(path: Path, temporary: Path) -> Iterator[None]:
    """Let errors name what a user knows: a full disk names no file, others the temporary one."""
    try:
        yield
    except OSError as error:
        if error.errno is None and FULL.search(str(error)):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path)) from error
        if error.errno is None or error.filename not in (None, str(temporary), temporary):
            raise
        raise OSError(error.errno, error.strerror, str(path)) from error


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file whole or not at all."""
    with atomic_file(path) as temporary:
        temporary.write_bytes(content)


def write_text(path: Path, text: str) -> None:
    """Write a text file (UTF-8) whole or not at all."""
    with atomic_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def link_file(source: Path, target: Path) -> None:
    """Make a file known by another name too; a copy where the file system has no such thing."""
    try:
        os.link(source.resolve(), target)
    except OSError:
        shutil.copy2(source, target)


@contextmanager
def scratch_folder(beside: Path) -> Iterator[Path]:
    """Give an empty folder next to a path; it is removed when the block ends.

    Args:
        beside: path next to which the folder is made; part of its name.

    Yields:
        ``.<name>.<host>.<pid>.tmp``: others can see that this process works on it, and sweep it
        when the process is dead.
    """
    folder = beside.absolute().with_name(f".{beside.absolute().name}.{_host()}.{os.getpid()}.tmp")
    shutil.rmtree(folder, ignore_errors=True)
    try:
        with _named(beside, folder):
            folder.mkdir(parents=True)
            yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


@contextmanager
def atomic_folder(folder: Path) -> Iterator[Path]:
    """Give a folder to fill, which takes the place of `folder` when the block ends.

    After an error nothing is left of it.

    Args:
        folder: the folder to make: absent or empty when the block ends.

    Raises:
        OSError: `folder` holds something.
    """
    remove_leftovers(folder)
    with scratch_folder(folder) as temporary:
        yield temporary
        temporary.replace(folder)


@contextmanager
def absent_unless_made(folder: Path) -> Iterator[None]:
    """Remove a folder, and empty ones above it, absent before a block that fails.

    A stop by the user removes nothing.
    """
    absent = [place for place in (folder, *folder.parents) if not place.exists()]
    try:
        yield
    except Exception:
        if absent:
            shutil.rmtree(folder, ignore_errors=True)
            with suppress(OSError):
                for above in absent[1:]:
                    above.rmdir()
        raise


def is_in_hand(temporary: Path) -> bool:
    """Return whether the process that fills a scratch folder or a temporary file is still at work
    on it.

    Args:
        temporary: ``.<name>.<host>.<pid>.tmp``.
    """
    owner = TEMPORARY.fullmatch(temporary.name)
    if owner is None:
        return True  # of another program
    if owner["host"] == _host():
        return is_running(int(owner["pid"]))
    try:
        return time.time() - temporary.stat().st_mtime < SILENT_S
    except OSError:  # it has just been put in place
        return False


def scratch_folders(beside: Path) -> list[Path]:
    """List the existing folders that `scratch_folder` made next to a path, in use or not."""
    pattern = f".{glob.escape(beside.absolute().name)}.*.*.tmp"
    return [item for item in beside.absolute().parent.glob(pattern) if item.is_dir()]


def remove_leftovers(beside: Path) -> None:
    """Remove what killed processes left next to a path, except what a live process uses."""
    for leftover in scratch_folders(beside):
        if not is_in_hand(leftover):
            shutil.rmtree(leftover, ignore_errors=True)


def sweep_files(folder: Path) -> None:
    """Remove from a folder the temporary files of killed processes.

    Not those that another process is writing.
    """
    for item in folder.iterdir() if folder.is_dir() else ():
        if TEMPORARY.fullmatch(item.name) and not is_in_hand(item):
            with suppress(OSError):  # another sweeps too
                item.unlink()


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Keep others who lock the folder, on this machine or on those that share its disk, out of the
    block; it is made if need be.

    The one who had it may have put another folder in its place meanwhile: then that one is locked.
    """
    handle = -1
    while handle < 0:
        folder.mkdir(parents=True, exist_ok=True)
        handle = os.open(folder, os.O_RDONLY)
        with suppress(OSError):  # a file system without locks
            fcntl.flock(handle, fcntl.LOCK_EX)
        with suppress(OSError):
            if os.path.samestat(os.fstat(handle), folder.stat()):
                break
        os.close(handle)
        handle = -1
    try:
        yield
    finally:
        os.close(handle)


def is_running(pid: int) -> bool:
    """Return whether a process of this machine is running; an unreaped zombie is not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        pass
    if Path("/proc/self").exists():
        return False
    try:  # no /proc: another system
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        pass
    return True


def _host() -> str:
    return socket.gethostname().replace(".", "-")
