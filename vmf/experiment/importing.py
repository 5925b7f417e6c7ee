"""`vmf import`: from a folder or file of another kind to a recording."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import asdict, dataclass
from pathlib import Path

import yaml

from vmf.data.importers import FORMATS
from vmf.data.recording.container import visit
from vmf.data.recording.output import Output, check_target, output
from vmf.errors import InputError, Loss
from vmf.progress import Report
from vmf.spec import settings
from vmf.spec.base import Model

SETTINGS_NAME = "import.yaml"


@dataclass(frozen=True)
class ImportedTopic:
    """A topic of the recording, and how many messages it has."""

    name: str
    schema: str
    count: int


@dataclass(frozen=True)
class ImportResult:
    """What `vmf import` wrote; `left_out` are topics of the source that are not for a recording."""

    path: Path
    format: str
    topics: tuple[ImportedTopic, ...]
    left_out: tuple[str, ...]
    losses: tuple[Loss, ...]
    repairs: tuple[Loss, ...]

    def lines(self) -> list[str]:
        """Return the result as lines of text."""
        lines = [f"{self.path}: {sum(t.count for t in self.topics)} messages from {self.format}"]
        lines += [f"  {t.name}: {t.schema}, {t.count}" for t in self.topics]
        if self.left_out:
            lines.append(f"  left out: {', '.join(self.left_out)}")
        return lines

    def to_json(self) -> str:
        """Return the result as JSON."""
        listed = {key: [str(loss) for loss in getattr(self, key)] for key in ("losses", "repairs")}
        return json.dumps({**asdict(self), "path": str(self.path), **listed}, indent=2, allow_nan=False)


def import_recording(
    kind: str, source: Path, target: Path, options: tuple[str, ...], progress: Report | None = None
) -> ImportResult:
    """Write what a source of some format holds as a recording.

    Raises
    ------
    InputError : no such format, settings that it does not take, or a source or an output that is wrong.
    """
    form = FORMATS.get(kind)
    if form is None:
        raise InputError(f"found the format {kind!r}, accepted: {', '.join(FORMATS)}")
    chosen = settings(form.options, options)
    check_target(target, "-o", (source,))
    if not source.exists():
        raise InputError(f"{source}: no such file or directory")
    if target.exists() and target.resolve().is_relative_to(source.resolve()):
        raise InputError(f"-o {target}: is there already and part of the source, another file is accepted")
    found = form.look(source, chosen)
    written: list[ImportedTopic] = []
    with output(target, lambda path, out: written.extend(_read_back(path, out))) as out:
        for done, _ in enumerate(found.write(out), start=1):
            if progress is not None:
                progress(done, found.total, "messages")
        out.attach(SETTINGS_NAME, _described(kind, source, chosen), 0)
    return ImportResult(target, kind, tuple(written), found.left_out, found.losses, found.repairs)


def _read_back(path: Path, out: Output) -> list[ImportedTopic]:
    contents = visit(path, lambda topic: False, lambda message: None)
    topics = [ImportedTopic(t.name, t.schema, n) for t, n in contents.counts]
    counts = Counter[str]()
    for topic in topics:
        counts[topic.name] += topic.count
    if contents.losses or counts != out.counts:
        raise RuntimeError(f"{path}: read back otherwise than written: {counts}, {contents.losses}")
    return topics


def _described(kind: str, source: Path, options: Model) -> str:
    described = {"format": kind, "source": source.resolve().name, **options.model_dump(mode="json")}
    return str(yaml.safe_dump({"import": described}, sort_keys=False))
