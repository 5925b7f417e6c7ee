"""What a recording says about the experiment it comes from: its cameras, where known, and its spec."""

from __future__ import annotations

import numpy as np

from vmf.data.recording.foxglove import Camera
from vmf.experiment.build import rig_model
from vmf.geometry import from_rotation_translation
from vmf.spec import Spec, spec_hash


def known_cameras(
    spec: Spec, size: tuple[int, int] | None, distortion: tuple[float, float] = (0.0, 0.0)
) -> tuple[Camera, Camera] | None:
    """Return the left and the right camera, None where nothing says what they are.

    Parameters
    ----------
    spec : the experiment.
    size : (width, height) of the images in px, None where that is not known.
    distortion : of both lenses, k1 and k2.
    """
    model = rig_model(spec)
    if model is None or size is None:
        return None
    R, p = np.asarray(model.R_camera_from_S), np.asarray(model.p_left_in_S)
    centres = p, p + model.baseline_m * R[0]
    left, right = (
        Camera(np.asarray(K), distortion, size, from_rotation_translation(R.T, centre))
        for K, centre in zip((model.K_left, model.K_right), centres, strict=True)
    )
    return left, right


def about(spec: Spec) -> dict[str, str]:
    """Return what is to be said beside an attached spec."""
    return {"spec_hash": spec_hash(spec)}
