"""Figures of runs as parts of the page: no wider than it needs, with no more colours than they have."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

from PIL import Image

from vmf.errors import InputError

# Twice the width of the page's text: sharp on fine screens and in print.
WIDTH_PX = 1400
COLOURS = 128

SHOWS = {
    "truth_vs_estimate": "True and estimated motion over the last frames that were asked about",
    "absolute_error": "Absolute error of one trial against frames learned",
    "mean_std_error": "Mean and standard deviation of the absolute error over trials against frames learned",
    "comparison_trained_code": "Distribution of the errors of every method at the trained code",
    "comparison_held_out": "Distribution of the errors of every method on new targets at new poses",
    "paired_differences": "Paired differences of every method's errors from vmf's",
    "calibration_crossover": "Median error of reconstruction against its calibration's error, beside vmf's",
    "odometry": "The motion’s r11, r21, tx and ty by the function and by odometry, and their difference",
    "condition_number": "Condition number of a tile's equations against frames learned",
    "update_map": "How often the tiles of each pixel of both images were updated",
}


@dataclass(frozen=True)
class Picture:
    """A figure in the page: its content as a data URI, its size in px and what it shows."""

    uri: str
    width: int
    height: int
    shows: str
    name: str


def decoded(path: Path) -> Image.Image:
    """Return the pixels of a run's figure (PNG); raises `InputError` if it is damaged."""
    try:
        with Image.open(path) as opened:
            return opened.convert("RGB")
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise InputError(f"{path}: damaged, a figure (PNG) of a finished run is expected") from error


def picture(path: Path, shows: str = "") -> Picture:
    """Return a run's figure (PNG) as it goes into the page; raises `InputError` if it is damaged."""
    image = decoded(path)
    if image.width > WIDTH_PX:
        height = round(image.height * WIDTH_PX / image.width)
        image = image.resize((WIDTH_PX, height), Image.Resampling.LANCZOS)
    small = image.quantize(COLOURS, Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
    buffer = BytesIO()
    small.save(buffer, "PNG")
    uri = "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode()
    said = shows or SHOWS.get(path.stem, path.stem.replace("_", " ").capitalize())
    return Picture(uri, image.width, image.height, said, path.stem)
