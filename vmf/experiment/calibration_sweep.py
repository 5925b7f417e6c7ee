"""Rivals with growing calibration errors, and where they fall behind the learned function."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from vmf.estimate.noise import Noise
from vmf.experiment.build import build_task, rig_model
from vmf.experiment.errors_table import OVERALL, Asked, solution_rows
from vmf.experiment.statistics import question_clusters, resampled_medians, stream
from vmf.reconstruct import CalibrationError, disturb, label, reconstruct
from vmf.spec import Spec

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Each kind of error, its key in a spec and its unit.
KINDS = (
    ("focal", "focal_percent", "%"),
    ("principal", "principal_px", "px"),
    ("rotation", "rotation_deg", "deg"),
    ("baseline", "baseline_percent", "%"),
)
CURVES = (
    "case",
    "rival",
    "method",
    "kind",
    "unit",
    "component",
    "component_unit",
    "magnitude",
    "n",
    "median",
    "ci_low",
    "ci_high",
)
CROSSOVERS = (
    "case",
    "method",
    "kind",
    "unit",
    "component",
    "component_unit",
    "n",
    "n_asked",
    "largest",
    "crossover",
    "ci_low",
    "ci_high",
)
# So many targets of a case are reconstructed for each error: a hundred per view need not be asked often.
_MOST_TARGETS = 3000
# A component that never moves is zero to rounding (rad, m).
_STILL = 1e-9
# |error| of a rival without an answer: more than any that has one.
_NO_ANSWER = 1e12


@dataclass(frozen=True)
class Step:
    """A rival with one kind of error: `magnitude` in `unit`, 0 for exact cameras; `label` is its name."""

    method: str
    kind: str
    unit: str
    magnitude: float
    error: CalibrationError
    label: str


@dataclass(frozen=True)
class Crossing:
    """What the sweep found.

    Attributes
    ----------
    curves : median |error| and its 95 % interval of each rival with each error, and on the same questions of
        `vmf` and `cramer_rao`, at magnitude NaN.
    crossovers : where each rival falls behind, content of `crossover.csv`: `n` of the `n_asked` questions
        had an answer from `vmf`; NaN says that it does not within the `largest` error asked.
    """

    curves: pd.DataFrame
    crossovers: pd.DataFrame


def steps(spec: Spec) -> list[Step]:
    """Return what the sweep asks, kind by kind with growing errors, exact cameras first; nothing if off."""
    sweep = spec.calibration_sweep
    if sweep is None or "held_out" not in spec.evaluate.protocol or rig_model(spec) is None:
        return []
    found = []
    for method in dict.fromkeys(sweep.methods):
        for kind, key, unit in KINDS:
            magnitudes = sorted(set(getattr(sweep, key)))
            for value in [0.0, *magnitudes] if magnitudes else []:
                error = CalibrationError(**{key: value})
                found.append(Step(method, kind, unit, value, error, label(method, error)))
    return found


def only_swept(spec: Spec) -> tuple[str, ...]:
    """Return the methods that the sweep alone asks, in order: too many for a table of all methods."""
    rivals = {label(r.method, r.error) for r in spec.rivals}
    return tuple(dict.fromkeys(step.label for step in steps(spec) if step.label not in rivals))


def sweep_rows(spec: Spec, asked: Asked, noise: Noise | None) -> Iterator[pd.DataFrame]:
    """Yield the rows of each rival that the sweep alone asks, for some of the held-out questions."""
    model = rig_model(spec)
    if asked.protocol != "held_out" or model is None:
        return
    task, known = build_task(spec), spec.solver.known == "rotation"
    wanted = only_swept(spec)
    if not wanted:
        return
    some = _chosen(spec, asked)
    few = asked.select(some)
    cameras = {step.label: (step.method, disturb(model, step.error)) for step in steps(spec)}
    for name in wanted:
        method, rig = cameras[name]
        found = reconstruct(method, task, rig, few.query, known_rotation=known, noise=noise)
        rows = solution_rows(task, few, name, found)
        yield rows.assign(query=some[rows["query"]])


def _chosen(spec: Spec, asked: Asked) -> Ints:
    """Return the questions (S,) to ask, spread evenly over those of this case and trial."""
    assert spec.calibration_sweep is not None
    n = len(asked.query)
    sets = spec.evaluate.folds if spec.data.simulate is None else spec.evaluate.trials
    targets = np.isfinite(asked.query.initial).all(axis=-1).sum() / n
    most = min(spec.calibration_sweep.questions, _MOST_TARGETS / max(targets, 1.0))
    share = min(n, max(int(np.ceil(most / sets)), 1))
    return np.unique(np.linspace(0, n - 1, share).round().astype(np.int64))


def crossing(spec: Spec, errors: pd.DataFrame, seed: int) -> Crossing | None:
    """Return where rivals fall behind `vmf`, over the questions that the sweep asked; None if it asked none.

    Parameters
    ----------
    spec : the experiment.
    errors : the tidy table, with `case` and `query`.
    seed : of the bootstrap, which resamples clusters of questions as that of the means does.
    """
    by_kind: dict[tuple[str, str, str], list[Step]] = {}
    for step in steps(spec):
        by_kind.setdefault((step.method, step.kind, step.unit), []).append(step)
    answered = set(errors["method"].unique())
    if not any({step.label for step in of_kind} <= answered for of_kind in by_kind.values()):
        return None
    held_out = errors[(errors["protocol"] == "held_out") & errors["component"].isin(dict(OVERALL))]
    curves: list[tuple[object, ...]] = []
    crossovers: list[tuple[object, ...]] = []
    for (case, component, unit), rows in held_out.groupby(["case", "component", "unit"], sort=False):
        # A pan-tilt unit has no distance, and a pure translation no angle.
        if not rows["truth"].abs().max() > _STILL:
            continue
        by_question = rows.set_index(["trial", "frame", "case", "query", "method"])
        status, answers = (by_question[column].unstack("method") for column in ("status", "abs_error"))
        for (method, kind, kind_unit), of_kind in by_kind.items():
            if not {step.label for step in of_kind} <= set(status):
                continue
            rng = stream(seed, (case, component, method, kind))
            found = _compare(status, answers, of_kind, str(case), rng, spec.evaluate.bootstrap)
            key = (kind, kind_unit, component, unit)
            curves += [(case, method, name, *key, *row) for name, row in found.curves]
            crossovers.append((case, method, *key, *found.crossover))
    if not crossovers:
        return None
    return Crossing(
        pd.DataFrame(curves, columns=list(CURVES)), pd.DataFrame(crossovers, columns=list(CROSSOVERS))
    )


@dataclass(frozen=True)
class _Comparison:
    """Rows of both tables from `magnitude` and from `n` on; those of the curves with their method."""

    curves: list[tuple[str, tuple[float, int, float, float, float]]]
    crossover: tuple[int, int, float, float, float, float]


def _compare(
    status: pd.DataFrame,
    answers: pd.DataFrame,
    of_kind: list[Step],
    case: str,
    rng: np.random.Generator,
    resamples: int,
) -> _Comparison:
    """Compare `vmf` with a rival of growing error, over the questions that `vmf` answered.

    A rival without an answer is as far off as can be. `status` and `answers`, |error|, have a row for each
    question and a column for each method.
    """
    names = ["vmf", *(step.label for step in of_kind)]
    bound = ["cramer_rao"] if "cramer_rao" in answers else []
    asked = status[names].notna().all(axis=1)
    wide = answers[names + bound][asked & answers["vmf"].notna()].fillna(_NO_ANSWER)
    n, k = len(wide), len(of_kind)
    magnitudes = np.array([step.magnitude for step in of_kind])
    values = wide.to_numpy(float)
    if n == 0:
        return _Comparison([], (0, int(asked.sum()), magnitudes[-1], np.nan, np.nan, np.nan))
    medians = np.median(values, axis=0)
    trial, frame = (wide.index.get_level_values(key).to_numpy(np.int64) for key in ("trial", "frame"))
    clusters = question_clusters(trial, frame, case)
    drawn = resampled_medians(values, rng, resamples, clusters)
    low, high = np.percentile(drawn, [2.5, 97.5], axis=0, method="nearest")
    places = [np.nan, *magnitudes, *(np.nan for _ in bound)]
    whose = ["vmf", *(step.method for step in of_kind), *bound]
    curves = [
        (name, (float(x), n, _known(m), _known(a), _known(b)))
        for name, x, m, a, b in zip(whose, places, medians, low, high, strict=True)
    ]
    behind = crossover(magnitudes, medians[None, 1 : k + 1] - medians[0])[0]
    # Beyond the last error is a rank like any other to a percentile that takes no mean of two.
    ends = crossover(magnitudes, drawn[:, 1 : k + 1] - drawn[:, :1])
    first, last = np.percentile(ends, [2.5, 97.5], method="nearest")
    behind, first, last = (float(x) if np.isfinite(x) else np.nan for x in (behind, first, last))
    return _Comparison(curves, (n, int(asked.sum()), float(magnitudes[-1]), behind, first, last))


def _known(error: float) -> float:
    return float(error) if error < _NO_ANSWER else float("nan")


def crossover(magnitudes: Floats, difference: Floats) -> Floats:
    """Return from which error on (R,) a rival stays behind, interpolated; infinite if not at the last one.

    Parameters
    ----------
    magnitudes : (k,) errors, increasing from 0.
    difference : (R, k) how far the rival is behind at each of them.
    """
    ahead = difference <= 0.0
    k = len(magnitudes)
    last = np.where(ahead.any(axis=1), k - 1 - ahead[:, ::-1].argmax(axis=1), -1)
    i = np.clip(last, 0, k - 2)
    rows = np.arange(len(difference))
    a, b = difference[rows, i], difference[rows, i + 1]
    share = np.where(b > a, -a / np.where(b > a, b - a, 1.0), 0.0)
    between = magnitudes[i] + share * (magnitudes[i + 1] - magnitudes[i])
    return np.where(last < 0, 0.0, np.where(last == k - 1, np.inf, between))
