"""Error tables like those of a run, made without running one."""

from __future__ import annotations

from functools import cache
from itertools import product

import numpy as np
import pandas as pd

from vmf.report.tables import shown_cases

ROTATIONS = {"angle", "pan", "tilt", "heading", "rot_x", "rot_y", "rot_z"}
TASKS = {
    "pan_tilt": ("pan", "tilt", "angle", "distance"),
    "translation": ("t_x", "t_y", "t_z", "angle", "distance"),
    "planar": ("heading", "t_x", "t_y", "angle", "distance"),
    "six_dof": ("rot_x", "rot_y", "rot_z", "t_x", "t_y", "t_z", "angle", "distance"),
}
STILL = {"pan_tilt": {"distance"}, "translation": {"angle"}}
ACCURACY = {
    "vmf": 0.02,
    "triangulate_arun": 0.06,
    "pnp": 0.03,
    "bundle": 0.018,
    "bundle[focal=1%,rot=0.5deg]": 0.05,
    "cramer_rao": 0.012,
    "no_motion": None,
}
SIX = ("vmf", "triangulate_arun", "pnp", "bundle", "cramer_rao", "no_motion")


def endings(rng: np.random.Generator, n: int, method: str, lost: float) -> np.ndarray:
    """Say how each solution ended: refused or diverged as a whole, in all its components."""
    if method in ("cramer_rao", "no_motion"):
        return np.full(n, "ok")
    return np.where(rng.random(n) < lost, np.where(rng.random(n) < 0.7, "refused", "diverged"), "ok")


def block(
    task: str,
    protocol: str,
    methods: tuple[str, ...],
    trials: int,
    frames: np.ndarray,
    case: str,
    lost: float = 0.02,
    seed: int = 0,
) -> pd.DataFrame:
    rng = np.random.default_rng(seed)
    n = trials * len(frames)
    trial, frame = (a.ravel() for a in np.meshgrid(np.arange(trials), frames, indexing="ij"))
    learning = 1.0 + 25.0 / frame if protocol == "trained_code" else 1.0
    ended = {m: endings(rng, n, m, lost) for m in methods}
    tables = []
    for component in TASKS[task]:
        still = component in STILL.get(task, ())
        truth = np.zeros(n) if still else rng.uniform(-0.5, 0.5, n)
        if component in ("angle", "distance"):
            truth = np.abs(truth)
        for method, statuses in ended.items():
            scale = ACCURACY[method]
            if scale is None:
                error = -truth
            elif method == "cramer_rao":
                error = scale * learning * (1 + 0.05 * rng.random(n))
            else:
                error = scale * learning * rng.standard_t(4, n)
            if component in ("angle", "distance"):
                error = np.maximum(error, -truth)
            if still:
                error = np.zeros(n)
            ok = statuses == "ok"
            tables.append(
                pd.DataFrame(
                    {
                        "trial": trial,
                        "frame": frame,
                        "protocol": protocol,
                        "method": method,
                        "component": component,
                        "unit": "rad" if component in ROTATIONS else "m",
                        "case": [f"frame={f}" for f in frame] if case == "frame" else case,
                        "truth": truth,
                        "estimate": np.where(ok, truth + error, np.nan),
                        "abs_error": np.where(ok, np.abs(error), np.nan),
                        "status": statuses,
                    }
                )
            )
    return pd.concat(tables, ignore_index=True)


def curve_frames(last: int, points: int) -> np.ndarray:
    return np.unique(np.geomspace(5, last, points).round().astype(int))


@cache
def pan_tilt() -> pd.DataFrame:
    return block(
        "pan_tilt", "trained_code", ("vmf", "cramer_rao", "no_motion"), 20, np.arange(2, 302), "frame"
    )


@cache
def six_dof() -> pd.DataFrame:
    trained = block("six_dof", "trained_code", SIX, 100, np.arange(10, 460, 10), "frame")
    held_out = block("six_dof", "held_out", SIX, 1, np.arange(60), "frame=450", seed=1)
    return pd.concat([trained, held_out], ignore_index=True)


@cache
def held_out() -> pd.DataFrame:
    methods = tuple(ACCURACY)
    methods = tuple(m for m in methods if m != "cramer_rao")
    return pd.concat(
        [
            block("six_dof", "held_out", methods, 1, np.arange(300), f"gap={gap}", lost=0.03, seed=gap)
            for gap in (5, 20)
        ],
        ignore_index=True,
    )


@cache
def all_refused() -> pd.DataFrame:
    methods = ("vmf", "triangulate_arun", "pnp")
    return pd.concat(
        [
            block("planar", "trained_code", methods, 3, np.arange(2, 42), "frame", lost=1.1),
            block("planar", "held_out", methods, 1, np.arange(30), "gap=5", lost=1.1),
        ],
        ignore_index=True,
    )


@cache
def single_trial() -> pd.DataFrame:
    return block("planar", "trained_code", ("vmf", "cramer_rao", "no_motion"), 1, np.arange(2, 162), "frame")


@cache
def translation() -> pd.DataFrame:
    methods = (
        "vmf",
        "triangulate_arun",
        "pnp",
        "bundle",
        "bundle[focal=1%,rot=0.5deg]",
        "cramer_rao",
        "no_motion",
    )
    trained = block("translation", "trained_code", methods, 8, curve_frames(2000, 40), "frame")
    return pd.concat([trained, block("translation", "held_out", methods, 8, np.arange(6), "frame=2000")])


@cache
def few_answers() -> pd.DataFrame:
    return block("pan_tilt", "held_out", ("vmf", "pnp"), 1, np.arange(6), "", lost=0.3)


@cache
def far_apart() -> pd.DataFrame:
    """Rivals whose errors differ by orders of magnitude."""
    errors = block("planar", "held_out", ("vmf", "triangulate_arun", "bundle"), 1, np.arange(200), "gap=5")
    errors.loc[errors["method"] == "triangulate_arun", "abs_error"] *= 400.0
    return errors


DATA_SETS = {
    f.__name__: f
    for f in (pan_tilt, six_dof, held_out, all_refused, single_trial, translation, few_answers, far_apart)
}


def paired(errors: pd.DataFrame) -> pd.DataFrame:
    rows = []
    cases = set(shown_cases(errors["case"].unique()))
    errors = errors[errors["case"].isin(cases)]
    keys = ["protocol", "case", "component", "unit"]
    for key, group in errors[errors["status"] == "ok"].groupby(keys, sort=False):
        pivot = group.pivot_table(index=["trial", "frame"], columns="method", values="abs_error")
        for method in pivot.columns:
            if method in ("vmf", "no_motion", "cramer_rao") or "vmf" not in pivot:
                continue
            d = (pivot[method] - pivot["vmf"]).dropna()
            half = 1.96 * d.std() / np.sqrt(max(len(d), 1))
            rows.append((*key, method, len(d), d.mean(), d.mean() - half, d.mean() + half))
    names = [*keys, "method", "n", "mean_difference", "ci_low", "ci_high"]
    return pd.DataFrame(rows, columns=names)


def condition(trials: int = 1, frames: int = 500) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(3)
    x = np.arange(1, frames + 1)
    values = 300 * (1 + 2000 / x**1.6) * np.exp(0.1 * rng.standard_normal((trials, frames)))
    values[:, :6] = np.inf
    return x, values[0] if trials == 1 else values


def stereo_pixels(n: int = 2000, size: tuple[int, int] = (640, 480)) -> np.ndarray:
    rng = np.random.default_rng(4)
    left = rng.uniform((60, 0), size, (n, 2))
    disparity = rng.uniform(20, 60, n)
    pixels = np.column_stack([left, left[:, 0] - disparity, left[:, 1] + rng.normal(0, 3, n)])
    pixels[rng.random(n) < 0.05, 2:] = np.nan
    return pixels


def calibration_sweep(
    rivals: tuple[str, ...] = ("bundle",), cases: tuple[str, ...] = ("frame=400",), task: str = "six_dof"
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Curves and crossovers of rivals whose errors grow with that of their calibration."""
    rng = np.random.default_rng(5)
    kinds = (
        ("focal", "%", (0.0, 0.5, 1.0, 2.0, 4.0)),
        ("principal", "px", (0.0, 2.0, 5.0, 10.0, 20.0)),
        ("rotation", "deg", (0.0, 0.1, 0.2, 0.5, 1.0)),
        ("baseline", "%", (0.0, 1.0, 2.0, 5.0, 10.0)),
    )
    curves, ends = [], []
    parts = [p for p in (("angle", "rad"), ("distance", "m")) if p[0] not in STILL.get(task, ())]
    for case in cases:
        for (component, unit), rival, (kind, kind_unit, grid) in product(parts, rivals, kinds):
            key = (kind, kind_unit, component, unit)
            level = 0.08 if unit == "rad" else 0.18
            start = level * (1.02 if rival == "bundle" else 2.0)
            slope = 0.0 if kind == "focal" else rng.uniform(0.3, 1.5)
            median = start * (1 + slope * np.array(grid) / grid[-1]) - 0.05 * level
            for x, m in zip(grid, median, strict=True):
                curves.append((case, rival, rival, *key, x, 200, m, 0.9 * m, 1.12 * m))
            for who, m in (("vmf", level), ("cramer_rao", 0.93 * level)):
                curves.append((case, rival, who, *key, np.nan, 200, m, 0.9 * m, 1.12 * m))
            where = float(np.interp(level, median, grid)) if median[-1] > level else np.nan
            ends.append((case, rival, *key, 200, 200, grid[-1], where, 0.5 * where, np.nan))
    names = ["kind", "unit", "component", "component_unit"]
    curve_names = ["case", "rival", "method", *names, "magnitude", "n", "median", "ci_low", "ci_high"]
    end_names = ["case", "method", *names, "n", "n_asked", "largest", "crossover", "ci_low", "ci_high"]
    return pd.DataFrame(curves, columns=curve_names), pd.DataFrame(ends, columns=end_names)
