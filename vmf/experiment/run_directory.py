"""The directory of a run: what was asked for, with what, and what came out."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from io import BytesIO
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from vmf.errors import InputError, Loss
from vmf.experiment.atomic import point_to, write_bytes, write_text
from vmf.experiment.errors_table import COLUMNS
from vmf.experiment.parallel import Failure
from vmf.experiment.program import counting_packages, program
from vmf.experiment.usage import Stopwatch, Usage
from vmf.spec import Spec, StudySpec, dump, spec_hash

_PARQUET_END = b"PAR1"


@dataclass
class RunDirectory:
    """One run on disk.

    Attributes
    ----------
    path : the directory.
    record : content of `run.json`.
    durable : whether writing waits for the disk.
    """

    path: Path
    record: dict[str, Any]
    durable: bool = True
    _watch: Stopwatch = field(default_factory=Stopwatch)

    @property
    def errors(self) -> Path:
        """`errors.parquet`."""
        return self.path / "errors.parquet"

    @property
    def model(self) -> Path:
        """`model.npz`."""
        return self.path / "model.npz"

    @property
    def plots(self) -> Path:
        """`plots/`."""
        return self.path / "plots"

    @property
    def trials(self) -> Path:
        """`trials/`: finished trials of a run that has not ended."""
        return self.path / "trials"

    def trial(self, number: int) -> Path:
        """Return the file of a finished trial."""
        return self.trials / f"{number:06d}.parquet"

    def missing_trials(self, total: int) -> list[int]:
        """Return the numbers of trials without a file, or with one that a loss of power has cut short."""
        return [n for n in range(total) if not _is_whole_parquet(self.trial(n))]

    @classmethod
    def create(
        cls,
        parent: Path,
        spec: Spec | StudySpec,
        command: str,
        overrides: tuple[str, ...],
        inputs: Mapping[str, str],
    ) -> RunDirectory:
        """Make a new directory `<spec-hash>-<time>` below `parent` and write its first `run.json`.

        Raises
        ------
        InputError : the directory cannot be made.
        """
        stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%S.%fZ")
        path = parent / f"{spec_hash(spec)}-{stamp}"
        run = cls.begin(path, spec, command, overrides, inputs)
        point_to(parent / "latest", path)
        return run

    @classmethod
    def begin(
        cls,
        path: Path,
        spec: Spec | StudySpec,
        command: str,
        overrides: tuple[str, ...],
        inputs: Mapping[str, str],
        durable: bool = True,
    ) -> RunDirectory:
        """Make `path` the directory of a new run and write its first `run.json`.

        Raises
        ------
        InputError : the directory cannot be made.
        """
        try:
            path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"--out: {error.filename or path}: {error.strerror}") from error
        made_by = program()
        record = {
            "status": "running",
            "command": command,
            "started": datetime.now(UTC).isoformat(),
            "spec": spec.model_dump(mode="json"),
            "spec_hash": spec_hash(spec),
            "overrides": list(overrides),
            "seeds": _seeds(spec),
            "inputs": dict(inputs),
            "version": made_by.version,
            "git_commit": made_by.git_commit,
            "git_dirty": made_by.git_dirty,
            "packages": dict(made_by.packages),
            "python": made_by.python,
            "machine": made_by.machine,
        }
        run = cls(path, record, durable)
        # The record comes last: with it, whatever happens next, the directory is a run.
        write_text(path / "spec.yaml", dump(spec), durable)
        run._write_record()
        return run

    @classmethod
    def unfinished(
        cls, parent: Path, spec: Spec, command: str, inputs: Mapping[str, str]
    ) -> RunDirectory | None:
        """Return the newest run of the same spec, command, inputs and program that has not ended, if any."""
        for path in sorted(parent.glob(f"{spec_hash(spec)}-*"), reverse=True):
            run = cls.reopened(path, command, inputs)
            if run is not None:
                point_to(parent / "latest", path)
                return run
        return None

    @classmethod
    def reopened(
        cls, path: Path, command: str, inputs: Mapping[str, str], durable: bool = True
    ) -> RunDirectory | None:
        """Return the run at `path` if it is of the same command, inputs and program and has not ended."""
        record = stored_record(path)
        same: dict[str, Any] = {"command": command, "inputs": dict(inputs)}
        same |= {"version": program().version, "git_commit": program().git_commit}
        same |= {"git_dirty": program().git_dirty}
        if record.get("status", "done") == "done" or any(record.get(k) != v for k, v in same.items()):
            return None
        if counting_packages(record) != program().counting:
            return None
        run = cls(path, record, durable)
        for stale in ("error", "trace", "finished"):
            run.record.pop(stale, None)
        run.record["status"] = "running"
        run.record["resumed"] = run.record.get("resumed", 0) + 1
        run._write_record()
        return run

    def write_tables(self, errors: pd.DataFrame, **tables: pd.DataFrame | None) -> None:
        """Write `errors.parquet` with the contract's columns, and each table that there is as `NAME.csv`."""
        columns, buffer = {}, BytesIO()
        for name in COLUMNS:
            values = pa.array(errors[name])
            # In memory names are categories; the file has the names themselves.
            is_name = pa.types.is_dictionary(values.type)
            columns[name] = values.cast(pa.large_string()) if is_name else values
        pq.write_table(pa.table(columns), buffer)
        write_bytes(self.errors, buffer.getvalue(), self.durable)
        for name, content in tables.items():
            if content is not None:
                write_text(self.path / f"{name}.csv", content.to_csv(index=False), self.durable)

    def keep_trial(self, number: int, table: bytes, model: bytes | None) -> None:
        """Leave a finished trial on disk, where a later call finds it; its model comes first."""
        if model is not None:
            write_bytes(self.model, model, self.durable)
        self.trials.mkdir(exist_ok=True)
        write_bytes(self.trial(number), table, durable=False)

    def remove_trials(self) -> None:
        """Remove what only an unfinished run needs."""
        if self.trials.exists():
            for path in self.trials.glob("*"):
                path.unlink()
            self.trials.rmdir()

    def finish(
        self, status: str, losses: tuple[Loss, ...] = (), usage: Usage | None = None, **more: Any
    ) -> None:
        """Update `run.json` for the last time; without `usage` the run was all that this process did."""
        used = self._watch.read() if usage is None else usage
        self.record.update(
            status=status,
            finished=datetime.now(UTC).isoformat(),
            wall_s=round(used.wall_s, 3),
            cpu_s=round(used.cpu_s, 3),
            peak_memory_mib=round(used.peak_memory_mib, 1),
            losses=[str(loss) for loss in losses],
            **more,
        )
        self._write_record()

    def fail(self, failure: Failure, usage: Usage | None = None) -> None:
        """Note why there are no results; what is there stays on disk."""
        trace: dict[str, Any] = {"trace": failure.trace} if failure.trace else {}
        self.finish("failed", (), usage, error=str(failure), **trace)

    def _write_record(self) -> None:
        write_text(self.path / "run.json", json.dumps(self.record, indent=2) + "\n", self.durable)


def stored_record(path: Path) -> dict[str, Any]:
    """Return the content of a run's `run.json`, nothing where there is none that can be read."""
    try:
        record = json.loads((path / "run.json").read_text())
    except (OSError, ValueError):
        return {}
    return record if isinstance(record, dict) else {}


def holds_something(path: Path) -> bool:
    """Whether there is such a file, and not an empty one."""
    try:
        return path.stat().st_size > 0
    except OSError:
        return False


def _is_whole_parquet(path: Path) -> bool:
    try:
        with path.open("rb") as stream:
            stream.seek(-len(_PARQUET_END), os.SEEK_END)
            return stream.read() == _PARQUET_END
    except OSError:
        return False


def sha256(path: Path) -> str:
    """Return the SHA-256 of a file, in hexadecimal."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _seeds(spec: Spec | StudySpec) -> dict[str, int]:
    if isinstance(spec, StudySpec):
        seed = getattr(spec.study, "seed", None)
        return {} if seed is None else {"study": seed}
    if spec.data.simulate is None:
        return {}
    return {"simulate": spec.data.simulate.seed, "trials": spec.evaluate.trials}
