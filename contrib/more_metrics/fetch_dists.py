"""Download the weights of DISTS: ``python -m ggvs_eval.contrib.more_metrics.fetch_dists``, once,
with a network.

The authors' package DISTS-pytorch 0.1 (MIT) carries the 2 x 1475 numbers that were trained; the
VGG16 below them is the one that LPIPS has, whose weights are fetched too (`fetch_lpips`). The
package is taken by pip against a fixed sha256, read without running anything of it, and kept as
safetensors.
"""

import hashlib
import io
import sys
import tempfile
import zipfile
from pathlib import Path

from ggvs_eval.errors import GgvsError, WeightsError
from ggvs_eval.files.atomic import atomic_file
from ggvs_eval.files.download import cache_folder
from ggvs_eval.metrics.image.fetch_lpips import download_package, fetch_weights

PACKAGE = "DISTS-pytorch"
VERSION = "0.1"
SHA256 = "73e54ce13e7cf3ca962ee8e433d129884ec3dc75e00a27af90525e1da760ac61"
CHECKPOINT = "DISTS_pytorch/weights.pt"
CHANNELS = (3, 64, 128, 256, 512, 512)
FETCH_COMMAND = "python -m ggvs_eval.contrib.more_metrics.fetch_dists"


def dists_weights_path() -> Path:
    """Return the safetensors file of DISTS, present or not."""
    return cache_folder() / "dists-v0.1.safetensors"


def fetch_dists_weights() -> Path:
    """Download, convert and keep the weights of DISTS; does nothing if they are kept already.

    Raises:
        WeightsError: pip cannot get the package, or it is not the one that is wanted.
    """
    path = dists_weights_path()
    if not path.is_file():
        with tempfile.TemporaryDirectory() as folder:
            wheel = download_package(
                PACKAGE, VERSION, SHA256, Path(folder), FETCH_COMMAND, wheel=True
            )
            keep_dists_weights(wheel, path)
    return path


def keep_dists_weights(wheel: Path, path: Path) -> None:
    """Read the weights out of the authors' wheel and write them as safetensors: ``alpha`` and
    ``beta``, (1475,) float32.
    """
    import torch
    from safetensors.torch import save_file

    digest = hashlib.sha256(wheel.read_bytes()).hexdigest()
    if digest != SHA256:
        raise WeightsError(
            f"{wheel.name}: wanted sha256 {SHA256}, got {digest}; move it away and run "
            f"`{FETCH_COMMAND}` again"
        )
    with zipfile.ZipFile(wheel) as archive:
        checkpoint = torch.load(
            io.BytesIO(archive.read(CHECKPOINT)), map_location="cpu", weights_only=True
        )
    tensors = {
        name: checkpoint[name].detach().reshape(-1).float().contiguous()
        for name in ("alpha", "beta")
    }
    with atomic_file(path) as temporary:
        save_file(tensors, temporary, metadata={"origin": f"{PACKAGE} {VERSION}", "sha256": SHA256})


def main() -> None:
    """Fetch the weights, those of the VGG16 too, and say where they are.

    Exit 1 with one line when they cannot be had.
    """
    try:
        for path in (*fetch_weights(), fetch_dists_weights()):
            print(path)
    except GgvsError as error:
        sys.exit(str(error))


if __name__ == "__main__":
    main()
