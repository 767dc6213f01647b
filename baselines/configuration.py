"""Which configuration of a network a file of weights belongs to: the authors' full one, or a named smaller one."""

from collections.abc import Collection
from pathlib import Path

from safetensors import SafetensorError, safe_open

from ggvs_eval.errors import WeightsError

NOTE = "configuration"  # in the header of a weights file
FULL = "full"


def configuration_of(path: Path, known: Collection[str], of: str) -> str | None:
    """Name of the configuration that a weights file says it is.

    Args:
        path: safetensors, or a torch checkpoint.
        known: names of the network's configurations.
        of: whose weights are wanted, for messages.

    Returns:
        The name, None where the file says nothing: a checkpoint of the authors, or a copy of it, which is the full one.

    Raises:
        WeightsError: a name that is not known, or a damaged file.
    """
    if path.suffix != ".safetensors" or not path.is_file():
        return None
    try:
        with safe_open(path, "pt") as file:
            name: str | None = (file.metadata() or {}).get(NOTE)
    except (SafetensorError, OSError) as error:
        raise WeightsError(f"{path}: damaged, or not safetensors ({error}); fetch it again") from error
    if name is not None and name not in known:
        raise WeightsError(f"{path}: wanted a configuration of {of} ({', '.join(known)}), got {name}; train it again")
    return name
