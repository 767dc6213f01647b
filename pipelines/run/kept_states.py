"""States of methods and metrics behind the first frames of a run, from which a longer run goes on with the same bits.

They are pickles, by which whoever wrote them can run anything: they lie in a private folder of one process, never in a run.
"""

import hashlib
import json
import pickle
from contextlib import suppress
from pathlib import Path
from typing import Any

from ggvs_eval.files.atomic import write_bytes


def keep_state(folder: Path | None, key: object, state: object) -> None:
    """Write a state under JSON values that it depends on; where it cannot be pickled, what made it will begin anew."""
    if folder is not None:
        with suppress(AttributeError, TypeError, pickle.PicklingError, OSError):
            write_bytes(_file(folder, key), pickle.dumps(state))


def find_state(folder: Path | None, key: object) -> Any:
    """Return what was kept under an equal key; None if nothing was."""
    return pickle.loads(_file(folder, key).read_bytes()) if folder and _file(folder, key).is_file() else None


def _file(folder: Path, key: object) -> Path:
    return folder / hashlib.sha256(json.dumps(key, sort_keys=True).encode()).hexdigest()
