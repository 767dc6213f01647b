"""A module of the package whose text is another one, as the identity of code sees it."""

from functools import cache
from pathlib import Path

from ggvs_eval.tasks import identity
from helpers.import_graph import modules


def change_code(monkeypatch, name: str) -> None:
    """Give a module, whose name is without ``ggvs_eval.``, another digest."""
    changed, digest = modules()[name].resolve(), identity._file_digest

    def other_digest(file: Path) -> str:
        return "changed" if file.resolve() == changed else digest(file)

    monkeypatch.setattr(identity, "_file_digest", other_digest)
    monkeypatch.setattr(identity, "_room_digest", cache(identity._room_digest.__wrapped__))
