"""The refiner of the blending network: filters of every pixel's own."""

import numpy as np
import pytest
import torch

from ggvs_eval.pipelines.online.refiner import (
    EVIDENCE,
    LEAST,
    STATISTICS_GAIN,
    STATISTICS_GRID,
    TAPS,
    TYPICAL,
    Refiner,
    evidence,
    filtered,
    local_range,
    picture_statistics,
    relief,
)

HEIGHT, WIDTH = 9, 11


def some(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed))


def test_filters_are_their_formula():
    """Every pixel gets its own colour plus its weighted differences to the twelve neighbours, the
    border's colour beyond it.
    """
    picture, taps = some(1, 3, HEIGHT, WIDTH), some(1, len(TAPS), HEIGHT, WIDTH, seed=1) - 0.5
    found = filtered(picture, taps)[0].numpy()
    image, weights = picture[0].numpy().astype(np.float64), taps[0].numpy().astype(np.float64)
    for row, column in np.ndindex(HEIGHT, WIDTH):
        expected = image[:, row, column].copy()
        for weight, (down, right) in zip(weights[:, row, column], TAPS, strict=True):
            neighbour = image[
                :, np.clip(row + down, 0, HEIGHT - 1), np.clip(column + right, 0, WIDTH - 1)
            ]
            expected += weight * (neighbour - image[:, row, column])
        np.testing.assert_allclose(found[:, row, column], expected, atol=1e-5)


def test_taps_lie_around_the_pixel():
    """Twelve different neighbours within two pixels, each with the one on the other side."""
    assert len(set(TAPS)) == len(TAPS) == 12
    assert {(-down, -right) for down, right in TAPS} == set(TAPS)
    assert max(abs(step) for tap in TAPS for step in tap) == 2


def test_untrained_it_changes_nothing():
    """Before the first step every filter is empty."""
    picture = some(2, 3, HEIGHT, WIDTH)
    found = Refiner(4)(picture, some(2, EVIDENCE, HEIGHT, WIDTH), some(2, 4, HEIGHT, WIDTH))
    torch.testing.assert_close(found, picture, atol=1e-6, rtol=0)


def trained(features: int) -> Refiner:
    torch.manual_seed(0)
    refiner = Refiner(features)
    torch.nn.init.normal_(refiner.taps.weight, std=0.3)
    torch.nn.init.normal_(refiner.condition.weight, std=0.05)
    return refiner


def test_it_treats_colours_alike_and_keeps_flat_areas():
    """Colours in another order give the refined colours in that order; a picture of one colour
    stays as it is.
    """
    refiner, picture = trained(2), some(1, 3, HEIGHT, WIDTH)
    rest = some(1, EVIDENCE, HEIGHT, WIDTH, seed=1), some(1, 2, HEIGHT, WIDTH, seed=2)
    found = refiner(picture, *rest)
    torch.testing.assert_close(refiner(picture[:, [2, 0, 1]], *rest), found[:, [2, 0, 1]])
    assert not torch.allclose(found, picture, atol=0.01)
    flat = torch.full_like(picture, 0.3)
    torch.testing.assert_close(refiner(flat, *rest), flat, atol=1e-5, rtol=0)


@pytest.mark.parametrize("size", [(1, 1), (2, 5), (9, 11), (32, 17)])
def test_statistics_are_their_formula(size):
    """Of every eighth row means, geometric and arithmetic, of the spread and of second differences,
    as logarithms.
    """
    picture, spread = some(2, 3, *size), some(2, *size, seed=1)
    found = picture_statistics(picture, spread).numpy()
    for image, values, statistics in zip(
        picture.mean(1).double().numpy(), spread.double().numpy(), found, strict=True
    ):
        inner = image[1:-1, 1:-1]
        along = np.abs(inner - (image[:-2, 1:-1] + image[2:, 1:-1]) / 2) + np.abs(
            inner - (image[1:-1, :-2] + image[1:-1, 2:]) / 2
        )
        along = along if along.size else np.zeros((1, 1))
        means = [
            mean
            for of in (values[::8], along[::8])
            for mean in (np.log(of + LEAST).mean(), np.log(of.mean() + LEAST))
        ]
        np.testing.assert_allclose(
            statistics, STATISTICS_GAIN * (np.array(means) - TYPICAL), atol=1 / STATISTICS_GRID
        )
        np.testing.assert_array_equal(statistics * STATISTICS_GRID % 1, 0)


def views(count: int, **changed: torch.Tensor) -> dict[str, torch.Tensor]:
    colours, weights = some(1, count, 3, HEIGHT, WIDTH), some(1, count, HEIGHT, WIDTH, seed=1)
    known = {
        "colours": colours,
        "weights": weights,
        "visibilities": weights,
        "depth": 1 + some(1, HEIGHT, WIDTH, seed=2),
    }
    known["picture"] = (weights[:, :, None] * colours).sum(1) / weights.sum(1, keepdim=True)
    return known | changed


def test_evidence_is_its_formula():
    """The spread is ten times the weighted standard deviation, the number of views a third of their
    sum; nothing exceeds 1.
    """
    given = views(3)
    found = evidence(**given)
    assert found.shape == (1, EVIDENCE, HEIGHT, WIDTH)
    assert float(found.abs().max()) <= 1
    colours, weights = given["colours"][0].numpy(), given["weights"][0].numpy()
    mean = np.average(
        colours.transpose(1, 0, 2, 3), axis=1, weights=np.broadcast_to(weights, (3, *weights.shape))
    )
    variance = (weights * ((colours - mean) ** 2).mean(axis=1)).sum(axis=0) / weights.sum(axis=0)
    np.testing.assert_allclose(
        found[0, 0].numpy(), np.minimum(10 * np.sqrt(variance), 1), atol=1e-4
    )
    np.testing.assert_allclose(
        found[0, 1].numpy(), np.minimum(weights.sum(axis=0) / 3, 1), atol=1e-6
    )


def test_evidence_knows_no_scale():
    """Depth in other units, and views that are not there, change nothing."""
    given = views(2)
    found = evidence(**given)
    torch.testing.assert_close(
        evidence(**views(2, depth=7 * given["depth"])), found, atol=1e-4, rtol=0
    )
    absent = {
        "colours": torch.cat([given["colours"], torch.zeros(1, 1, 3, HEIGHT, WIDTH)], dim=1),
        "weights": torch.cat([given["weights"], torch.zeros(1, 1, HEIGHT, WIDTH)], dim=1),
        "visibilities": torch.cat([given["visibilities"], torch.zeros(1, 1, HEIGHT, WIDTH)], dim=1),
    }
    torch.testing.assert_close(evidence(**(given | absent)), found)


def test_relief_of_a_step():
    """Flat depth has none; before a step in depth it is negative, behind it positive; unknown depth
    counts for nothing.
    """
    logarithm = torch.zeros(1, HEIGHT, WIDTH)
    logarithm[..., 6:] = 0.5
    known = torch.ones(1, HEIGHT, WIDTH, dtype=torch.bool)
    found = relief(logarithm, known)[0, 4]
    assert float(found[2]) == pytest.approx(0, abs=1e-6)
    # two of five columns lie behind
    assert float(found[5]) == pytest.approx(-0.5 * 2 / 5, abs=1e-6)
    assert float(found[6]) == pytest.approx(0.5 * 2 / 5, abs=1e-6)
    known[..., 6:] = False
    torch.testing.assert_close(relief(logarithm, known), torch.zeros(1, HEIGHT, WIDTH))


def test_range_of_a_window():
    """Largest less smallest value of the window, cut off at the border."""
    values = some(1, HEIGHT, WIDTH)
    found = local_range(values, 3)[0].numpy()
    array = values[0].numpy()
    for row, column in np.ndindex(HEIGHT, WIDTH):
        window = array[max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2]
        assert found[row, column] == pytest.approx(window.max() - window.min(), abs=1e-6)
