"""The machine that figures were measured on: what it is, and what it can do at best."""

from __future__ import annotations

import importlib.metadata
import os
import platform
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.linalg.blas import daxpy, dgemm
from threadpoolctl import threadpool_info

from vmf import __version__
from vmf.bench.clock import in_turns

_PACKAGES = ("numpy", "scipy", "opencv-python-headless", "scikit-learn", "padasip", "mcap")


@dataclass(frozen=True)
class Blas:
    """One linear algebra library in the process.

    Attributes
    ----------
    threads : how many it uses by itself; figures are measured with one, unless they say otherwise.
    """

    name: str
    version: str
    architecture: str
    threads: int


@dataclass(frozen=True)
class Machine:
    """What the figures were measured on."""

    processor: str
    cores: int
    memory_gib: float
    system: str
    python: str
    vmf: str
    packages: tuple[tuple[str, str], ...]
    blas: tuple[Blas, ...]
    load_average: float | None


@dataclass(frozen=True)
class Peaks:
    """What one core reaches: dgemm in GFlop/s, and memory bandwidth in GB/s, medians of repeats."""

    dgemm_gflops: float
    triad_gbs: float


def describe() -> Machine:
    """Return the description of this machine."""
    packages = [(name, _version(name)) for name in _PACKAGES]
    pools = [pool for pool in threadpool_info() if pool["user_api"] == "blas"]
    return Machine(
        _processor(),
        len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1,
        _memory_gib(),
        f"{platform.system()} {platform.machine()}",
        platform.python_version(),
        __version__,
        tuple((name, version) for name, version in packages if version),
        tuple(
            Blas(
                pool["internal_api"],
                str(pool["version"]),
                str(pool.get("architecture")),
                int(pool["num_threads"]),
            )
            for pool in pools
        ),
        os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
    )


def peaks(quick: bool) -> Peaks:
    """Measure what one core reaches: 2n³ operations of a product, 24 bytes an entry of `y + s x` (triad)."""
    n, m = (200, 200_000) if quick else (1000, 20_000_000)
    rng = np.random.default_rng(1)
    A, B = (np.asfortranarray(rng.standard_normal((n, n))) for _ in range(2))
    x, y = np.ones(m), np.zeros(m)
    times = in_turns({"dgemm": lambda: dgemm(1.0, A, B), "triad": lambda: daxpy(x, y, a=1e-9)}, 5)
    return Peaks(2.0 * n**3 / times["dgemm"].median / 1e9, 24.0 * m / times["triad"].median / 1e9)


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


def _memory_gib() -> float:
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 2**30
    except (AttributeError, ValueError, OSError):
        return 0.0


def _version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return ""
