"""Bundle adjustment of matched features by pycolmap: the script of a `SideProcess`, since it breaks
the writing of PNG files.
"""

from typing import Any

# of triangulation and adjustment: after each, points that cameras miss by more are dropped
ROUNDS_PX = (8.0, 4.0, 2.0)
LEAST_ANGLE_DEG = 1.0  # of a point's rays
LOSS_PX = 1.0  # beyond which errors count linearly
ITERATIONS, TOLERANCE = 50, 1e-5  # of an adjustment; share of the cost below which it has converged


def adjust(rig: dict[str, Any]) -> dict[str, Any]:
    """Triangulate what cameras share, and adjust poses and points together, in a free world.

    Args:
        rig: ``focal``: of each lens, pixels; ``cameras``: of each the number of its lens, its pose
            (3, 4), world to camera, and its features (N, 2), pixels from the principal point;
            ``matches``: two cameras and the numbers of their features (M, 2); ``free_focal``:
            adjust focal lengths too.

    Returns:
        ``focal``, ``poses`` (3, 4), ``points_seen`` by each camera, and ``n_points``.

    Reading:
        Lenses and points in one thread: equal features give equal cameras.
    """
    import pycolmap

    model, graph = pycolmap.Reconstruction(), pycolmap.CorrespondenceGraph()
    for lens_id, focal_px in enumerate(rig["focal"], start=1):
        # any: a lens whose picture is far smaller than its focal length is refused
        size = round(focal_px)
        lens = pycolmap.Camera(
            model="SIMPLE_PINHOLE",
            width=size,
            height=size,
            params=[focal_px, 0, 0],
            camera_id=lens_id,
        )
        model.add_camera_with_trivial_rig(lens)
    for image_id, (lens, pose, features) in enumerate(rig["cameras"], start=1):
        points = pycolmap.Point2DList([pycolmap.Point2D(uv) for uv in features])
        image = pycolmap.Image(
            name=str(image_id), image_id=image_id, camera_id=lens + 1, points2D=points
        )
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pose))
        graph.add_image(image_id, len(features))
    is_verified = pycolmap.TwoViewGeometryConfiguration.CALIBRATED
    for first, second, matches in rig["matches"]:
        geometry = pycolmap.TwoViewGeometry(config=is_verified, inlier_matches=matches)
        graph.add_two_view_geometry(first + 1, second + 1, geometry)
    graph.finalize()
    observations = pycolmap.ObservationManager(model, graph)
    triangulator = pycolmap.IncrementalTriangulator(graph, model, observations)
    searching = pycolmap.IncrementalTriangulatorOptions()
    searching.min_angle, searching.ignore_two_view_tracks = LEAST_ANGLE_DEG, False
    adjusting = pycolmap.BundleAdjustmentOptions(
        refine_focal_length=rig["free_focal"], print_summary=False
    )
    adjusting.ceres.loss_function_type, adjusting.ceres.loss_function_scale = (
        pycolmap.LossFunctionType.SOFT_L1,
        LOSS_PX,
    )
    solver = adjusting.ceres.solver_options
    solver.num_threads, solver.max_num_iterations, solver.function_tolerance = (
        1,
        ITERATIONS,
        TOLERANCE,
    )
    for largest_px in ROUNDS_PX:
        for image_id in sorted(model.images):
            triangulator.triangulate_image(searching, image_id)
        triangulator.complete_all_tracks(searching)
        triangulator.merge_all_tracks(searching)
        pycolmap.bundle_adjustment(model, adjusting)
        observations.filter_all_points3D(largest_px, LEAST_ANGLE_DEG)
    images = [model.images[image_id] for image_id in sorted(model.images)]
    return {
        "focal": [model.cameras[lens_id].params[0] for lens_id in sorted(model.cameras)],
        "poses": [image.cam_from_world().matrix() for image in images],
        "points_seen": [image.num_points3D for image in images],
        "n_points": model.num_points3D(),
    }


if __name__ == "__main__":
    from ggvs_eval.side_process import serve

    serve(adjust)
