"""The directory of a run: what was asked for, with what, and what came out."""

from __future__ import annotations

import hashlib
import json
import platform
import resource
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any

import pandas as pd

import vmf
from vmf.errors import InputError, Loss
from vmf.experiment.atomic import point_to, write_bytes, write_text
from vmf.experiment.errors_table import COLUMNS
from vmf.spec import Spec, dump, spec_hash

_PACKAGES = ("numpy", "scipy", "pydantic", "pandas", "pyarrow", "matplotlib", "mcap", "typer")


@dataclass
class RunDirectory:
    """One run on disk.

    Attributes
    ----------
    path : the directory.
    record : content of `run.json`.
    """

    path: Path
    record: dict[str, Any]
    _began: float = field(default_factory=time.perf_counter)

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

    @classmethod
    def create(
        cls,
        parent: Path,
        spec: Spec,
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
        try:
            path.mkdir(parents=True)
        except OSError as error:
            raise InputError(f"--out: {error.filename or path}: {error.strerror}") from error
        record = {
            "status": "running",
            "command": command,
            "started": datetime.now(UTC).isoformat(),
            "spec": spec.model_dump(mode="json"),
            "spec_hash": spec_hash(spec),
            "overrides": list(overrides),
            "seeds": _seeds(spec),
            "inputs": dict(inputs),
            "version": vmf.__version__,
            **_git(),
            "packages": {name: metadata.version(name) for name in _PACKAGES},
            "python": sys.version.split()[0],
            "machine": f"{platform.system()} {platform.machine()}",
        }
        run = cls(path, record)
        run._write_record()
        write_text(path / "spec.yaml", dump(spec))
        point_to(parent / "latest", path)
        return run

    @classmethod
    def unfinished(
        cls, parent: Path, spec: Spec, command: str, inputs: Mapping[str, str]
    ) -> RunDirectory | None:
        """Return the newest run of the same spec, command, inputs and version that has not ended, if any."""
        for path in sorted(parent.glob(f"{spec_hash(spec)}-*"), reverse=True):
            try:
                record = json.loads((path / "run.json").read_text())
            except (OSError, ValueError):
                continue
            if not isinstance(record, dict) or record.get("status") == "done":
                continue
            same = {"command": command, "version": vmf.__version__, "inputs": dict(inputs)}
            if all(record.get(key) == value for key, value in same.items()):
                run = cls(path, record)
                for stale in ("error", "finished"):
                    run.record.pop(stale, None)
                run.record["status"] = "running"
                run.record["resumed"] = run.record.get("resumed", 0) + 1
                run._write_record()
                point_to(parent / "latest", path)
                return run
        return None

    def write_tables(self, errors: pd.DataFrame, summary: pd.DataFrame) -> None:
        """Write `errors.parquet` with the contract's columns and `summary.csv`."""
        write_bytes(self.errors, errors[list(COLUMNS)].to_parquet(index=False))
        write_text(self.path / "summary.csv", summary.to_csv(index=False))

    def finish(self, status: str, losses: tuple[Loss, ...] = (), **more: Any) -> None:
        """Update `run.json` for the last time."""
        usage = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
        self.record.update(
            status=status,
            finished=datetime.now(UTC).isoformat(),
            wall_s=round(time.perf_counter() - self._began, 3),
            cpu_s=round(sum(u.ru_utime + u.ru_stime for u in usage), 3),
            # Linux counts in KiB, macOS in bytes.
            peak_memory_mib=round(
                max(u.ru_maxrss for u in usage) / (1024**2 if sys.platform == "darwin" else 1024), 1
            ),
            losses=[str(loss) for loss in losses],
            **more,
        )
        self._write_record()

    def _write_record(self) -> None:
        write_text(self.path / "run.json", json.dumps(self.record, indent=2) + "\n")


def sha256(path: Path) -> str:
    """Return the SHA-256 of a file, in hexadecimal."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _seeds(spec: Spec) -> dict[str, int]:
    if spec.data.simulate is None:
        return {}
    return {"simulate": spec.data.simulate.seed, "trials": spec.evaluate.trials}


def _git() -> dict[str, Any]:
    """Commit and dirty flag of the program's own checkout, None where it is not one."""
    here = Path(vmf.__file__).parent

    def git(*arguments: str) -> str | None:
        try:
            done = subprocess.run(
                ["git", "-C", str(here), *arguments], capture_output=True, text=True, timeout=10, check=True
            )
        except (OSError, subprocess.SubprocessError):
            return None
        return done.stdout.strip()

    tracked = git("ls-files", "--error-unmatch", "__init__.py")
    if tracked is None:
        return {"git_commit": None, "git_dirty": None}
    return {"git_commit": git("rev-parse", "HEAD"), "git_dirty": bool(git("status", "--porcelain"))}
