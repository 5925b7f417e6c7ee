"""Ways to make Θ_S out of visited codes, compared: accuracy, memory, time and growth (§4.2)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from vmf.approximate import Approximator, make_approximator
from vmf.errors import Loss
from vmf.estimate import in_gauge
from vmf.geometry import stereo_code
from vmf.spec.approximators import AnyApproximator
from vmf.spec.studies import ApproximatorsStudy
from vmf.study.result import Drawing, Quantity, StudyResult
from vmf.study.rig import rig_cameras, visible_points
from vmf.tasks import make_task

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Pairs:
    """Codes (N, 4) in px with analytic parameters (N, 3, 13) of the left camera, unit-depth gauge."""

    codes: Floats
    rows: Floats

    def of(self, gauge: str) -> Floats:
        """Return the parameters (N, 39) in a gauge."""
        return in_gauge(self.rows, gauge, make_task("six_dof").identity_lift).reshape(len(self.rows), -1)


@dataclass(frozen=True)
class Score:
    """How an approximator did after so many codes, and what it holds.

    Attributes
    ----------
    parameter_error : root mean square error over the spread, of all that vary; NaN without answers.
    pixel_error_px : median distance between predicted and true pixels after a motion.
    answered : share of the test codes that have an answer.
    memory_bytes : of all arrays that make an equal approximator.
    """

    parameter_error: float
    pixel_error_px: float
    answered: float
    memory_bytes: int


def approximators(settings: ApproximatorsStudy) -> StudyResult:
    """Train every approximator with more and more codes, and ask it about others."""
    from vmf.study.figures.approximators import draw_growth, draw_times

    rng = np.random.default_rng(settings.seed)
    train, test = (_pairs(settings, n, rng) for n in (max(settings.codes), settings.tests))
    lifts = _lifts(settings, rng)
    noise = rng.standard_normal((max(settings.codes), train.rows[0].size))
    kinds = labels(settings.approximators)
    quantities, rows = [], []
    for share in settings.noise:
        for label, model in kinds.items():
            case = label if share == 0.0 else f"{label}, noise {100 * share:g} %"
            for n in settings.codes:
                score = _score(model, train, noise, share, n, test, lifts)
                quantities += _quantities(case, n, settings.tests, score)
                rows.append((label, share, n, *vars(score).values()))
    columns = ["approximator", "noise", "codes", *Score.__annotations__]
    growth = pd.DataFrame(rows, columns=columns)
    quantities += _exponents(growth, settings)
    drawings: dict[str, Drawing] = {"growth": partial(draw_growth, settings, growth)}
    if settings.timed:
        times = _times(kinds, train, test, settings)
        quantities += times
        drawings["time_ratios"] = partial(draw_times, settings, times)
    best = growth.groupby("approximator", sort=False)["answered"].max()
    silent = [str(label) for label, share in best.items() if share == 0.0]
    losses = tuple(Loss(label, "no test code has an answer", settings.tests) for label in silent)
    return StudyResult(tuple(quantities), {"growth": growth}, drawings, losses=losses)


def labels(models: tuple[AnyApproximator, ...]) -> dict[str, AnyApproximator]:
    """Return approximators by kind; of several of one kind, with what tells them apart."""
    counted = Counter(model.kind for model in models)
    found: dict[str, AnyApproximator] = {}
    for model in models:
        label: str = model.kind
        if counted[model.kind] > 1:
            own = {key: str(value) for key, value in model.model_dump(exclude={"kind"}).items()}
            others = [m.model_dump(exclude={"kind"}) for m in models if m.kind == model.kind]
            differing = [own[key] for key in own if len({str(other[key]) for other in others}) > 1]
            label = f"{model.kind} ({', '.join(differing)})" if differing else label
        found[label] = model
    return found


def _pairs(settings: ApproximatorsStudy, n: int, rng: np.random.Generator) -> Pairs:
    cameras = rig_cameras(settings.rig)
    P = visible_points(settings.box, settings.rig, n, rng)
    return Pairs(stereo_code(cameras, P)[0], make_task("six_dof").parameters(cameras.left, P))


def _lifts(settings: ApproximatorsStudy, rng: np.random.Generator) -> Floats:
    """Return the lift (M, 13) of a random motion for each test code."""
    task = make_task("six_dof")
    reach = np.repeat([settings.turn_rad, settings.move_m], 3)
    return task.lift(task.motion(rng.uniform(-reach, reach, (settings.tests, 6)), np.eye(4)))


def made(model: AnyApproximator) -> Approximator:
    """Return a new approximator as a model describes it."""
    return make_approximator(model.kind, **model.model_dump(exclude={"kind", "gauge"}))


def _gauge(model: AnyApproximator) -> str:
    return str(getattr(model, "gauge", "unit_depth"))


def _score(
    model: AnyApproximator, train: Pairs, noise: Floats, share: float, n: int, test: Pairs, lifts: Floats
) -> Score:
    theta, true = train.of(_gauge(model)), test.of(_gauge(model))
    spread = true.std(axis=0)
    approximator = made(model)
    approximator.partial_fit(train.codes[:n], theta[:n] + share * spread * noise[:n])
    found = approximator.predict(test.codes).parameters
    memory = sum(array.nbytes for array in approximator.state().values())
    answered = ~np.isnan(found).any(axis=1)
    if not answered.any():
        return Score(np.nan, np.nan, 0.0, memory)
    varying = spread > 1e-9 * np.abs(true).max()
    relative = (found - true)[answered][:, varying] / spread[varying]
    off = _pixels(found[answered], lifts[answered]) - _pixels(true[answered], lifts[answered])
    return Score(
        float(np.sqrt(np.square(relative).mean())),
        float(np.median(np.linalg.norm(off, axis=-1))),
        float(answered.mean()),
        memory,
    )


def _pixels(theta: Floats, lifts: Floats) -> Floats:
    """Return the image-based errors (M, 2) that motions make: `a·x̄/c·x̄`, `b·x̄/c·x̄`."""
    abc = np.einsum("mrk,mk->mr", theta.reshape(len(theta), 3, -1), lifts)
    return np.asarray(abc[:, :2] / abc[:, 2:])


def _quantities(case: str, n: int, tests: int, score: Score) -> list[Quantity]:
    component = f"codes={n}"
    found = [
        Quantity("answered_share", score.answered, case, component, n=tests),
        Quantity("memory", score.memory_bytes, case, component, "B"),
    ]
    if score.answered > 0.0:
        answered = round(score.answered * tests)
        found += [
            Quantity("parameter_error", score.parameter_error, case, component, n=answered),
            Quantity("prediction_error_median", score.pixel_error_px, case, component, "px", answered),
        ]
    return found


def _exponents(growth: pd.DataFrame, settings: ApproximatorsStudy) -> list[Quantity]:
    """Return with which power of the number of codes memory grows at last."""
    if len(settings.codes) < 2:
        return []
    first = growth[growth["noise"] == settings.noise[0]]
    found = []
    for label, rows in first.groupby("approximator", sort=False):
        rows = rows.sort_values("codes").tail(2)
        ends = np.log(rows[["codes", "memory_bytes"]].to_numpy(float))
        slope = (ends[1, 1] - ends[0, 1]) / (ends[1, 0] - ends[0, 0])
        found.append(Quantity("memory_growth_exponent", float(slope), str(label)))
    return found


def _times(
    kinds: Mapping[str, AnyApproximator], train: Pairs, test: Pairs, settings: ApproximatorsStudy
) -> list[Quantity]:
    """Return times of training and asking over those of the first approximator, taken in turns."""
    from vmf.bench.clock import in_turns

    n = min(settings.timed, len(train.codes))

    def trained(model: AnyApproximator) -> Approximator:
        approximator = made(model)
        approximator.partial_fit(train.codes[:n], train.of(_gauge(model))[:n])
        return approximator

    def asked(approximator: Approximator) -> Any:
        return approximator.predict(test.codes)

    training: dict[str, Callable[[], Any]] = {name: partial(trained, m) for name, m in kinds.items()}
    asking: dict[str, Callable[[], Any]] = {name: partial(asked, trained(m)) for name, m in kinds.items()}
    found = []
    for quantity, works in (("time_training_ratio", training), ("time_asking_ratio", asking)):
        times = in_turns(works, settings.repeats)
        reference = times[next(iter(works))].seconds
        for name, mine in times.items():
            ratios = mine.seconds / reference
            found.append(Quantity(quantity, float(np.median(ratios)), name, f"codes={n}", n=len(ratios)))
    return found
