"""Find without a GPU what a CUDA graph cannot record: on the device ``meta`` nothing can be
uploaded, nor read by the host.
"""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from unittest.mock import patch

import torch
from torch.utils._python_dispatch import TorchDispatchMode

# operations whose result the host must see
READS = {"_local_scalar_dense", "nonzero", "masked_select", "equal", "unique"}
# functions that make tensors of the host's numbers
UPLOADS = ("tensor", "as_tensor", "from_numpy", "asarray")


@contextmanager
def forbidden_operations() -> Iterator[set[str]]:
    """Names of what is called within that no graph records."""
    found: set[str] = set()

    class Watch(TorchDispatchMode):
        def __torch_dispatch__(self, func, types, args=(), kwargs=None):
            name, kwargs = func.overloadpacket.__name__, kwargs or {}
            if name in READS or (
                name == "_to_copy" and kwargs.get("device") not in (None, args[0].device)
            ):
                found.add(name)
            return func(*args, **kwargs)

    def watched(name, function):
        def call(*args, **kwargs):
            found.add(name)
            return function(*args, **kwargs)

        return call

    with torch.inference_mode(), Watch(), ExitStack() as stack:
        for name in UPLOADS:
            stack.enter_context(patch.object(torch, name, watched(name, getattr(torch, name))))
        yield found
