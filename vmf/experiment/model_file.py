"""The trained model on disk: `model.npz`, versioned, without pickle."""

from __future__ import annotations

import io
import struct
import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vmf.errors import InputError
from vmf.experiment.atomic import write_bytes
from vmf.experiment.build import build_learner, check_solver
from vmf.learn import Learner
from vmf.regular_file import open_regular
from vmf.spec import Spec, dump, loads

FORMAT = 2
_HEADER = ("vmf.format", "vmf.spec")
# What numpy, zipfile and zlib raise where bits are wrong.
_DAMAGE = (
    ValueError,
    OSError,
    EOFError,
    KeyError,
    MemoryError,
    OverflowError,
    RuntimeError,  # NotImplementedError among them
    struct.error,
    zipfile.BadZipFile,
    zlib.error,
)


@dataclass(frozen=True)
class Model:
    """A trained learner and the spec it was made from."""

    spec: Spec
    learner: Learner


def save(path: Path, model: Model) -> None:
    """Write a model atomically."""
    write_bytes(path, to_bytes(model))


def to_bytes(model: Model) -> bytes:
    """Return the content of a model's file; the same model always gives the same bytes."""
    arrays: dict[str, NDArray[Any]] = {
        "vmf.format": np.array(FORMAT),
        "vmf.spec": np.array(dump(model.spec)),
        **model.learner.state(),
    }
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, array in arrays.items():
            member = io.BytesIO()
            np.lib.format.write_array(member, np.asanyarray(array), allow_pickle=False)
            info = zipfile.ZipInfo(f"{name}.npy", (1980, 1, 1, 0, 0, 0))
            archive.writestr(info, member.getvalue(), zipfile.ZIP_DEFLATED)
    return buffer.getvalue()


def load(path: Path) -> Model:
    """Read a model.

    Raises
    ------
    InputError : missing, not a model, of an unknown version, or with arrays that do not fit the spec.
    """
    try:
        with open_regular(path) as file:
            opened = np.load(file, allow_pickle=False)
            if not isinstance(opened, np.lib.npyio.NpzFile):
                raise ValueError("a single array")
            with opened as archive:
                arrays = {name: archive[name] for name in archive.files}
    except (FileNotFoundError, IsADirectoryError):
        raise InputError(f"{path}: no such file, a model.npz written by `vmf train` is expected") from None
    except _DAMAGE as error:
        # NumPy takes whatever it does not know for a pickle, and says how to load it all the same.
        what = "not one, or with Python objects in it" if "pickle" in str(error) else error
        raise InputError(f"{path}: not a readable model.npz ({what})") from error
    if any(name not in arrays for name in _HEADER):
        raise InputError(f"{path}: an .npz file, but not one written by `vmf train`")
    version = arrays["vmf.format"]
    if version.shape != () or version.dtype.kind not in "iu" or int(version) != FORMAT:
        raise InputError(f"{path}: found format version {version}, {FORMAT} is accepted")
    spec = loads(str(arrays["vmf.spec"]), f"{path}: spec").spec
    learner = build_learner(spec)
    try:
        learner.restore(arrays)
    except (KeyError, ValueError, IndexError, TypeError) as error:
        raise InputError(f"{path}: arrays do not fit the model's spec ({error})") from error
    return Model(spec, learner)


def overridden(
    model: Model, overrides: Sequence[str], accepted: Sequence[str], closed: Sequence[str] = ()
) -> Spec:
    """Return the model's spec with other settings for what may be asked differently of a trained model.

    Parameters
    ----------
    model : the model.
    overrides : dotted settings.
    accepted : sections that may change.
    closed : keys in them that may not.

    Raises
    ------
    InputError : an override is wrong, or one that a trained model cannot take.
    """
    for override in overrides:
        key = override.split("=", 1)[0]
        if (key.split(".")[0] not in accepted or key in closed) and "=" in override:
            raise InputError(
                f"command line: {override}: a trained model cannot change this, "
                f"accepted: {', '.join(f'{name}.…' for name in accepted if name != 'name')}"
            )
    spec = loads(dump(model.spec), "model.npz: spec", overrides).spec
    check_solver(spec)
    return spec
