"""Files and folders are there whole or not at all, whoever is killed, fails or writes at the same
time.
"""

import errno
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from ggvs_eval.files.atomic import (
    atomic_file,
    atomic_folder,
    locked,
    remove_leftovers,
    scratch_folder,
    sweep_files,
    write_bytes,
    write_text,
)
from ggvs_eval.files.video import write_video

STOP_IN_THE_MIDDLE = """
import sys, time
from pathlib import Path
from ggvs_eval.files.atomic import {writer}
with {writer}(Path(sys.argv[1])) as temporary:
    target = temporary / "half" if "{writer}" == "atomic_folder" else temporary
    target.write_text("half")
    print("half way", flush=True)
    time.sleep(60)
"""


def kill_in_the_middle(writer, path):
    """Let another process begin to write, and kill it half way."""
    code = STOP_IN_THE_MIDDLE.format(writer=writer)
    process = subprocess.Popen(
        [sys.executable, "-c", code, str(path)], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout.readline() == "half way\n"
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    process.stdout.close()


def test_a_file_appears_whole_with_its_folder(tmp_path):
    """The folder is made, the text is UTF-8, and nothing else is left."""
    write_text(tmp_path / "new" / "notes.txt", "Grüße\n")
    write_bytes(tmp_path / "new" / "notes.bin", b"\x00")

    assert (tmp_path / "new" / "notes.txt").read_bytes() == "Grüße\n".encode()
    assert sorted(item.name for item in (tmp_path / "new").iterdir()) == ["notes.bin", "notes.txt"]


def test_a_kill_leaves_the_old_file(tmp_path):
    """After kill -9 in the middle the old content stands, and the next write succeeds."""
    path = tmp_path / "table.csv"
    path.write_text("old")
    kill_in_the_middle("atomic_file", path)
    assert path.read_text() == "old"

    write_text(path, "new")

    assert path.read_text() == "new"


def test_an_error_leaves_the_old_file_and_nothing_else(tmp_path):
    """What fails while it writes takes its temporary file away."""
    path = tmp_path / "table.csv"
    path.write_text("old")

    def fail_half_way():
        with atomic_file(path) as temporary:
            temporary.write_text("half")
            raise ValueError("no such column")

    with pytest.raises(ValueError, match="no such column"):
        fail_half_way()

    assert path.read_text() == "old"
    assert [item.name for item in tmp_path.iterdir()] == ["table.csv"]


def test_two_writers_at_once_leave_one_of_both(tmp_path):
    """Threads of one process do not write into each other's file; readers never see a half."""
    path = tmp_path / "frame.bin"
    contents = [bytes([number]) * 200_000 for number in range(4)]
    path.write_bytes(contents[0])

    def write(content):
        for _ in range(30):
            write_bytes(path, content)

    writers = [threading.Thread(target=write, args=(content,)) for content in contents]
    for writer in writers:
        writer.start()
    while any(writer.is_alive() for writer in writers):
        assert path.read_bytes() in contents
    for writer in writers:
        writer.join()

    assert path.read_bytes() in contents
    assert [item.name for item in tmp_path.iterdir()] == ["frame.bin"]


def test_errors_name_the_file_that_was_wanted(tmp_path):
    """A user knows nothing of temporary names; a full disk names no file at all."""
    (tmp_path / "taken").mkdir()

    with pytest.raises(OSError, match=r"taken'$"):
        write_text(tmp_path / "taken", "text")
    with pytest.raises(OSError, match=r"full\.csv'$"), atomic_file(tmp_path / "full.csv"):
        raise OSError(errno.ENOSPC, "No space left on device")
    with (
        pytest.raises(OSError, match=r"No space left on device: '.*full\.npy'$"),
        atomic_file(tmp_path / "full.npy"),
        Path("/dev/full").open("wb", buffering=0) as full,
    ):
        np.save(full, np.zeros(100_000))
    with (
        pytest.raises(FileNotFoundError, match=r"frame\.png'$"),
        atomic_file(tmp_path / "copy.png"),
    ):
        (tmp_path / "frame.png").read_bytes()

    assert [item.name for item in tmp_path.iterdir()] == ["taken"]


def test_what_cannot_be_opened_is_named(tmp_path):
    """By whatever opens the temporary file: Python, numpy or PyAV. A name that is too long is
    refused to root too.
    """
    path = tmp_path / f"{'a' * 300}.mp4"
    frames = [np.zeros((16, 16, 3), np.uint8)]

    with pytest.raises(OSError, match=r"too long: '/.*/a+\.mp4'$"):
        write_text(path, "text")
    with pytest.raises(OSError, match=r"too long: '/.*/a+\.mp4'$"):
        write_video(path, frames, 30)

    assert list(tmp_path.iterdir()) == []


def test_a_folder_appears_whole(tmp_path):
    """Nothing stands under the name before the end; an error leaves nothing, a folder with content
    is refused.
    """
    with atomic_folder(tmp_path / "out") as unfinished:
        (unfinished / "file").write_text("text")
        assert not (tmp_path / "out").exists()
    with pytest.raises(OSError, match="out"), atomic_folder(tmp_path / "out") as unfinished:
        (unfinished / "other").write_text("text")
    with pytest.raises(KeyboardInterrupt), atomic_folder(tmp_path / "stopped"):
        raise KeyboardInterrupt

    assert [item.name for item in (tmp_path / "out").iterdir()] == ["file"]
    assert [item.name for item in tmp_path.iterdir()] == ["out"]


def test_a_folder_that_a_killed_process_left_goes_at_the_next_call(tmp_path):
    """Signs that a pattern would read as more than a name are names here."""
    out = tmp_path / "run [1]"
    kill_in_the_middle("atomic_folder", out)
    assert not out.exists()
    assert len(list(tmp_path.iterdir())) == 1

    with atomic_folder(out) as unfinished:
        (unfinished / "file").write_text("text")

    assert [item.name for item in tmp_path.iterdir()] == ["run [1]"]


def test_folders_in_hand_stay(tmp_path):
    """Of this machine while the process lives, of another machine until it has been silent for an
    hour.
    """
    host = socket.gethostname().replace(".", "-")
    ours, theirs, silent = (
        tmp_path / f".out.{name}.{os.getppid()}.tmp" for name in (host, "elsewhere", "gone")
    )
    for folder in (ours, theirs, silent):
        folder.mkdir()
    os.utime(silent, (time.time() - 4000,) * 2)

    remove_leftovers(tmp_path / "out")

    assert sorted(item.name for item in tmp_path.iterdir()) == sorted([ours.name, theirs.name])


def test_a_scratch_folder_goes_whatever_happens(tmp_path):
    """It is empty at first, and gone at the end."""

    def fail_half_way():
        with scratch_folder(tmp_path / "mine") as folder:
            assert list(folder.iterdir()) == []
            (folder / "file").write_text("text")
            raise ValueError("spoilt")

    with pytest.raises(ValueError, match="spoilt"):
        fail_half_way()

    assert list(tmp_path.iterdir()) == []


def test_files_that_killed_processes_left_are_swept(tmp_path):
    """Those of the dead go, of this machine and of silent others; what is being written, and what
    is nobody's, stays.
    """
    kill_in_the_middle("atomic_file", tmp_path / "000001.npz")
    (left,) = tmp_path.iterdir()
    silent, theirs = (
        tmp_path / f".000002.npz.0a1b2c3d.{host}.77.tmp.ply" for host in ("gone", "elsewhere")
    )
    for name in (
        silent,
        theirs,
        tmp_path / ".hidden",
        tmp_path / ".notes.tmp",
        tmp_path / "000003.npz",
    ):
        name.touch()
    os.utime(silent, (time.time() - 4000,) * 2)

    with atomic_file(tmp_path / "000004.npz") as temporary:
        temporary.touch()
        sweep_files(tmp_path)
        assert not left.exists()
        assert sorted(item.name for item in tmp_path.iterdir()) == sorted(
            [temporary.name, theirs.name, ".hidden", ".notes.tmp", "000003.npz"]
        )

    sweep_files(tmp_path / "absent")


def test_a_locked_folder_is_one_writers(tmp_path):
    """Threads that add to one file behind the lock lose nothing of each other's."""
    file = tmp_path / "count"
    file.write_text("0")

    def add():
        for _ in range(50):
            with locked(tmp_path):
                write_text(file, str(int(file.read_text()) + 1))

    writers = [threading.Thread(target=add) for _ in range(4)]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join()

    assert file.read_text() == "200"
