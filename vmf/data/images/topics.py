"""Which two image topics are the left and the right camera of a stereo pair."""

from __future__ import annotations

import re

from vmf.data.recording import schemas
from vmf.data.recording.container import Contents
from vmf.data.recording.topics import check_topic, present
from vmf.errors import InputError

_SIDES = re.compile(r"left|right", re.IGNORECASE)


def stereo_topics(contents: Contents, left: str | None, right: str | None) -> tuple[str, str]:
    """Return the left and the right image topic: as given, or the only pair that the names allow.

    Two topics are a pair if their names differ in `left` and `right` alone.

    Raises
    ------
    InputError : a topic is missing or holds no images, or the names leave a doubt.
    """
    for topic in (left, right):
        if topic is not None:
            check_topic(contents, topic, schemas.IMAGE_SCHEMAS)
    pairs = [
        pair
        for pair in _pairs([t.name for t, n in contents.counts if t.schema in schemas.IMAGE_SCHEMAS and n])
        if left in (None, pair[0]) and right in (None, pair[1])
    ]
    if left is not None and right is not None:
        if left == right:
            raise InputError(f"{contents.path}: {left} is given for both cameras, two topics are accepted")
        return left, right
    if len(pairs) == 1:
        return pairs[0]
    if not pairs:
        found = f"topics present: {present(contents)}"
        raise InputError(
            f"{contents.path}: no two image topics whose names differ in left and right alone; "
            f"name them with --left and --right (images.left and images.right in a spec); {found}"
        )
    listed = ", ".join(f"{a} with {b}" for a, b in pairs)
    raise InputError(
        f"{contents.path}: several stereo pairs; choose one with --left (images.left in a spec): {listed}"
    )


def _pairs(names: list[str]) -> list[tuple[str, str]]:
    sides: dict[str, dict[str, str]] = {}
    for name in dict.fromkeys(names):
        found = _SIDES.findall(name)
        if len(found) == 1:
            sides.setdefault(_SIDES.sub("*", name), {})[found[0].lower()] = name
    return [(both["left"], both["right"]) for both in sides.values() if len(both) == 2]
