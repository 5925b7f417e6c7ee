"""Stereo codes that two cameras can see, the bounds on their number, and the tiles of a CMAC (§4.1, §5.1)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.optimize import linprog

from vmf.approximate import Tiling
from vmf.spec.studies import ImageSize, LineCamera, LineRig, StereoCodesStudy
from vmf.study.result import Quantity, StudyResult

Floats = NDArray[np.float64]

# Regions that no disc of this radius (m) fits into are borders that two pixels share.
_THICKNESS_M = 1e-9


@dataclass(frozen=True)
class LinePixels:
    """The pixels of a line camera as wedges of the plane (x, z).

    Attributes
    ----------
    centre : (2,) in m.
    edges : (n + 1, 2) unit vectors between which the pixels lie, from left to right.
    """

    centre: Floats
    edges: Floats

    @classmethod
    def of(cls, camera: LineCamera, pixels: int, field_of_view_deg: float) -> LinePixels:
        """Return the pixels of a pinhole camera: of equal width on its image line."""
        half = math.tan(math.radians(field_of_view_deg) / 2)
        angle = math.radians(camera.heading_deg) - np.arctan(np.linspace(-half, half, pixels + 1))
        return cls(np.array([camera.x_m, camera.z_m]), np.stack([np.cos(angle), np.sin(angle)], axis=-1))

    def half_planes(self, pixel: int) -> tuple[Floats, Floats]:
        """Return inward unit normals N (2, 2) and offsets d (2,): a pixel sees the points with `N p ≥ d`."""
        first, last = self.edges[pixel], self.edges[pixel + 1]
        normals = np.array([[first[1], -first[0]], [-last[1], last[0]]])
        return normals, normals @ self.centre


def line_pixels(rig: LineRig, settings: StereoCodesStudy) -> tuple[LinePixels, LinePixels]:
    """Return the pixels of both cameras of a rig."""
    n, angle = settings.pixels, settings.field_of_view_deg
    return LinePixels.of(rig.left, n, angle), LinePixels.of(rig.right, n, angle)


def visible_codes(left: LinePixels, right: LinePixels) -> NDArray[np.bool_]:
    """Return which codes (n, n) of left and right pixels some points of the plane have."""
    n = len(left.edges) - 1
    return np.array([[_inscribed_m(left, right, i, j) > _THICKNESS_M for j in range(n)] for i in range(n)])


def _inscribed_m(left: LinePixels, right: LinePixels, i: int, j: int) -> float:
    """Return the radius of the largest disc that both pixels see, at most 1 m: a linear programme."""
    (N_L, d_L), (N_R, d_R) = left.half_planes(i), right.half_planes(j)
    A = np.column_stack([-np.concatenate([N_L, N_R]), np.ones(4)])
    found = linprog(
        [0.0, 0.0, -1.0],
        A_ub=A,
        b_ub=-np.concatenate([d_L, d_R]),
        bounds=[(None, None), (None, None), (0.0, 1.0)],
    )
    return 0.0 if found.x is None else float(found.x[2])


def visible_region(left: LinePixels, right: LinePixels, i: int, j: int, view: Floats) -> Floats:
    """Return the corners (m, 2) of what both pixels see of a convex polygon `view` (n, 2)."""
    corners = view
    for pixels, pixel in ((left, i), (right, j)):
        for normal, offset in zip(*pixels.half_planes(pixel), strict=True):
            corners = _cut(corners, normal, offset)
    return corners


def _cut(corners: Floats, normal: Floats, offset: float) -> Floats:
    """Return a convex polygon without what lies outside of a half plane (Sutherland and Hodgman 1974)."""
    if len(corners) == 0:
        return corners
    inside = corners @ normal - offset
    kept = []
    for k in range(len(corners)):
        here, there = inside[k - 1], inside[k]
        if (here < 0) != (there < 0):
            kept.append(corners[k - 1] + (corners[k] - corners[k - 1]) * here / (here - there))
        if there >= 0:
            kept.append(corners[k])
    return np.array(kept).reshape(-1, 2)


def stereo_codes(settings: StereoCodesStudy) -> StudyResult:
    """Count visible codes, bound their number, and count tiles."""
    from vmf.study.figures.stereo_codes import draw_codes, draw_rigs

    quantities, rows = [], []
    seen = {}
    total = settings.pixels**2
    for rig in settings.rigs:
        codes = seen[rig.name] = visible_codes(*line_pixels(rig, settings))
        count = int(codes.sum())
        quantities += [
            Quantity("visible_codes", count, rig.name, n=total),
            Quantity("unused_share", 1.0 - count / total, rig.name, n=total),
        ]
        rows += [(rig.name, int(i), int(j), bool(codes[i, j])) for i, j in np.ndindex(codes.shape)]
    for size in settings.images:
        quantities += _of_images(size, settings)
    table = pd.DataFrame(rows, columns=["rig", "left_px", "right_px", "visible"])
    drawings = {
        "line_rigs": partial(draw_rigs, settings, seen),
        "code_tables": partial(draw_codes, settings, seen),
    }
    return StudyResult(tuple(quantities), {"codes": table}, drawings)


def _of_images(size: ImageSize, settings: StereoCodesStudy) -> list[Quantity]:
    """Return codes, bounds and tiles of a pair of images."""
    width, height = size.width_px, size.height_px
    case, codes = f"{width}x{height}", (width * height) ** 2
    # Each pixel has an epipolar line, no longer than the diagonal; a row where the images are registered.
    bound, registered = width * height * math.hypot(width, height), width * height * width
    overlays = size.overlays or settings.overlays
    tiling = Tiling(overlays, size.tile_px or settings.tile_px, "diagonal")
    grid = math.ceil(width / tiling.tile_px) * math.ceil(height / tiling.tile_px)
    return [
        Quantity("codes", codes, case),
        Quantity("codes_bound", bound, case),
        Quantity("codes_bound_share", 100.0 * bound / codes, case, unit="%"),
        Quantity("codes_bound_registered", registered, case),
        Quantity("visible_codes_parallel", height * parallel_codes(width), case),
        Quantity("image_points", width * height, case),
        Quantity("tile_combinations", _combinations(width, tiling) * _combinations(height, tiling), case),
        Quantity("tiles_per_overlay", grid, case),
        Quantity("tiles_per_image", overlays * grid, case),
        Quantity("tiles_per_image_displaced", displaced_tiles(width, height, tiling), case),
    ]


def parallel_codes(width: int) -> int:
    """Return how many codes of a row a parallel rig sees when points may be at any depth.

    A point is farther left in the right image, so pixel i of the left row meets the pixels 0…i of the right.
    """
    return width * (width + 1) // 2


def displaced_tiles(width: int, height: int, tiling: Tiling) -> int:
    """Return how many tiles the pixels of an image touch on all overlays, displaced along the diagonal.

    The thesis multiplies the tiles of the one overlay that is not displaced; the others are cut by the image
    and have a row and a column more.
    """
    across, down = (np.ptp(_cells(length, tiling), axis=0) + 1 for length in (width, height))
    return int((across * down).sum())


def _combinations(length: int, tiling: Tiling) -> int:
    """Return how many of a row's pixels the tiles of all overlays tell apart.

    Overlays are displaced by as much on both axes, so that columns and rows are told apart by themselves.
    """
    return len(np.unique(_cells(length, tiling), axis=0))


def _cells(length: int, tiling: Tiling) -> NDArray[np.int64]:
    """Return the tile (length, T) of every pixel of a row on every overlay."""
    return tiling.cells(np.repeat(np.arange(length, dtype=float)[:, None], 4, axis=1))[..., 0]
