"""``python -m ggvs_eval.install``: what pip cannot do - system libraries of Open3D, weights of
LPIPS and DISTS. Idempotent.
"""

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable

# Debian's names of what Open3D's wheel links against and does not carry.
SYSTEM_LIBRARIES = ("libusb-1.0-0", "libgl1", "libx11-6", "libudev1", "libgomp1")
# A fresh machine may still be installing its own packages.
LOCK_WAIT_S, LOCK_POLL_S = 300.0, 2.0
LOCKED = "Could not get lock"


def main() -> None:
    """Make Open3D importable or say how, and fetch what LPIPS and DISTS need or say what will be
    missing.
    """
    if not _imports_open3d():
        _install_system_libraries()
    _fetch_weights()


def _imports_open3d() -> bool:
    return (
        subprocess.run(
            [sys.executable, "-c", "import open3d"], capture_output=True, check=False
        ).returncode
        == 0
    )


def _install_system_libraries() -> None:
    """Install them if permitted, else stop with the line to run."""
    words = ("install", "-y", "--no-install-recommends", *SYSTEM_LIBRARIES)
    if shutil.which("apt-get") and os.geteuid() == 0 and run_apt(*words) != 0:
        run_apt("update", "-q")
        run_apt(*words)
    if not _imports_open3d():
        sys.exit(
            f"Open3D needs system libraries; on Debian or Ubuntu run: sudo apt-get "
            f"{' '.join(words)}"
        )


def run_apt(*words: str, wait_s: float = LOCK_WAIT_S) -> int:
    """Run apt-get; where another process holds one of its locks, wait for it.

    Args:
        wait_s: how long to wait, seconds.

    Returns:
        Its exit status; what it complains of goes to standard error.

    Reading:
        apt-get's own ``DPkg::Lock::Timeout`` waits for dpkg alone, and not for the lists of
        packages, which another ``update`` locks. So it is asked again, in English.
    """
    environment = {**os.environ, "DEBIAN_FRONTEND": "noninteractive", "LC_ALL": "C"}
    deadline = time.monotonic() + wait_s
    while True:
        process = subprocess.run(
            ["apt-get", *words], env=environment, capture_output=True, text=True, check=False
        )
        if process.returncode == 0 or LOCKED not in process.stderr or time.monotonic() > deadline:
            sys.stderr.write(process.stderr)
            return process.returncode
        time.sleep(LOCK_POLL_S)


def _fetch_weights() -> None:
    from ggvs_eval.built_in import FETCHED_WEIGHTS
    from ggvs_eval.errors import WeightsError
    from ggvs_eval.plugins import Registry

    fetchers: Registry[Callable[[], object]] = Registry("weights", FETCHED_WEIGHTS)
    for name, fetch in fetchers.items():
        try:
            fetch()
        except WeightsError as error:
            print(f"{name} will be listed as not computed: {error}", file=sys.stderr)


if __name__ == "__main__":
    main()
