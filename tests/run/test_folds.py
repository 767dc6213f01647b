"""Folds of held-out cameras: a partition of distant cameras, stated by the protocol where it
matters and nowhere else.
"""

import dataclasses
from itertools import combinations

import numpy as np
import pytest

from ggvs_eval.errors import ProtocolError
from ggvs_eval.pipelines.run.folds import choose_folds, fill_folds
from ggvs_eval.protocol import load_protocol
from helpers.scenes import camera_at


def nearest_within(cameras, folds) -> float:
    """Smallest distance of two cameras of one fold."""
    centres = {camera.name: camera.centre for camera in cameras}
    return min(
        float(np.linalg.norm(centres[a] - centres[b]))
        for fold in folds
        for a, b in combinations(fold, 2)
    )


@pytest.mark.parametrize("count", range(1, 12))
def test_folds_are_a_partition(count):
    """Every test camera in exactly one of at most three folds, whose sizes differ by one at
    most.
    """
    cameras = [camera_at(0.3 * at, name=f"cam{at:02d}") for at in range(count)]
    folds = choose_folds(cameras)
    assert sorted(view for fold in folds for view in fold) == [camera.name for camera in cameras]
    assert len(folds) == min(3, count)
    assert max(map(len, folds)) - min(map(len, folds)) <= 1


def test_cameras_of_a_fold_lie_apart():
    """In a row of nine no two neighbours or next neighbours; in a grid of three by three no
    neighbours, whatever their order.
    """
    row = [camera_at(float(at), name=f"cam{at}") for at in range(9)]
    grid = [camera_at(float(at % 3), name=f"cam{at}", y=float(at // 3)) for at in range(9)]
    assert nearest_within(row, choose_folds(row)) == pytest.approx(3.0)
    for seed in range(3):
        order = np.random.default_rng(seed).permutation(9)
        assert nearest_within(grid, choose_folds([grid[at] for at in order])) >= np.sqrt(2) - 1e-9


def with_views(protocol, **views):
    return dataclasses.replace(protocol, views=dataclasses.replace(protocol.views, **views))


def test_folds_and_sources_are_part_of_the_hash_where_they_are_stated(tmp_path):
    """Without folds and sources a protocol is that of older results, with them another, read back;
    open folds agree with any.
    """
    plain = load_protocol("demo")
    folded = plain.with_folds((("cam00", "cam07"), ("cam03",)))
    sourced = with_views(plain, sources=("cam01", "cam02"))
    assert len({each.sha256 for each in (plain, folded, sourced)}) == 3
    assert "folds" not in plain.to_toml()
    assert plain.to_toml() == folded.with_folds(()).to_toml()
    for each in (folded, sourced):
        (tmp_path / "copy.toml").write_text(each.to_toml())
        assert load_protocol(tmp_path / "copy.toml") == each
    plain = load_protocol("demo")
    one, other = (
        plain.with_folds((("cam00", "cam03", "cam07"),)),
        plain.with_folds((("cam00", "cam07"), ("cam03",))),
    )
    assert plain.agrees_with(one)
    assert one.agrees_with(plain)
    assert not one.agrees_with(other)
    assert not plain.agrees_with(with_views(plain, sources=("cam01",)))


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (
            'folds = [["cam00"], ["cam03"]]',
            "views.folds must hold each of views.test once, and nothing else",
        ),
        (
            'folds = [["cam00", "cam03"], ["cam03", "cam07"]]',
            "views.folds must hold each of views.test once",
        ),
        (
            'folds = ["cam00", "cam03", "cam07"]',
            "views.folds.0. must be a list of a text, got 'cam00'",
        ),
        ('sources = ["cam01", "cam01"]', "views.sources must name each camera once"),
    ],
)
def test_folds_that_are_none_are_refused(line, message, tmp_path):
    """One line that names the key."""
    file = tmp_path / "mine.toml"
    file.write_text(load_protocol("demo").to_toml().replace("[views]", f"[views]\n{line}"))
    with pytest.raises(ProtocolError, match=message):
        load_protocol(file)


class Rig:
    """As much of a capture as folds are made from."""

    scene = "row"

    def camera(self, name):
        """Cameras in a row by their numbers."""
        return camera_at(float(name.removeprefix("cam")), name=name)


def test_cameras_that_nobody_may_see_need_no_folds_of_their_own():
    """Test cameras outside the sources are out of every fit, so that one fold holds them all;
    stated folds stay.
    """
    demo = load_protocol("demo")
    assert fill_folds(demo, Rig()).views.folds == (("cam00",), ("cam03",), ("cam07",))
    assert fill_folds(with_views(demo, sources=("cam01", "cam02")), Rig()).views.folds == (
        ("cam00", "cam03", "cam07"),
    )
    mixed = fill_folds(with_views(demo, sources=("cam01", "cam03", "cam07")), Rig())
    assert mixed.views.folds == (("cam00", "cam03"), ("cam07",))
    assert fill_folds(mixed, Rig()) == mixed
