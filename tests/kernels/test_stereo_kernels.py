"""The kernels of the plane sweep against their twins in numpy, and what they refuse."""

from itertools import product

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ggvs_eval import kernels
from ggvs_eval.kernels import _stereo
from helpers.refusals import refused
from helpers.twins.plane_sweep import sweep_twin
from helpers.twins.refinement import look_up, refine_twin
from helpers.twins.sgm import aggregate_twin, median_twin

LEVEL = kernels.SIMD_LEVELS.index(kernels.get_simd_level())
WINDOW = (2, 20.0, 1.5, 0.5)
PLANES = (0.1, 0.01, 32)
seeds = st.integers(0, 2**32 - 1)


def smooth_noise(random, height, width):
    """Band-limited grey values around 0, float32."""
    noise = random.normal(0, 40, (height + 2, width + 2))
    return (
        (
            noise[1:-1, 1:-1]
            + noise[:-2, 1:-1]
            + noise[2:, 1:-1]
            + noise[1:-1, :-2]
            + noise[1:-1, 2:]
        )
        / 3
    ).astype(np.float32)


def sweep_inputs(seed, height=21, width=70, n_partners=3, *, visible=True):
    """A reference and partners of other sizes, which see parts of it, near planes from too near."""
    random = np.random.default_rng(seed)
    guide = random.integers(0, 256, (height, width, 3)).astype(np.uint8)
    # one half with strong edges, one without
    guide[:, width // 2 :] = guide[:, width // 2 :] // 16 + 100
    partners = []
    for _ in range(n_partners):
        rows, columns = random.integers(2, 40), random.integers(2, 90)
        first = random.integers(0, max(columns // 3, 1), rows).astype(np.float32)
        last = random.integers(-1, columns, rows).astype(np.float32)
        seen = (random.random((height, width)) < 0.7).astype(np.uint8) if visible else None
        motion = np.concatenate(
            [
                random.uniform(-9, 3, 2),
                random.uniform(-60, 60, 2),
                random.uniform(0, 9, 2),
                [random.uniform(-2, 4)],
            ]
        )
        partners.append(
            (smooth_noise(random, rows, columns), first, last, seen, motion.astype(np.float32))
        )
    return smooth_noise(random, height, width), guide, partners


def all_planes(height, width, count=PLANES[2]):
    """Ranges that leave nothing out."""
    columns, rows = _stereo.TILE_SIZE
    return np.tile(np.array([0, count], np.int32), (-(-height // rows), -(-width // columns), 1))


def sweep(
    reference, guide, partners, ranges=None, threads=2, level=LEVEL, window=WINDOW, planes=PLANES
):
    ranges = all_planes(*reference.shape, planes[2]) if ranges is None else ranges
    return _stereo.sweep_planes(
        reference, guide, partners, window, 0.05, planes, ranges, threads, level
    )


def matching_inputs(seed, height=12, width=15, planes=32):
    """Costs and a guide of random bytes, and penalties that just fit."""
    random = np.random.default_rng(seed)
    costs = random.integers(0, _stereo.COST_LIMIT + 1, (height, width, planes)).astype(np.uint8)
    large = random.integers(0, 121, 256).astype(np.uint8)
    return costs, random.integers(0, 256, (height, width)).astype(np.uint8), 8, large


@settings(deadline=None, max_examples=8)
@given(
    seeds,
    st.integers(1, 35),
    st.integers(1, 140),
    st.integers(1, 5),
    st.integers(1, 3),
    st.booleans(),
)
def test_costs_agree_with_their_twin(seed, height, width, n_partners, radius, visible):
    """Any sizes, partners and windows give the twin's costs to one grey level, single pixels at
    borders apart.
    """
    inputs = sweep_inputs(seed, height, width, n_partners, visible=visible)
    window = (radius, *WINDOW[1:])
    ours, theirs = sweep(*inputs, window=window), sweep_twin(*inputs, window, 0.05, PLANES)
    assert (np.abs(ours.astype(int) - theirs) > 1).mean() <= 0.002


def test_a_shifted_image_costs_nothing_on_its_plane():
    """A partner that shows the reference 5 px further left fits perfectly on the plane of 5 px of
    parallax, and on no other.
    """
    random = np.random.default_rng(0)
    wide, guide = smooth_noise(random, 30, 100), np.full((30, 90, 3), 128, np.uint8)
    reference = np.ascontiguousarray(wide[:, :90])
    every, rows = np.zeros(30, np.float32), np.full(30, 89, np.float32)
    motion = np.array([0, 0, 100, 0, 0, 0, 0], np.float32)  # 1 px for each plane
    partner = (np.ascontiguousarray(np.roll(reference, 5, axis=1)), every, rows, None, motion)
    costs = sweep(reference, guide, [partner], planes=(0.0, 0.01, 32))
    assert (costs[2:-2, 8:80, 5] == 0).all()
    assert np.delete(costs[2:-2, 8:58], 5, axis=-1).min() > 10


def test_planes_outside_the_ranges_cost_most():
    """What is not worth a look is not looked at; what is has the same costs as ever; wild ranges
    are taken as far as they go.
    """
    inputs = sweep_inputs(3)
    ranges = all_planes(21, 70)
    ranges[0, 0], ranges[1, 1] = (5, 9), (-(2**31), 2**31 - 1)
    partly, whole = sweep(*inputs, ranges), sweep(*inputs)
    columns, rows = _stereo.TILE_SIZE
    tile = partly[:rows, :columns]
    assert np.array_equal(tile[..., 5:9], whole[:rows, :columns, 5:9])
    assert (np.delete(tile, np.s_[5:9], axis=-1) == _stereo.COST_LIMIT).all()
    assert np.array_equal(partly[rows:, columns:], whole[rows:, columns:])


@settings(deadline=None, max_examples=10)
@given(seeds, st.integers(1, 9), st.integers(1, 9), st.sampled_from([32, 64]))
def test_matching_agrees_with_its_twin(seed, height, width, planes):
    """Surface and margin are the twin's, to the bit."""
    inputs = matching_inputs(seed, height, width, planes)
    for ours, theirs in zip(
        _stereo.aggregate(*inputs, 2, LEVEL), aggregate_twin(*inputs), strict=True
    ):
        assert np.array_equal(ours, theirs)


def grey_pair(seed, height, width, shift=5):
    """A picture and itself moved to the left, with noise; coarse grey values, so that costs are
    often equal.
    """
    random = np.random.default_rng(seed)
    picture = cv2.GaussianBlur(
        random.integers(0, 256, (height, width + shift)).astype(np.uint8),
        (0, 0),
        random.uniform(0.5, 3),
    )
    step = np.uint8(random.choice([1, 4, 16]))
    left, right = (picture[:, first : first + width] // step * step for first in (0, shift))
    return np.ascontiguousarray(left), np.maximum(
        right, random.integers(0, 9, right.shape).astype(np.uint8)
    )


def opencv_blocks(left, right, count, radius, small, large):
    """Disparity by OpenCV, which takes its median behind."""
    matcher = cv2.StereoSGBM.create(
        0,
        count,
        2 * radius + 1,
        small,
        large,
        disp12MaxDiff=-1,
        mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )
    return matcher.compute(left, right)


@settings(deadline=None, max_examples=40)
@given(
    seeds,
    st.integers(24, 70),
    st.integers(4, 90),
    st.integers(1, 6),
    st.integers(1, 3),
    st.integers(1, 8),
)
def test_blocks_are_matched_as_by_opencv(seed, height, columns, sixteens, radius, small):
    """Any size but a tiny one, where OpenCV's stripes shift, gives OpenCV's disparities, to the
    bit, even of equal costs.
    """
    count, area = 16 * sixteens, (2 * radius + 1) ** 2
    steps = small * area, (small + 24) * area
    left, right = grey_pair(seed, height, count + columns)
    ours = _stereo.match_blocks(left, right, count, radius, *steps, 2, LEVEL)
    assert np.array_equal(
        cv2.medianBlur(ours, 3), opencv_blocks(left, right, count, radius, *steps)
    )


@pytest.mark.skipif(
    cv2.__version__ < "5",
    reason="before OpenCV 5 cv2.remap rounds places to 1/32 of a pixel, so it is no twin",
)
@settings(deadline=None, max_examples=25)
@given(seeds, st.integers(1, 30), st.integers(1, 60), st.integers(1, 8), st.integers(0, 3))
def test_refinement_agrees_with_its_twin(seed, height, width, window, iterations):
    """Any size of image and window gives what cv2.remap and cv2.blur give, to the bit where cv2
    fuses multiply-adds as we do.
    """
    random = np.random.default_rng(seed)
    left, right = random.integers(0, 256, (2, height, width)).astype(np.uint8)
    disparity = np.maximum(random.uniform(-5, 20, (height, width)), 0).astype(np.float32)
    slope = cv2.Sobel(right, cv2.CV_32F, 1, 0, ksize=3, scale=1 / 8)
    ours = _stereo.refine_matches(left, right, slope, disparity, 0.9, window, iterations, 0.5, 4.0)
    theirs = refine_twin(left, right, disparity, 0.9, window, iterations)
    rows, columns = np.indices(disparity.shape, dtype=np.float32)
    matched = look_up(right.astype(np.float32), columns - disparity, rows)
    if "FMA3" in cv2.getCPUFeaturesLine() and cv2.checkHardwareSupport(cv2.CPU_FMA3):
        assert np.array_equal(ours, theirs)
        assert np.array_equal(_stereo.sample_matches(right, disparity), matched)
    assert np.allclose(_stereo.sample_matches(right, disparity), matched, atol=1e-3)
    assert np.allclose(ours, theirs, atol=1e-2)


@settings(deadline=None, max_examples=10)
@given(seeds, st.integers(1, 12), st.integers(1, 12), st.integers(0, 4))
def test_median_agrees_with_its_twin(seed, height, width, radius):
    """Any sizes and radii give the twin's surface; ties of equal weights may fall either way."""
    random = np.random.default_rng(seed)
    surface = random.uniform(-1, 33, (height, width)).astype(np.float32)
    guide = random.integers(0, 40, (height, width, 3)).astype(np.uint8)
    ours = _stereo.weighted_median(surface, guide, 32, radius, 7.0, 5.0, 2)
    theirs = median_twin(surface, guide, 32, radius, 7.0, 5.0)
    assert (np.abs(ours - theirs) > 1e-4).sum() <= max(1, 0.02 * surface.size)


def test_median_moves_an_edge_to_that_of_the_image():
    """A depth edge two pixels beside the edge of colour goes there, and a slope stays as it is, to
    the bit.
    """
    slope = np.tile(np.linspace(5, 7, 40, dtype=np.float32), (30, 1))
    guide = np.full((30, 40, 3), 50, np.uint8)
    guide[:, 20:] = 200
    moved = slope.copy()
    moved[:, 22:] += 15
    filtered = _stereo.weighted_median(moved, guide, 64, 5, 7.0, 5.0, 1)
    assert (filtered[:, 20:22] > 18).all()
    assert np.array_equal(filtered[:, :20], slope[:, :20])
    assert np.array_equal(_stereo.weighted_median(slope, guide, 64, 5, 7.0, 5.0, 1), slope)


@pytest.mark.slow
def test_bits_depend_on_neither_threads_nor_instruction_set():
    """Costs, surface, margin and median are equal to the bit for 1, 2 and 5 threads on every
    instruction set.
    """
    for visible in (True, False):
        reference, guide, partners = sweep_inputs(7, 70, 150, 4, visible=visible)
        results = set()
        for threads, name in product((1, 2, 5), kernels.available_levels()):
            level = kernels.SIMD_LEVELS.index(name)
            costs = sweep(reference, guide, partners, threads=threads, level=level)
            surface, margin = _stereo.aggregate(
                costs, guide[..., 0].copy(), 8, np.full(256, 70, np.uint8), threads, level
            )
            median = _stereo.weighted_median(surface, guide, 32, 5, 7.0, 5.0, threads)
            blocks = _stereo.match_blocks(*grey_pair(7, 50, 150), 48, 1, 72, 288, threads, level)
            results.add(
                tuple(array.tobytes() for array in (costs, surface, margin, median, blocks))
            )
        assert len(results) == 1


def test_more_threads_than_rows():
    """Fewer rows, tiles and columns than threads, down to one pixel, end and give the same."""
    for height, width in ((1, 1), (2, 1), (1, 130), (3, 64)):
        inputs = matching_inputs(1, height, width)
        surfaces = {
            _stereo.aggregate(*inputs, threads, LEVEL)[0].tobytes() for threads in (1, 2, 5, 16)
        }
        assert len(surfaces) == 1


def test_what_is_no_number_is_no_vote():
    """NaN and infinities in images, motion and borders: no crash, costs within their limits,
    halfway where nobody votes.
    """
    for place, bad in product(range(5), (np.nan, np.inf, -np.inf)):
        reference, guide, partners = sweep_inputs(11, visible=False)
        for array in (reference, partners[0][0], partners[0][1], partners[0][2], partners[0][4])[
            place : place + 1
        ]:
            array[...] = bad
        assert sweep(reference, guide, partners).max() <= _stereo.COST_LIMIT
    reference, guide, partners = sweep_inputs(11, visible=False)
    halfway = round(_stereo.COST_LIMIT / 2)
    assert (sweep(np.full_like(reference, np.nan), guide, partners) == halfway).all()
    assert (sweep(reference, guide, partners, planes=(np.nan, np.nan, 32)) == halfway).all()
    surface = np.full((8, 9), np.nan, np.float32)
    surface[0, 0], surface[4, 4] = np.inf, 1e30
    assert _stereo.weighted_median(
        surface, np.zeros((8, 9, 3), np.uint8), 32, 3, 7.0, 5.0, 2
    ).shape == (8, 9)


def test_wrong_arrays_are_refused():
    """A wrong dtype, shape or layout says what was wanted and what came; nothing is copied in
    silence.
    """
    reference, guide, partners = sweep_inputs(5)
    image, first, last, visible, motion = partners[0]
    for wrong, message in (
        ((image.astype(float), first, last, visible, motion), "image: wanted float32"),
        ((image, first[:-1], last, visible, motion), "first: wanted float32"),
        ((image, first, last[:-1], visible, motion), "last: wanted float32"),
        ((image, first, last, visible[:-1], motion), r"visible: wanted uint8 \(21, 70\)"),
        (
            (image, first, last, visible, motion[:-1]),
            r"motion: wanted float32 \(7,\), C-contiguous, got float32 \(6,\)",
        ),
    ):
        with pytest.raises(TypeError, match=message):
            sweep(reference, guide, [*partners[1:], wrong])
    for other, message in (
        (guide[:-1], "guide"),
        (guide[:, ::-1], "guide: .*not C-contiguous"),
        (guide.astype(int), "guide"),
    ):
        with pytest.raises(TypeError, match=message):
            sweep(reference, other, partners)
    costs, grey, small, large = matching_inputs(0)
    left, right = grey_pair(0, 20, 50)
    flat, narrow = np.zeros((20, 50), np.float32), np.zeros((20, 49), np.float32)
    for call, *words in (
        (
            lambda: sweep(reference, guide, partners, all_planes(40, 70)[:1]),
            "ranges",
            "int32 (2, 2, 2)",
        ),
        (
            lambda: _stereo.aggregate(costs, grey[:-1], small, large, 1, LEVEL),
            "guide",
            "uint8 (12, 15)",
        ),
        (
            lambda: _stereo.aggregate(costs, grey, small, large[:-1], 1, LEVEL),
            "large_steps",
            "uint8 (256,)",
        ),
        (
            lambda: _stereo.match_blocks(left, right[1:].copy(), 32, 1, 72, 288, 1, LEVEL),
            "right",
            "uint8 (20, 50)",
        ),
        (
            lambda: _stereo.refine_matches(left, right, flat, narrow, 1, 7, 2, 0.5, 4),
            "disparity",
            "float32 (20, 50)",
        ),
    ):
        with refused(TypeError, *words):
            call()


def test_wrong_values_are_refused():
    """No partners, too many, odd numbers of planes, too large penalties, empty images: each is an
    error with its limits.
    """
    reference, guide, partners = sweep_inputs(5)
    costs, grey, _, _ = matching_inputs(0)
    left, right = grey_pair(0, 20, 50)
    flat, thin = np.zeros((20, 50), np.float32), (np.zeros((1, 5), np.float32), *partners[0][1:])

    def blocks(count: int, radius: int, small: int, large: int) -> np.ndarray:
        return _stereo.match_blocks(left, right, count, radius, small, large, 1, LEVEL)

    for call, *words in (
        *(
            (lambda many=many: sweep(reference, guide, many), "partners", "1 to 16")
            for many in ([], partners * 6)
        ),
        (lambda: sweep(reference, guide, partners, window=(4, 20, 1.5, 0.5)), "radius of 1 to 3"),
        (lambda: sweep(reference, guide, partners, window=(2, 0, 1.5, 0.5)), "positive"),
        (lambda: sweep(reference, guide, partners, window=(2, 20, 1.5, np.nan)), "positive"),
        (lambda: sweep(reference, guide, [thin]), "2 x 2"),
        (
            lambda: sweep(np.zeros((0, 5), np.float32), np.zeros((0, 5, 3), np.uint8), partners),
            "reference: wanted 1 x 1",
        ),
        (lambda: sweep(reference, guide, partners, level=7), "no such instruction set"),
        (
            lambda: _stereo.aggregate(costs, grey, 9, np.full(256, 120, np.uint8), 1, LEVEL),
            "steps",
            "at most 128",
        ),
        (lambda: _stereo.weighted_median(reference, guide, 32, -1, 7.0, 5.0, 1), "median: wanted"),
        *(
            (lambda n=n: blocks(n, 1, 72, 288), "count", "multiple of 16", "less than the width")
            for n in (0, 20, 64, -16)
        ),
        *(
            (lambda steps=steps: blocks(32, *steps), "wanted")
            for steps in ((-1, 8, 32), (1, 288, 72), (1, -1, 72))
        ),
        (lambda: blocks(32, 7, 72, 9000), "block, steps", "32767"),
        (lambda: _stereo.refine_matches(left, right, flat, flat, 1, 0, 2, 0.5, 4), "window"),
    ):
        with refused(ValueError, *words):
            call()
    for count in (0, 31, 33, 288, -32):
        with refused(ValueError, "planes", "multiple of 32", "at most 256"):
            sweep(reference, guide, partners, all_planes(21, 70), planes=(0.1, 0.01, count))


def test_disparities_that_are_no_numbers_stay_within_the_image():
    """NaN and infinities among the disparities: no crash, and grey values of the row's ends."""
    left, right = grey_pair(0, 3, 8)
    disparity = np.array([np.nan, np.inf, -np.inf, 1e30, -1e30, 1, 2, 3], np.float32) * np.ones(
        (3, 1), np.float32
    )
    matched = _stereo.sample_matches(right, disparity)
    assert np.array_equal(matched[:, 1], right[:, 0])
    assert np.array_equal(matched[:, 2], right[:, -1])
    assert _stereo.refine_matches(
        left, right, np.ones((3, 8), np.float32), disparity, 1, 7, 2, 0.5, 4
    ).shape == (3, 8)
