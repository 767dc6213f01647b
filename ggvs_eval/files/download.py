"""Files from the network: resumable downloads, each recorded."""

import hashlib
import json
import os
import urllib.error
import urllib.request
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from http.client import HTTPException
from pathlib import Path
from typing import IO
from urllib.parse import urlsplit

from ggvs_eval.errors import GgvsError
from ggvs_eval.files.atomic import atomic_file
from ggvs_eval.progress import track

CHUNK_BYTES = 1 << 20
TIMEOUT_S = 60.0
LOOPBACK = ("127.0.0.1", "::1", "localhost")


@dataclass(frozen=True)
class Fetched:
    """Record of a download, by which later ones are judged.

    Attributes:
        date: of the day, ISO 8601, UTC.
    """

    url: str
    n_bytes: int
    sha256: str
    date: str


class DownloadError(GgvsError):
    """A file cannot be fetched, or has changed."""


def cache_folder() -> Path:
    """Return the folder of downloads: $GGVS_EVAL_CACHE, else ggvs-eval under $XDG_CACHE_HOME or
    ~/.cache.
    """
    if folder := os.environ.get("GGVS_EVAL_CACHE"):
        return Path(folder)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "ggvs-eval"


def download(url: str, file: Path, record: Path) -> Fetched:
    """Download a file, or take the one that is there, and verify that it has not changed since the
    first time.

    Args:
        file: target. A stopped download is in ``FILE.part``, which the next call continues from
            while the server still has the same file.
        record: JSON file that keeps size and SHA-256 of the first download, by which later ones are
            judged.

    Raises:
        DownloadError: the server does not answer or has no such file, or it is another file than
            that of the record.
    """
    file.parent.mkdir(parents=True, exist_ok=True)
    if not file.is_file():
        _fetch(url, file)
    with file.open("rb") as content:
        digest = hashlib.file_digest(content, "sha256").hexdigest()
    fetched = Fetched(
        url=url,
        n_bytes=file.stat().st_size,
        sha256=digest,
        date=datetime.now(UTC).date().isoformat(),
    )
    first = read_record(record)
    if first is None:
        with atomic_file(record) as unfinished:
            unfinished.write_text(json.dumps(asdict(fetched), indent=1) + "\n", encoding="utf-8")
        return fetched
    if (first.n_bytes, first.sha256) != (fetched.n_bytes, fetched.sha256):
        raise DownloadError(
            f"{file}: wanted the {first.n_bytes} bytes of {first.date} (SHA-256 "
            f"{first.sha256[:12]}...), got {fetched.n_bytes} "
            f"({fetched.sha256[:12]}...); move it away to download it again, or {record} to accept "
            f"the new one"
        )
    return first


def read_record(record: Path) -> Fetched | None:
    """Read the record of the first download; None if there was none."""
    try:
        return (
            Fetched(**json.loads(record.read_text(encoding="utf-8"))) if record.is_file() else None
        )
    except (OSError, ValueError, TypeError) as error:
        raise DownloadError(
            f"{record}: wanted the record of a download, got {error!r:.100}; move it away"
        ) from error


def _fetch(url: str, file: Path) -> None:
    """Fetch a file, from where an earlier call was stopped."""
    part, tag_file = file.with_name(f"{file.name}.part"), file.with_name(f"{file.name}.tag")
    tag = tag_file.read_text(encoding="utf-8") if part.is_file() and tag_file.is_file() else ""
    begun = part.stat().st_size if tag else 0
    # With If-Range the server sends the rest of the same file, or the whole of another one.
    headers = {"Range": f"bytes={begun}-", "If-Range": tag} if begun else {}
    try:
        with urllib.request.urlopen(
            urllib.request.Request(url, headers=headers), timeout=TIMEOUT_S
        ) as answer:
            _require_secure(url, answer.geturl())
            begun = begun if answer.status == 206 else 0
            tag_file.write_text(
                answer.headers.get("ETag") or answer.headers.get("Last-Modified") or "",
                encoding="utf-8",
            )
            length = answer.headers.get("Content-Length")
            total = None if length is None else begun + int(length)
            with part.open("ab" if begun else "wb") as target:
                for chunk in track(
                    _chunks(answer),
                    f"fetching {file.name} (MiB)",
                    None if total is None else total >> 20,
                ):
                    target.write(chunk)
    except urllib.error.HTTPError as error:
        if error.code != 416 or not begun:  # nothing is left to send: all of it is here
            raise _unreached(url, file, f"{error.code} {error.reason}") from error
        total = begun
    except (OSError, HTTPException, ValueError) as error:
        raise _unreached(url, file, str(getattr(error, "reason", error))) from error
    if total is not None and part.stat().st_size != total:
        raise _unreached(
            url, file, f"{part.stat().st_size} of {total} bytes before the connection ended"
        )
    part.replace(file)
    tag_file.unlink(missing_ok=True)


def _chunks(answer: IO[bytes]) -> Iterator[bytes]:
    while chunk := answer.read(CHUNK_BYTES):
        yield chunk


def _require_secure(request_url: str, answer_url: str) -> None:
    """Refuse a redirection of an https address to a protocol that does not protect what is sent."""
    answer = urlsplit(answer_url)
    if answer.scheme != "https" and (
        urlsplit(request_url).scheme == "https" or answer.hostname not in LOOPBACK
    ):
        raise ValueError(
            f"an answer over {answer.scheme} from {answer.hostname}, which is not secure"
        )


def _unreached(url: str, file: Path, reason: str) -> DownloadError:
    return DownloadError(
        f"{url}: {reason}; run the same command to resume, or fetch it another way and save it as "
        f"{file}"
    )
