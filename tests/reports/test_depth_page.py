"""The depth page: right numbers, pictures that exist, and faults that a reader is told of."""

import json
import re
import shutil
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from urllib.parse import unquote

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ggvs_eval.camera import Camera
from ggvs_eval.capture import Capture
from ggvs_eval.colour_maps import (
    CHECKS,
    confidence_colours,
    depth_colours,
    depth_scale,
    difference_colours,
)
from ggvs_eval.depth_store import DepthJob, DepthMap, DepthStore
from ggvs_eval.errors import DepthError
from ggvs_eval.files.images import read_image
from ggvs_eval.geometry.epipolar import find_features
from ggvs_eval.geometry.rectification import rectify
from ggvs_eval.protocol import Frames
from ggvs_eval.reports.depth_page.pairs import measure_pair, pair_picture
from ggvs_eval.reports.depth_page.record import DepthRecord, StoredDepth, describe_map, resynthesise
from ggvs_eval.reports.depth_page.section import (
    examine_depth,
    find_notes,
    find_warnings,
    render_depth_page,
    summarise,
    write_depth_page,
)
from ggvs_eval.reports.report import write_report
from helpers.page_reader import PageReader
from helpers.refusals import refused
from helpers.run_folders import RunShape, write_run
from helpers.stereo_scenes import FOCAL, PLANE, look_from, plane_depth, see_plane, write_capture

FILLED = 0.02
PAIRED = (("cam00", ("cam01", "cam03")), ("cam00", ("cam02",)), ("cam02", ("cam00", "cam01")))
JOBS = tuple(
    DepthJob(name, partners, spec={"number": number})
    for number, (name, partners) in enumerate(PAIRED)
)
NASTY = '<script>alert("x")</script> & "quoted" #1'


def exact_map(camera: Camera, frame: int) -> DepthMap:
    """Exact depth of the plane; a tenth of the rows is empty, the next fifth is filled, the rest
    measured.
    """
    depth = plane_depth(camera, PLANE - [0, 0, 0.2 * frame]).astype(np.float32)
    confidence = np.full(depth.shape, 0.75, np.float32)
    depth[:15], confidence[:15] = 0, 0
    confidence[15:45] = FILLED
    return DepthMap(depth, confidence)


def fill_store(store: DepthStore, capture: Capture) -> list[StoredDepth]:
    """Depth of three jobs at three instants; the second one measured less."""
    stored = [StoredDepth(job, (0, 1, 2)) for job in JOBS]
    for number, each in enumerate(stored):
        for frame in each.frames:
            depth_map = exact_map(capture.camera(each.job.camera_name), frame)
            if number == 1:
                depth_map.depth[45:60], depth_map.confidence[45:60] = 0, 0
            store.write(each.job.key, frame, depth_map)
    return stored


@pytest.fixture(scope="module")
def plane_capture(tmp_path_factory) -> Capture:
    return write_capture(tmp_path_factory.mktemp("capture") / "plane")


@pytest.fixture(scope="module")
def stored(plane_capture, tmp_path_factory) -> tuple[DepthStore, list[StoredDepth]]:
    store = DepthStore(tmp_path_factory.mktemp("store"))
    return store, fill_store(store, plane_capture)


@pytest.fixture(scope="module")
def page(plane_capture, stored, tmp_path_factory) -> Path:
    """A page, by one process; nobody changes it."""
    store, depths = stored
    return write_depth_page(
        tmp_path_factory.mktemp("run") / "depth_page", plane_capture, depths, store, FILLED, 1
    )


@pytest.fixture(scope="module")
def record(plane_capture, stored, tmp_path_factory) -> DepthRecord:
    store, depths = stored
    with ThreadPoolExecutor(1) as pool:
        return examine_depth(
            pool, tmp_path_factory.mktemp("pictures"), plane_capture, depths, store, FILLED
        )


def faulty(capture: Capture, name: str, tilt_px: float) -> Capture:
    """The capture with one camera written down as tilted by so many pixels."""
    tilt = np.eye(4)
    tilt[:3, :3] = Rotation.from_rotvec([tilt_px / FOCAL, 0, 0]).as_matrix()
    cameras = [
        replace(camera, world_to_camera=tilt @ camera.world_to_camera)
        if camera.name == name
        else camera
        for camera in capture.cameras
    ]
    return replace(capture, cameras=tuple(cameras))


@pytest.mark.slow
def test_page_loads_its_pictures_and_nothing_else(page):
    """Every address is a picture that exists, small and loaded when needed, or a place in the page;
    own scripts alone run.
    """
    text = page.read_text(encoding="utf-8")
    reader = PageReader(text)
    pictures = {address for address in reader.addresses if not address.startswith("#")}
    assert pictures == {f"pictures/{file.name}" for file in (page.parent / "pictures").iterdir()}
    assert all(
        f'id="{unquote(address[1:])}"' in text
        for address in reader.addresses
        if address.startswith("#")
    )
    assert not {"link", "iframe", "object", "base"} & set(reader.tags)
    assert not re.search(r"url\(|@import|https?:", text)
    assert "default-src 'none'" in text
    assert "script-src 'sha256-" in text
    images = re.findall(r'<img[^>]* src="([^"]+)" width="(\d+)" height="(\d+)"[^>]*>', text)
    assert len(images) == text.count("<img") == text.count('loading="lazy"')
    # two cameras, three instants, the image twice; cam00 is shown with one partner
    assert len(images) == 2 * 3 * 6 + 3
    for file, width, height in images:
        assert read_image(page.parent / file).shape == (int(height), int(width), 3)
        assert int(width) <= 640
    assert (
        sum(file.stat().st_size for file in (page.parent / "pictures").iterdir())
        < len(images) * 40_000
    )


@pytest.mark.slow
def test_report_of_the_run_has_it_as_a_sheet(page, tmp_path):
    """With pictures where the page may name the run folder, with numbers alone elsewhere."""
    shape = RunShape(views=("cam00",), metrics=("PSNR",), frames=Frames(0, 1), poses=0)
    run = write_run(tmp_path / "run", shape)
    shutil.copytree(page.parent, run / "depth_page")
    report = write_report([run], with_figures=False)
    text = report.read_text(encoding="utf-8")
    pictures = {address for address in PageReader(text).addresses if "/pictures/" in address}
    assert pictures
    assert all((report.parent / address).is_file() for address in pictures)
    assert "cam00 with cam02: matched with cam02 alone" in text
    alone = write_report([run], tmp_path, with_figures=False, standalone=True).read_text(
        encoding="utf-8"
    )
    assert "cam00 with cam02: matched with cam02 alone" in alone
    assert "/pictures/" not in alone


@pytest.mark.slow
def test_numbers_are_those_of_the_store(page, record):
    """Shares of pixels, confidence and depth are those of the maps, in the page and in the file
    beside it.
    """
    told = json.loads((page.parent / "index.json").read_text())
    assert [camera["name"] for camera in told["cameras"]] == ["cam00", "cam02"]
    whole = record.cameras[1].jobs[0][1][1]
    assert (whole.frame, whole.measured, whole.filled, whole.empty) == pytest.approx(
        (1, 0.7, 0.2, 0.1)
    )
    assert whole.confidence == pytest.approx(0.75, abs=0.003)
    truth = plane_depth(look_from(-0.4, 0, "cam02"), PLANE - [0, 0, 0.2])[45:]
    assert whole.median == pytest.approx(np.median(truth), rel=1e-4)
    assert whole.near == pytest.approx(np.percentile(truth, 1), rel=1e-3)
    assert whole.far == pytest.approx(np.percentile(truth, 99), rel=1e-3)
    text = " ".join(page.read_text().split())
    assert "70 % of the pixels measured, median 0.75" in text
    assert "20 % filled in" in text
    assert "10 % empty" in text


def test_a_camera_is_pictured_where_it_measured_least(record):
    """Of several sets of partners, the pictures are of the one with the fewest measured pixels; all
    stand in the table.
    """
    camera = record.cameras[0]
    assert [stored.job.partner_names for stored, _ in camera.jobs] == [
        ("cam01", "cam03"),
        ("cam02",),
    ]
    assert camera.pictures.partners == ("cam02",)
    assert [pair.partner for pair in camera.pictures.pairs] == ["cam02"]
    assert camera.jobs[1][1][0].measured == pytest.approx(0.6)


def test_sound_capture_raises_no_alarm(record):
    """Right depth and calibration: rows within a third of a pixel, images made again well, one
    warning: a single partner.
    """
    assert {(pair.camera, pair.partner) for pair in record.pairs} == {
        ("cam00", "cam01"),
        ("cam00", "cam03"),
        ("cam00", "cam02"),
        ("cam02", "cam01"),
    }
    assert all(
        pair.matches > 50 and pair.row_px < 0.3 and pair.outside < 0.02 for pair in record.pairs
    )
    for instant in (instant for camera in record.cameras for instant in camera.pictures.instants):
        assert instant.again.error < 3
        assert instant.again.covered > 0.6
        assert instant.again.gain == pytest.approx((1, 1, 1), abs=0.02)
    (warning,) = find_warnings(record)
    assert warning.startswith("cam00 with cam02: matched with cam02 alone")
    assert find_notes(record) == ["No camera is matched with cam04."]


@pytest.mark.slow
def test_wrong_calibration_is_told(plane_capture, stored, tmp_path):
    """A camera that is written down tilted by 3 px is 3 px off the rows of those beside it, and the
    page says so first.
    """
    store, depths = stored
    with ThreadPoolExecutor(1) as pool:
        found = examine_depth(
            pool, tmp_path, faulty(plane_capture, "cam02", 3.0), depths, store, FILLED
        )
    rows = {(pair.camera, pair.partner): pair.row_px for pair in found.pairs}
    assert rows["cam00", "cam02"] == pytest.approx(3, abs=0.2)
    assert rows["cam02", "cam01"] == pytest.approx(3, abs=0.2)
    assert max(rows["cam00", "cam01"], rows["cam00", "cam03"]) < 0.3
    warning = find_warnings(found)[0]
    assert "more than 1 px (median) in 2 of 4 pairs" in warning
    assert set(re.findall(r"(cam\d\d-cam\d\d) (?:2\.[89]|3\.[0-2]) px", warning)) == {
        "cam00-cam02",
        "cam02-cam01",
    }
    assert warning in PageReader(render_depth_page(summarise(found))).texts


def test_poor_depth_is_told(record):
    """Few measured pixels, little confidence, wrong colours and an image that cannot be made again
    are each told.
    """
    camera = record.cameras[1]
    (stored, statistics), instants = camera.jobs[0], camera.pictures.instants

    def told(
        measured: float = 0.7, confidence: float = 0.75, error: float = 2.0, gain: float = 1.0
    ) -> str:
        poor = tuple(replace(each, measured=measured, confidence=confidence) for each in statistics)
        again = [replace(each.again, error=error, gain=(1.0, 1.0, gain)) for each in instants]
        shown = tuple(
            replace(each, again=changed) for each, changed in zip(instants, again, strict=True)
        )
        pictures = replace(camera.pictures, instants=shown)
        return "\n".join(
            find_warnings(
                replace(
                    record, cameras=(replace(camera, jobs=((stored, poor),), pictures=pictures),)
                )
            )
        )

    assert told() == ""
    assert "cam02: only 31% of the pixels have a measured depth at frame 0" in told(measured=0.31)
    assert (
        "cam02: half of the pixels that were measured at frame 0 have a confidence below 0.3"
        in told(confidence=0.2)
    )
    assert "cam02: its colours differ from those of cam00 by a factor of 0.80" in told(gain=0.8)
    worst = replace(instants[0], again=replace(instants[0].again, error=30.0))
    bad = replace(camera, name="bad", pictures=replace(camera.pictures, instants=(worst,)))
    (outlier,) = find_warnings(replace(record, cameras=(camera, camera, bad)))
    assert outlier.startswith(
        "bad: made again from cam00 through its depth, its image differs by 30.0 of 255 levels"
    )


def test_narrow_depth_range_is_told(plane_capture):
    """Where the plane lies beyond the far end of the depth range, matches have disparities that
    nobody looks for.
    """
    camera, partner = (replace(plane_capture.camera(name), far=5.5) for name in ("cam00", "cam01"))
    features = [find_features(plane_capture.frame(name, 0)) for name in ("cam00", "cam01")]
    errors, uv = measure_pair(camera, partner, *features)
    beyond = plane_depth(camera)[tuple(uv[:, 0, ::-1].astype(int).T)] > FOCAL * 0.4 / (
        errors.d_min - 1
    )
    assert errors.d_min == np.floor(FOCAL * 1.005 * 0.4 / 5.5)
    assert errors.outside == pytest.approx(beyond.mean(), abs=0.03)
    assert 0.3 < errors.outside < 0.7
    assert (
        measure_pair(plane_capture.camera("cam00"), plane_capture.camera("cam01"), *features)[
            0
        ].outside
        < 0.02
    )


def test_too_few_matches_say_nothing(record):
    """A pair without texture has no error, and the page says that it could not be evaluated."""
    camera, partner = look_from(0, 0, "one"), look_from(0.4, 0, "other")
    blank = find_features(np.full((150, 200, 3), 90, np.uint8))
    errors, uv = measure_pair(camera, partner, blank, blank)
    assert (errors.matches, errors.row_px, len(uv)) == (0, 0.0, 0)
    unknown = replace(
        record, pairs=tuple(replace(pair, matches=0, row_px=0.0) for pair in record.pairs)
    )
    assert (
        "Of cam00-cam01, cam00-cam03, cam00-cam02, cam02-cam01 too few features match"
        in find_notes(unknown)[0]
    )
    assert "Too few matches to check the calibration" in render_depth_page(summarise(unknown))


def test_wrong_depth_shows_in_the_image_made_again():
    """Exact depth makes the image again, depth 8 % off does not, where it is off; a partner 20 %
    darker does not pass for it.
    """
    camera, other = look_from(0, 0, "camera"), look_from(0.5, 0, "other")
    depth, images = plane_depth(camera).astype(np.float32), [see_plane(camera), see_plane(other)]
    right = resynthesise(camera, depth, images[0], other, images[1])
    wrong_half = depth.copy()
    wrong_half[:, :100] *= 1.08
    wrong = resynthesise(camera, wrong_half, images[0], other, images[1])
    assert right.error < 2
    assert wrong.difference[:, 20:95].mean() > 4 * right.difference[:, 20:95].mean()
    assert wrong.difference[:, 110:].mean() < 2 * right.difference[:, 110:].mean()
    camera, other = look_from(0, 0, "camera"), look_from(0.5, 0, "other")
    depth = plane_depth(camera).astype(np.float32)
    made = resynthesise(camera, depth, see_plane(camera), other, see_plane(other, gain=0.8))
    assert made.gain == pytest.approx((1.25, 1.25, 1.25), rel=0.01)
    assert made.error < 2.5


def test_hidden_surfaces_are_not_compared():
    """A wall that a near board hides from the other camera is marked, not evaluated; what both see
    is.
    """
    camera, other = look_from(0, 0, "camera"), look_from(0.5, 0, "other")
    depth = np.full((150, 200), 8.0, np.float32)
    depth[:, 80:110] = 4.5
    # the wall on the board's left by so much is hidden from the right
    shift_px = FOCAL * 0.5 * (1 / 4.5 - 1 / 8.0)
    made = resynthesise(camera, depth, see_plane(camera), other, see_plane(other))
    hidden = slice(round(80 - shift_px) + 2, 78)
    assert made.is_seen[20:130, hidden].mean() < 0.05
    assert made.is_seen[20:130, 82:108].mean() > 0.95
    assert made.is_seen[20:130, 115:170].mean() > 0.95
    assert (made.difference[~made.is_seen] == 0).all()


def test_no_depth_at_all():
    """A map without depth has no measured pixel, and nothing is made again of it."""
    camera, other = look_from(0, 0, "camera"), look_from(0.5, 0, "other")
    empty = np.zeros((150, 200), np.float32)
    described = describe_map(3, DepthMap(empty, empty), FILLED)
    assert (described.measured, described.filled, described.empty, described.median) == (0, 0, 1, 0)
    made = resynthesise(camera, empty, see_plane(camera), other, see_plane(other))
    assert (made.covered, made.error) == (0, 0)


def test_pairs_that_cannot_be_rectified(plane_capture, stored, tmp_path):
    """A partner straight ahead, which a plane sweep can use and a rectified matcher cannot, is said
    to be one, not shown.
    """
    store, depths = stored
    ahead = look_from(0, 0, "cam01").world_to_camera.copy()
    ahead[2, 3] = -0.5
    cameras = [
        replace(camera, world_to_camera=ahead) if camera.name == "cam01" else camera
        for camera in plane_capture.cameras
    ]
    with ThreadPoolExecutor(1) as pool:
        found = examine_depth(
            pool,
            tmp_path,
            replace(plane_capture, cameras=tuple(cameras)),
            depths[:1],
            store,
            FILLED,
        )
    assert found.pairs[0].baseline == pytest.approx(0.5)
    assert [pair.partner for pair in found.cameras[0].pictures.pairs] == ["cam03"]
    assert find_notes(found)[0].startswith(
        "cam00-cam01 cannot be rectified: cameras cam00 and cam01 have no parallax"
    )
    assert find_notes(found)[0] in PageReader(render_depth_page(summarise(found))).texts


@pytest.mark.parametrize(
    ("place", "beside"),
    [
        ((0.5, 0), True),
        ((-0.5, 0), True),
        ((0, 0.5), False),
        ((0, -0.5), False),
        ((0.4, 0.2), True),
    ],
)
def test_pairs_are_shown_upright(place, beside):
    """Whatever side the partner is on, both halves show the scene upright and not mirrored."""
    camera, partner = look_from(0, 0, "camera"), look_from(*place, "partner")
    ramp = np.zeros((150, 200, 3), np.uint8)
    # right: red, down: blue
    ramp[..., 0], ramp[..., 2] = np.linspace(60, 250, 200)[None], np.linspace(60, 250, 150)[:, None]
    picture = pair_picture(
        rectify(camera, partner), camera, partner, ramp, ramp, np.zeros((0, 2, 2))
    )
    assert picture.beside == beside
    assert picture.image.shape[1] <= 640
    middle = picture.image.shape[1] // 2 if beside else picture.image.shape[0] // 2
    halves = np.split(picture.image, [middle], axis=1 if beside else 0)
    for half in halves:
        row, column = (axis.ravel() for axis in np.indices(half.shape[:2]))
        shown = (half[..., 1] < 20).ravel()  # neither a guide nor outside
        assert shown.mean() > 0.4
        red, blue = half[..., 0].ravel()[shown], half[..., 2].ravel()[shown]
        assert np.corrcoef(column[shown], red)[0, 1] > 0.8
        assert np.corrcoef(row[shown], blue)[0, 1] > 0.8


def test_colours_tell_depth_and_what_has_none():
    """Nearer is brighter, evenly in inverse depth; nothing is drawn like a pixel without depth, and
    filled ones are striped.
    """
    nearest, farthest = 2.0, 10.0
    depth = (
        (1 / np.linspace(1 / farthest, 1 / nearest, 64)).astype(np.float32)[None].repeat(32, axis=0)
    )
    grey = cv2.cvtColor(depth_colours(depth, nearest, farthest), cv2.COLOR_RGB2GRAY)[0].astype(int)
    assert (np.diff(grey) >= -1).all()
    assert grey[-1] - grey[0] > 150
    scale = depth_scale(nearest, farthest)
    assert [value for _, value in scale.ticks] == pytest.approx([10, 5, 10 / 3, 2.5, 2])
    assert (scale.gradient[0], scale.gradient[-1]) == ("#440154", "#fde724")
    known, filled = np.zeros((32, 64), bool), np.zeros((32, 64), bool)
    known[:, 16:], filled[:, 16:32] = True, True
    for picture in (
        depth_colours(np.where(known, depth, 0), nearest, farthest),
        confidence_colours(
            np.where(known, np.linspace(0, 1, 64), 0).astype(np.float32), known, filled
        ),
        difference_colours(
            np.linspace(0, 80, 64, dtype=np.float32)[None].repeat(32, axis=0), known
        ),
    ):
        assert set(np.unique(picture[:, :16])) == set(CHECKS)
        plain = picture[:, 32:].astype(int)
        assert (np.abs(plain[..., None, :] - np.array(CHECKS)[:, None]).max(axis=-1) > 20).all()
    stripes = confidence_colours(depth / 10, known, filled)[:, 16:32].reshape(-1, 3)
    assert {tuple(colour) for colour in stripes.tolist()} == {(213, 94, 0), (40, 16, 0)}


def test_names_are_harmless(record):
    """Markup in the names of scenes and cameras is shown, not obeyed."""
    named = replace(
        record,
        scene=NASTY,
        cameras=tuple(replace(camera, name="cam00") for camera in record.cameras[:1]),
    )
    reader = PageReader(render_depth_page(summarise(named)))
    assert reader.tags.count("script") == 2  # those of every page
    assert NASTY in reader.texts


def test_world_units_are_told_in_metres_too(record):
    """Where a metre is not a world unit, scales have both and the origin of the factor is named."""
    text = render_depth_page(
        summarise(replace(record, units_per_metre=10.5, units_origin="demo.json"))
    )
    assert "One metre is 10.5 world units: demo.json." in " ".join(text.split())
    low, high = record.cameras[0].pictures.depth_range
    assert f"<span>{high / 10.5:.2f} m</span>" in text
    assert f"<span>{low / 10.5:.2f} m</span>" in text
    assert not re.search(r"\d m</span>", render_depth_page(summarise(record)))


@pytest.mark.slow
def test_complete_page_is_kept_and_a_damaged_one_written_again(
    page, plane_capture, stored, tmp_path
):
    """A page of the same depth is left alone; one that lost a picture is written again, without its
    old pictures.
    """
    store, depths = stored
    folder = Path(shutil.copytree(page.parent, tmp_path / "page"))
    written_ns = (folder / "index.html").stat().st_mtime_ns
    write_depth_page(folder, plane_capture, depths, store, FILLED, 1)
    assert (folder / "index.html").stat().st_mtime_ns == written_ns
    lost = next((folder / "pictures").iterdir())
    lost.rename(folder / "pictures" / "old.jpg")
    write_depth_page(folder, plane_capture, depths, store, FILLED, 1)
    assert (folder / "index.html").read_bytes() == page.read_bytes()
    assert lost.is_file()
    assert not (folder / "pictures" / "old.jpg").exists()


def test_depth_without_partners_has_a_page(plane_capture, stored, tmp_path):
    """Depth that a sensor measured is shown alone: no pairs, nothing made again, no warning."""
    store, depths = stored
    with ThreadPoolExecutor(1) as pool:
        alone = StoredDepth(replace(depths[2].job, partner_names=()), (1,))
        found = examine_depth(pool, tmp_path, plane_capture, [alone], store, FILLED)
    assert found.cameras[0].pictures.pairs == ()
    assert found.cameras[0].pictures.instants[0].again is None
    assert find_warnings(found) == []
    assert "Matched with no camera" in render_depth_page(summarise(found))


def test_what_cannot_be_shown(plane_capture, tmp_path):
    """No depth to show, and depth that is not stored, are refused with what to do."""
    with refused(DepthError, "depth", "got none"):
        write_depth_page(tmp_path / "page", plane_capture, [], DepthStore(tmp_path), FILLED)
    with (
        ThreadPoolExecutor(1) as pool,
        pytest.raises(DepthError, match="wanted a stored depth map, got none"),
    ):
        examine_depth(
            pool,
            tmp_path,
            plane_capture,
            [StoredDepth(JOBS[0], (0,))],
            DepthStore(tmp_path / "none"),
            FILLED,
        )
