"""Which program made a run: version, commit, packages and machine."""

from __future__ import annotations

import platform
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

import vmf

_PACKAGES = (
    "numpy",
    "scipy",
    "opencv-python-headless",
    "pydantic",
    "pandas",
    "pyarrow",
    "matplotlib",
    "mcap",
    "typer",
)


# Those that results depend on.
_COUNTING = ("numpy", "scipy", "opencv-python-headless")


@dataclass(frozen=True)
class Program:
    """The program, as `run.json` names it; commit and dirty flag are None where it is no checkout."""

    version: str
    git_commit: str | None
    git_dirty: bool | None
    packages: tuple[tuple[str, str], ...]
    python: str
    machine: str

    def __str__(self) -> str:
        return _name(self.version, self.git_commit, self.git_dirty)

    @property
    def counting(self) -> tuple[str, ...]:
        """The packages that results depend on, with their versions."""
        return counting_packages({"packages": dict(self.packages)})


def program_of(record: Mapping[str, Any]) -> str:
    """Return the name of the program that made a run, from the run's record: version and commit.

    A plus sign says that files differed from the commit, so that equal names are no proof.
    """
    return _name(record.get("version"), record.get("git_commit"), record.get("git_dirty"))


def counting_packages(record: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the packages that results depend on, with their versions, from a run's record."""
    packages = record.get("packages")
    known = packages if isinstance(packages, Mapping) else {}
    return tuple(f"{name} {known.get(name)}" for name in _COUNTING)


def _name(version: object, commit: object, dirty: object) -> str:
    return " ".join([str(version), *([str(commit)[:8] + ("+" if dirty else "")] if commit else [])])


@cache
def program() -> Program:
    """Return this program; it does not change while it runs, and finding out takes tens of milliseconds."""
    commit, dirty = _git()
    return Program(
        vmf.__version__,
        commit,
        dirty,
        tuple((name, metadata.version(name)) for name in _PACKAGES),
        sys.version.split()[0],
        f"{platform.system()} {platform.machine()}",
    )


def _git() -> tuple[str | None, bool | None]:
    here = Path(vmf.__file__).parent

    def git(*arguments: str) -> str | None:
        try:
            done = subprocess.run(
                ["git", "-C", str(here), *arguments], capture_output=True, text=True, timeout=10, check=True
            )
        except (OSError, subprocess.SubprocessError):
            return None
        return done.stdout.strip()

    if git("ls-files", "--error-unmatch", "__init__.py") is None:
        return None, None
    return git("rev-parse", "HEAD"), bool(git("status", "--porcelain"))
