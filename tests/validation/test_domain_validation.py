"""The table of methods by domains: its rows, its differences, and that candidates need no files.
Not in the wheel.
"""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from ggvs_eval.method import Instant, Method, Rendering
from ggvs_eval.metrics.image.psnr import psnr

domain_validation = pytest.importorskip(
    "benchmarks.domain_validation", reason="benchmarks lie beside the package"
)
domain_views = pytest.importorskip(
    "benchmarks.domain_views", reason="benchmarks lie beside the package"
)

PLAN = domain_views.ViewPlan(targets=2, views=2, frames=2, size=(96, 72))
DOMAINS = ("arc", "misplaced_depth")


class Painted:
    """A method that shows one grey, or the nearest source."""

    def __init__(self, level: float | None) -> None:
        self._level = level
        self.indices: list[int] = []

    def step(self, instant: Instant) -> Rendering:
        """One colour everywhere, or what the nearest source shows."""
        self.indices.append(instant.index)
        nearest = instant.sources[0].image.astype(np.float32) / 255
        return Rendering(nearest if self._level is None else np.full_like(nearest, self._level))


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two small domains, rendered and with depth."""
    folder = tmp_path_factory.mktemp("domains")
    domain_views.prepare_views(folder, DOMAINS, PLAN)
    return folder


def candidates(made: list[Painted]) -> dict[str, Callable[[], Method]]:
    """Methods of this test; those that are made are noted."""

    def make(level: float | None) -> Painted:
        made.append(Painted(level))
        return made[-1]

    return {"nearest": lambda: make(None), "grey": lambda: make(0.5)}


@pytest.mark.proof
def test_candidates_are_scored_in_every_domain_without_files(cache: Path) -> None:
    """A row per domain, view and method; each view has a fresh method that sees its instants in
    order; PSNR is the metric's.
    """
    made: list[Painted] = []
    scores = domain_validation.validate_domains(
        candidates(made), cache, DOMAINS, PLAN, perceptual=False
    )
    assert len(scores) == 2 * 2 * 2
    assert [each.indices for each in made] == [[0, 1]] * 4 + [[0]] * 4
    view = domain_views.prepare_views(cache, DOMAINS, PLAN)[-1]
    truth = next(view.samples()).truth
    grey = scores[(scores["domain"] == "misplaced_depth") & (scores["method"] == "grey")].iloc[-1]
    assert grey["PSNR"] == pytest.approx(psnr(np.full_like(truth, 128), truth))
    assert scores[scores["domain"] == "arc"]["STED"].notna().all()
    assert scores[scores["domain"] == "misplaced_depth"]["STED"].isna().all()


def test_tables_end_with_the_mean_and_the_differences() -> None:
    """Means over views first, then over domains, so that a domain with more views weighs no more;
    the first minus each other.
    """
    rows = [
        ("a", "ours", 30.0),
        ("a", "ours", 32.0),
        ("a", "peer", 30.0),
        ("b", "ours", 20.0),
        ("b", "peer", 21.0),
    ]
    table = domain_validation.mean_scores(
        pd.DataFrame(rows, columns=["domain", "method", "PSNR"]), "PSNR"
    )
    assert list(table.columns) == ["a", "b", "mean"]
    assert table.loc["ours"].tolist() == [31.0, 20.0, 25.5]
    assert table.loc["ours - peer"].tolist() == [1.0, -1.0, 0.0]


@pytest.mark.proof
def test_what_is_absent_is_named_in_the_file(cache: Path, tmp_path: Path) -> None:
    """Without the real capture its domain is left out of the scores; the file holds rows, means and
    the reason.
    """
    domains = ("arc", domain_views.REAL)
    scores = domain_validation.validate_domains(
        candidates([]), cache, domains, PLAN, tmp_path, perceptual=False
    )
    assert set(scores["domain"]) == {"arc"}
    domain_validation.write_scores(
        tmp_path / "table.json", scores, ["nearest", "grey"], ["real: absent"]
    )
    record = json.loads((tmp_path / "table.json").read_text())
    assert record["not_computed"] == ["real: absent"]
    assert record["means"]["PSNR"]["nearest"]["mean"] == pytest.approx(
        record["means"]["PSNR"]["nearest"]["arc"]
    )
    assert len(record["rows"]) == 4
    assert "LPIPS" not in domain_validation.show_tables(scores)
