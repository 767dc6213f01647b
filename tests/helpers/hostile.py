"""What a malicious checkpoint holds: code that an unpickler would run."""

from pathlib import Path


class Hostile:
    """Makes a file when it is unpickled.

    Args:
        path: of the file; it must not be there after a loader has refused the checkpoint.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self):
        """What an unpickler would call."""
        return Path.touch, (self.path,)
