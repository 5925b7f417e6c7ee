"""The studies by kind: one line each."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

from vmf.spec.studies import AnyStudy
from vmf.study.approximators import approximators
from vmf.study.cmac_parameters import cmac_parameters
from vmf.study.feedback import feedback
from vmf.study.joint_space import joint_space
from vmf.study.kaczmarz import kaczmarz
from vmf.study.planar_sift import planar_sift
from vmf.study.result import StudyResult
from vmf.study.stereo_codes import stereo_codes

# Each takes the settings of its own kind.
STUDIES: Mapping[str, Callable[[Any], StudyResult]] = MappingProxyType(
    {
        "stereo_codes": stereo_codes,
        "cmac_parameters": cmac_parameters,
        "planar_sift": planar_sift,
        "approximators": approximators,
        "kaczmarz": kaczmarz,
        "feedback": feedback,
        "joint_space": joint_space,
    }
)


def carry_out(settings: AnyStudy) -> StudyResult:
    """Return what the study of these settings finds.

    Raises
    ------
    InputError : the settings leave nothing to study.
    """
    return STUDIES[settings.kind](settings)
