"""``python -m ggvs_eval.install``: what pip cannot do - system libraries of Open3D, weights of LPIPS. Idempotent."""

import os
import shutil
import subprocess
import sys

# Debian's names of what Open3D's wheel links against and does not carry.
SYSTEM_LIBRARIES = ("libusb-1.0-0", "libgl1", "libx11-6", "libudev1", "libgomp1")


def main() -> None:
    """Make Open3D importable or say how, and fetch what LPIPS needs or say what will be missing."""
    if not _imports_open3d():
        _install_system_libraries()
    _fetch_lpips()


def _imports_open3d() -> bool:
    return subprocess.run([sys.executable, "-c", "import open3d"], capture_output=True, check=False).returncode == 0


def _install_system_libraries() -> None:
    """Install them where we may, else stop with the one line to run."""
    command = ["apt-get", "install", "-y", "--no-install-recommends", *SYSTEM_LIBRARIES]
    if shutil.which("apt-get") and os.geteuid() == 0:
        environment = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
        if subprocess.run(command, env=environment, stdout=subprocess.DEVNULL, check=False).returncode != 0:
            subprocess.run(["apt-get", "update", "-q"], stdout=subprocess.DEVNULL, check=False)
            subprocess.run(command, env=environment, stdout=subprocess.DEVNULL, check=False)
    if not _imports_open3d():
        sys.exit(f"Open3D needs system libraries; on Debian or Ubuntu run: sudo {' '.join(command)}")


def _fetch_lpips() -> None:
    from ggvs_eval.errors import WeightsError
    from ggvs_eval.metrics.image.fetch_lpips import fetch_weights

    try:
        fetch_weights()
    except WeightsError as error:
        print(f"LPIPS will be reported as not computed: {error}", file=sys.stderr)


if __name__ == "__main__":
    main()
