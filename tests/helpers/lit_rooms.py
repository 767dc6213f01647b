"""Rooms whose light is computed once for all processes of a session: it takes seconds of ray
casting, and many tests film.
"""

import fcntl
import time
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from ggvs_eval.contrib.worlds.film import film
from ggvs_eval.contrib.worlds.film.options import SceneName
from ggvs_eval.contrib.worlds.room import lighting
from ggvs_eval.contrib.worlds.room.garden import build_garden
from ggvs_eval.contrib.worlds.room.lighting import Instant, LitRoom
from ggvs_eval.contrib.worlds.room.room import build_room
from ggvs_eval.files.atomic import atomic_file

Arrays = tuple[np.ndarray, ...]
lit_s = 0.0  # processor time that this process has spent on light


class StoredLitRoom(LitRoom):
    """A lit room that looks into a folder before it casts rays; the bits are those of `LitRoom`."""

    def __init__(self, seed: int, scene: SceneName, folder: Path) -> None:
        self._folder, self._name = folder, f"{scene}{seed}"
        super().__init__(build_garden(seed) if scene == "garden" else build_room(seed))

    def at(self, time_s: float) -> Instant:
        """The lit room at an instant, cast or recalled."""

        def cast() -> Arrays:
            instant = super(StoredLitRoom, self).at(time_s)
            return instant.static_light, instant.moving_light

        return self.recall(time_s, *self._stored(f"at {time_s!r}", cast))

    def _bake(self) -> Arrays:
        return self._stored("baked", super()._bake)

    def _stored(self, what: str, compute: Callable[[], Arrays]) -> Arrays:
        path = self._folder / f"{self._name} {what}.npz"
        with path.with_suffix(".lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)  # the second of two processes waits and reads
            if not path.is_file():
                started_s = time.process_time()
                with atomic_file(path) as unfinished, unfinished.open("wb") as file:
                    np.savez(file, *compute())
                global lit_s
                lit_s += time.process_time() - started_s
        with np.load(path) as stored:
            return tuple(stored[key] for key in stored.files)


def stored_rooms(folder: Path) -> Callable[[int, SceneName], LitRoom]:
    """What takes the place of `film._lit_room`; keeps the last rooms in memory as well."""

    @lru_cache(maxsize=2)
    def lit_room(seed: int, scene: SceneName) -> LitRoom:
        return StoredLitRoom(seed, scene, folder)

    return lit_room


def light_by_few_rays(patch: pytest.MonkeyPatch, folder: Path) -> None:
    """An eighth of the rays finds the light that bounces: the same code in a fraction of the time,
    for nobody else to see.
    """
    patch.setattr(lighting, "AMBIENT_DIRECTIONS", lighting.AMBIENT_DIRECTIONS // 8)
    patch.setattr(film, "_lit_room", stored_rooms(folder))
