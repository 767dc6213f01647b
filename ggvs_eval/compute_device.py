"""The device on which networks compute: the CPU, with the same bits on any CPU, or a GPU."""

from collections.abc import Iterator
from contextlib import contextmanager
from time import perf_counter

import torch

from ggvs_eval.errors import DeviceError


@contextmanager
def one_thread() -> Iterator[None]:
    """Within, torch computes with one thread; parallel work is done in processes, one per view."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


def compute_device(name: str) -> torch.device:
    """Resolve the name of a device.

    Args:
        name: ``cpu``, ``cuda``, ``cuda:1`` and so on, or ``auto``: the GPU where torch finds one.
    """
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        device = torch.device(name)
    except RuntimeError as error:
        raise DeviceError(f"device {name!r}: wanted cpu, cuda, cuda:N or auto") from error
    if device.type == "cuda" and (device.index or 0) >= torch.cuda.device_count():
        raise DeviceError(
            f"device {name}: torch {torch.__version__} finds {torch.cuda.device_count()} GPUs; use "
            f"cpu, or install torch {torch.__version__.partition('+')[0]} for CUDA into this "
            "environment"
        )
    if device.type not in ("cpu", "cuda"):
        raise DeviceError(f"device {name!r}: wanted cpu, cuda, cuda:N or auto")
    return device


@contextmanager
def computing_on(device: torch.device) -> Iterator[None]:
    """Within, tensors that name no device, `torch.as_tensor` of arrays included, are made on this
    one.
    """
    if device.type == "cpu":
        yield  # where they are made anyway
        return
    with device:
        yield


@contextmanager
def rendering_on(device: torch.device) -> Iterator[None]:
    """`computing_on` for a picture: no gradients, one thread on the CPU, whole single precision on
    a GPU.

    Reading:
        cuDNN rounds the factors of convolutions to ten bits by default, which moves pixels of a
        render by levels.
    """
    rounds = torch.backends.cudnn.allow_tf32
    torch.backends.cudnn.allow_tf32 = False
    try:
        with (
            out_of_memory(device, "render at a smaller size"),
            one_thread(),
            torch.inference_mode(),
            computing_on(device),
        ):
            yield
    finally:
        torch.backends.cudnn.allow_tf32 = rounds


@contextmanager
def out_of_memory(device: torch.device | str, remedy: str) -> Iterator[None]:
    """Turn running out of GPU memory into an error that says what to do."""
    try:
        yield
    except torch.OutOfMemoryError as error:
        raise DeviceError(
            f"device {device}: not enough free memory; {remedy}, or fewer jobs at once (--jobs)"
        ) from error


def clock_s(device: torch.device) -> float:
    """Return the time, seconds, when all is done that the device was asked for: a GPU works on
    while Python goes ahead.
    """
    if device.type == "cuda":
        torch.cuda.synchronize(device)
    return perf_counter()


def describe_device(device: torch.device | str) -> str:
    """Name a device for the record of what it computed: ``cpu``, or ``cuda: NVIDIA H100 80GB
    HBM3``; another rounds otherwise.
    """
    device = compute_device(device) if isinstance(device, str) else device
    return f"cuda: {torch.cuda.get_device_name(device)}" if device.type == "cuda" else device.type
