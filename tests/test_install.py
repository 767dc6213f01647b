"""The installer of what pip cannot: it waits for an apt-get that is already at work."""

import fcntl
import shutil
import threading
import time

import pytest

from ggvs_eval import install

pytestmark = pytest.mark.skipif(
    shutil.which("apt-get") is None, reason="Debian's package manager is not on this machine"
)


@pytest.fixture
def update(tmp_path, monkeypatch):
    """Arguments with which apt-get updates lists of its own, from no source, and the file that
    locks them.
    """
    (tmp_path / "partial").mkdir()
    monkeypatch.setattr(install, "LOCK_POLL_S", 0.1)
    places = {
        "State::lists": tmp_path,
        "Etc::sourcelist": "/dev/null",
        "Etc::sourceparts": "/dev/null",
        "Cache": tmp_path,
    }
    return [
        "update",
        "-q",
        *(f"-oDir::{name}={place}" for name, place in places.items()),
    ], tmp_path / "lock"


def test_a_lock_is_waited_for(update):
    """While another process holds the lists, apt-get is asked again; as soon as it lets go, the
    update is done.
    """
    words, lock = update
    with lock.open("w") as held:
        fcntl.lockf(held, fcntl.LOCK_EX)
        release = threading.Timer(0.7, fcntl.lockf, (held, fcntl.LOCK_UN))
        start = time.monotonic()
        release.start()
        assert install.run_apt(*words, wait_s=60) == 0
        assert time.monotonic() - start >= 0.7


def test_a_lock_is_not_waited_for_without_end(update, capfd):
    """After the wait the status is apt-get's, and its complaint is shown."""
    words, lock = update
    with lock.open("w") as held:
        fcntl.lockf(held, fcntl.LOCK_EX)
        assert install.run_apt(*words, wait_s=0.0) != 0
    assert install.LOCKED in capfd.readouterr().err


def test_other_failures_are_told_at_once(capfd):
    """A word that apt-get does not know is no lock."""
    assert install.run_apt("no-such-command", wait_s=60) != 0
    assert "Invalid operation" in capfd.readouterr().err
