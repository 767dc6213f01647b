"""Batches made beside the training, in processes of their own."""

from collections.abc import Iterator
from typing import Any

import torch
from torch.utils.data import DataLoader, Dataset

from ggvs_eval.pipelines.training.loop.task import Task


class _Steps(Dataset[Any]):
    """Step -> batch."""

    def __init__(self, task: Task) -> None:
        self.task = task

    def __getitem__(self, step: int) -> Any:
        return self.task.batch(step)


def batches(task: Task, start: int, stop: int, workers: int) -> Iterator[Any]:
    """The batches of steps start..stop-1 in order; which worker makes which does not change them."""
    loader = DataLoader(
        _Steps(task),
        batch_size=None,
        sampler=range(start, stop),
        num_workers=workers,
        worker_init_fn=_one_thread,
        prefetch_factor=4 if workers else None,
        multiprocessing_context="spawn" if workers else None,
    )
    return iter(loader)


def _one_thread(_worker: int) -> None:
    import cv2

    cv2.setNumThreads(1)
    torch.set_num_threads(1)
