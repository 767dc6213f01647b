"""Archives that others packed, unpacked as if their author were an enemy: only plain files, inside
the folder, within limits.

What the archive's own headers claim is checked before a byte is written, what really comes out is
counted while it is written.
"""

import gzip
import re
import shutil
import stat
import tarfile
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import IO, cast

from ggvs_eval.errors import GgvsError
from ggvs_eval.files.listing import is_junk

SUFFIXES = (".zip", ".tar.gz", ".tgz", ".tar")
CHUNK_BYTES = 1 << 20
# A tar header may announce a name of any length, which is read at once.
LARGEST_READ = 16 << 20
ERRORS = (
    zipfile.BadZipFile,
    tarfile.TarError,
    zlib.error,
    OSError,
    EOFError,
    NotImplementedError,
    RuntimeError,
    ValueError,
)
SAFE_CODINGS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
UNSAFE_PATH = re.compile(r"[\x00-\x1f\x7f]|^[A-Za-z]:")


@dataclass(frozen=True)
class Limits:
    """Upper limits on the contents of an archive."""

    n_files: int
    n_bytes: int


@dataclass(frozen=True)
class _Member:
    """One entry: its path, in which the backslashes of Windows are separators, and its content
    where it is a file.
    """

    path: PurePosixPath
    n_bytes: int
    content: IO[bytes] | None


class _RefusedError(Exception):
    """An archive holds something that is not unpacked."""


def is_archive(path: Path) -> bool:
    """Return whether a file's name is that of a supported archive."""
    return path.is_file() and path.name.lower().endswith(SUFFIXES)


def unpack(path: Path, folder: Path, limits: Limits, error: type[GgvsError]) -> Path:
    """Unpack an archive into a folder.

    Args:
        path: ``.zip``, ``.tar``, ``.tar.gz``.
        folder: absent or empty.
        error: raised for what cannot be unpacked.

    Returns:
        The folder, or the only folder in it if there is nothing else.

    Raises:
        GgvsError: of class `error`: a damaged archive, an absolute path, one with ``..``, a link, a
            device, a name twice, more files or bytes than allowed, or more than the disk has room
            for.
    """
    folder.mkdir(parents=True, exist_ok=True)
    limits = Limits(limits.n_files, min(limits.n_bytes, shutil.disk_usage(folder).free))
    try:
        with _opened(path, limits) as members:
            _write(members, folder, limits)
    except _RefusedError as refused:
        raise error(f"{path}: {refused}") from refused
    except ERRORS as damage:
        reason = " ".join(str(damage).split())[:200] or type(damage).__name__
        raise error(f"{path}: cannot be unpacked ({reason}); pack it again") from damage
    inside = list(folder.iterdir())
    return inside[0] if len(inside) == 1 and inside[0].is_dir() else folder


def _write(members: Iterator[_Member], folder: Path, limits: Limits) -> None:
    """Write the files one by one, each under a name that nothing bears yet."""
    n_files = n_bytes = 0
    for member in members:
        target = folder / _safe(member.path)
        if any(map(is_junk, member.path.parts)):
            continue
        n_files += 1
        if n_files > limits.n_files or n_bytes + member.n_bytes > limits.n_bytes:
            raise _too_much(limits)
        if member.content is None:
            target.mkdir(parents=True, exist_ok=True)
            continue
        target.parent.mkdir(parents=True, exist_ok=True)
        if target.exists():
            raise _RefusedError(f"holds {str(member.path)!r} twice; pack it again")
        with target.open("xb") as file:
            while chunk := member.content.read(CHUNK_BYTES):
                n_bytes += len(chunk)
                if n_bytes > limits.n_bytes:
                    raise _too_much(limits)
                file.write(chunk)


def _safe(member: PurePosixPath) -> PurePosixPath:
    """Return the member's path if it stays inside and has no signs in it that some system takes for
    more than a name.
    """
    if member.is_absolute() or ".." in member.parts or UNSAFE_PATH.search(str(member)):
        raise _RefusedError(
            f"holds {str(member)!r}, which leads outside of it; nothing was unpacked, pack it again"
        )
    return member


def _too_much(limits: Limits) -> _RefusedError:
    return _RefusedError(
        f"holds more than {limits.n_files} files or {limits.n_bytes / 1e6:.0f} MB, more than this "
        "command needs and this disk may hold; unpack it manually and give the folder"
    )


def _forbidden(name: str, kind: str) -> _RefusedError:
    return _RefusedError(f"holds {name!r}, {kind}; only plain files are unpacked, pack it again")


@contextmanager
def _opened(path: Path, limits: Limits) -> Iterator[Iterator[_Member]]:
    if path.name.lower().endswith(".zip"):
        with zipfile.ZipFile(path) as packed:
            yield _zip_members(packed)
        return
    is_plain = path.name.lower().endswith(".tar")
    with path.open("rb") if is_plain else gzip.open(path) as stream:
        bounded = _Bounded(cast(IO[bytes], stream), limits)
        with tarfile.open(fileobj=bounded, mode="r:") as tar:  # type: ignore[call-overload]  # read, seek and tell are enough
            yield _tar_members(tar)


def _zip_members(packed: zipfile.ZipFile) -> Iterator[_Member]:
    for info in packed.infolist():
        mode = info.external_attr >> 16
        if info.flag_bits & 1:
            raise _forbidden(info.filename, "which is encrypted")
        if stat.S_IFMT(mode) not in (0, stat.S_IFREG, stat.S_IFDIR):
            raise _forbidden(info.filename, "a link or a device")
        if info.compress_type not in SAFE_CODINGS:
            raise _forbidden(info.filename, "packed by a method other than deflate")
        name = PurePosixPath(info.orig_filename.replace("\\", "/"))
        if info.orig_filename.endswith(("/", "\\")):
            yield _Member(name, 0, None)
        else:
            with packed.open(info) as content:
                yield _Member(name, info.file_size, content)


def _tar_members(tar: tarfile.TarFile) -> Iterator[_Member]:
    for info in tar:
        name = PurePosixPath(info.name.replace("\\", "/"))
        if info.isdir():
            yield _Member(name, 0, None)
        elif info.isreg() and not info.issparse():
            yield _Member(name, info.size, tar.extractfile(info))
        else:
            raise _forbidden(
                info.name, "a link or a device" if not info.issparse() else "a sparse file"
            )


class _Bounded:
    """A stream that refuses to be read, or skipped through, beyond the limits."""

    def __init__(self, stream: IO[bytes], limits: Limits) -> None:
        self._stream = stream
        self._limits = limits
        self._last = limits.n_bytes + (limits.n_files + 20) * 4 * tarfile.BLOCKSIZE

    def read(self, size: int = -1) -> bytes:
        """At most `size` bytes."""
        if not 0 <= size <= LARGEST_READ or self._stream.tell() + size > self._last:
            raise _too_much(self._limits)
        return self._stream.read(size)

    def seek(self, position: int) -> int:
        """Seek to a position by reading everything before it."""
        if position > self._last:
            raise _too_much(self._limits)
        return self._stream.seek(position)

    def tell(self) -> int:
        """Return the position in the stream."""
        return self._stream.tell()
