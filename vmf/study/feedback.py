"""The visuomotor function as feedback: velocities from its derivative, and a Lyapunov function (Ch. 6)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from vmf.approximate import make_approximator
from vmf.data.simulate import simulate
from vmf.errors import InputError, Loss
from vmf.geometry import in_view, inverse, rotation_angle, stereo_code
from vmf.learn import Learner, StructuredLearner, TransportLearner
from vmf.solve import COSTS, by_row, views
from vmf.spec.model import Data, Noise, Simulate, Spec, Workspace
from vmf.spec.studies import FeedbackStudy
from vmf.study.result import Quantity, StudyResult
from vmf.study.rig import rig_cameras, visible_points
from vmf.tasks import Task, make_task

Floats = NDArray[np.float64]

# rows(codes (Q, n, 4), points in S (Q, n, 3)) -> parameters (Q, n, 2, 3, 13); the learned know no points.
Rows = Callable[[Floats, Floats], Floats]

# Errors this small (px, of the norm) are where a start has arrived, and nothing is said of V below.
_ARRIVED_PX = 0.1
# V may grow by rounding.
_ROUNDING = 1e-9
_TRIES = 1000


@dataclass(frozen=True)
class Runs:
    """Everything that Q starts did in T + 1 instants.

    Attributes
    ----------
    gain : (Q,) λ in 1/s.
    error_px : (T + 1, Q) norm of s* − s, without noise.
    rate : (T, Q) `eᵀ J Ĵ⁺ e / eᵀe` with the true J: V̇ = −2 λ rate V.
    pixels : (T + 1, Q, n, 4) codes, without noise.
    position_m, angle_rad : (Q,) how far from the goal it ended.
    unknown : how many of the T Q velocities were none for want of parameters.
    """

    gain: Floats
    error_px: Floats
    rate: Floats
    pixels: Floats
    position_m: Floats
    angle_rad: Floats
    unknown: int


def feedback(settings: FeedbackStudy) -> StudyResult:
    """Servo from random starts with every source of parameters, and watch V = ½‖s* − s‖²."""
    from vmf.study.figures.feedback import draw_lyapunov, draw_paths

    rng = np.random.default_rng(settings.seed)
    P_W = visible_points(settings.box, settings.rig, settings.targets, rng)
    E_start = _starts(settings, P_W, rng)
    quantities: list[Quantity] = []
    done: dict[tuple[str, float], Runs] = {}
    rows: list[pd.DataFrame] = []
    losses: list[Loss] = []
    # Between two instants the velocity stays: near the goal e becomes (1 − λ/rate) e.
    hasty = [gain for gain in settings.gains_per_s if gain >= 2.0 * settings.rate_hz]
    notes = [
        f"gain {gain:g}/s at {settings.rate_hz:g} velocities a second cannot be stable: below "
        f"{2.0 * settings.rate_hz:g}/s an error shrinks from one to the next"
        for gain in hasty
    ]
    for source in settings.sources:
        parameters = _parameters(settings, source)
        for noise_px in settings.pixel_px:
            runs = done[source, noise_px] = servo(settings, P_W, E_start, parameters, noise_px)
            case = source if noise_px == 0.0 else f"{source}, {noise_px:g} px"
            quantities += _quantities(settings, case, runs, noise_px)
            rows.append(_table(settings, case, runs))
            if runs.unknown == runs.rate.size:
                losses.append(Loss(case, "no velocity had parameters", runs.unknown))
            elif runs.unknown:
                notes.append(f"{case}: {runs.unknown} of {runs.rate.size} velocities had no parameters")
    drawings = {
        "lyapunov": partial(draw_lyapunov, settings, done),
        "paths": partial(draw_paths, settings, done),
    }
    table = pd.concat(rows, ignore_index=True)
    return StudyResult(tuple(quantities), {"lyapunov": table}, drawings, tuple(notes), tuple(losses))


def _starts(settings: FeedbackStudy, P_W: Floats, rng: np.random.Generator) -> Floats:
    """Return poses (n, 4, 4) of S from W that show every target; the goal is the identity."""
    task, cameras = make_task("six_dof"), rig_cameras(settings.rig)
    reach = np.repeat([settings.turn_rad, settings.travel_m], 3)
    E = inverse(task.motion(rng.uniform(-reach, reach, (_TRIES * settings.starts, 6)), np.eye(4)))
    P = _in_S(E, P_W)
    size = (settings.rig.width_px, settings.rig.height_px)
    found = E[in_view(*stereo_code(cameras, P), size).all(axis=1)][: settings.starts]
    if len(found) < settings.starts:
        raise InputError(
            f"study.travel_m and turn_rad: {len(found)} of {len(E)} starts show all targets, "
            f"at least {settings.starts} are accepted"
        )
    return found


def _in_S(E: Floats, P_W: Floats) -> Floats:
    """Return points (Q, n, 3) in S of poses (Q, 4, 4)."""
    return np.asarray(P_W @ np.swapaxes(E[:, :3, :3], -1, -2) + E[:, None, :3, 3])


def _parameters(settings: FeedbackStudy, source: str) -> Rows:
    """Return the function of codes that a source of parameters is.

    Raises
    ------
    InputError : nothing could be learned.
    """
    task = make_task("six_dof")
    if source == "analytic":
        M = rig_cameras(settings.rig).M
        return lambda codes, P: task.parameters(M, P[:, :, None, :])
    learner = _trained(settings, task, source)

    def rows(codes: Floats, P: Floats) -> Floats:
        return learner.parameters(codes.reshape(-1, 4)).rows.reshape(*codes.shape[:2], 2, 3, -1)

    return rows


def _trained(settings: FeedbackStudy, task: Task, source: str) -> Learner:
    training, box = settings.training, settings.box
    workspace = Workspace(
        target_low_m=box.low_m,
        target_high_m=box.high_m,
        travel_m=training.travel_m,
        angle_rad=training.angle_rad,
    )
    data = Simulate(rig=settings.rig, frames=training.frames, targets=training.targets, workspace=workspace)
    spec = Spec(task="six_dof", data=Data(simulate=data), noise=Noise(pixel_px=training.pixel_px))
    tracks = simulate(spec, np.random.default_rng((settings.seed, 1))).tracks
    learner: Learner
    if source == "structured":
        learner = StructuredLearner(task)
    else:
        learner = TransportLearner(task, partial(make_approximator, "polynomial", degree=2))
    learner.partial_fit(tracks)
    if learner.refused is not None:
        raise InputError(f"study.training: {source} learned nothing: {learner.refused}")
    return learner


def interaction_matrix(task: Task, rows: Floats) -> Floats:
    """Return `∂e/∂p` (Q, 4n, 6) at no motion by parameters (Q, n, 2, 3, k+1): pixels for velocities."""
    Q = len(rows)
    rest = np.broadcast_to(task.identity_lift, (Q, task.n_lift + 1))
    flat = rows.reshape(Q, -1, 3, task.n_lift + 1)
    J_lift = task.lift_jacobian(np.zeros(task.n_motion), np.eye(4))
    W = views(by_row(flat), rest, J_lift)
    _, J = COSTS["geometric"](W, np.zeros((Q, 2, flat.shape[1])))
    # The coordinates of a pixel side by side.
    return np.asarray(J.transpose(0, 3, 2, 1).reshape(Q, -1, task.n_motion))


# A gain that is not stable leaves the numbers; what is not finite is then no parameters.
@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def servo(settings: FeedbackStudy, P_W: Floats, E_start: Floats, parameters: Rows, noise_px: float) -> Runs:
    """Apply velocities `λ J⁺ (s* − s)` from every start with every gain, all at once."""
    task, cameras = make_task("six_dof"), rig_cameras(settings.rig)
    rng = np.random.default_rng((settings.seed, 2))
    gain = np.repeat(np.array(settings.gains_per_s), len(E_start))
    E = np.tile(E_start, (len(settings.gains_per_s), 1, 1))
    goal, _ = stereo_code(cameras, P_W)
    true = _parameters(settings, "analytic")
    errors, rates, pixels, unknown = [], [], [], 0
    steps = round(settings.duration_s * settings.rate_hz)
    for step in range(steps + 1):
        P = _in_S(E, P_W)
        codes, _ = stereo_code(cameras, P)
        e = (goal - codes).reshape(len(E), -1)
        errors.append(np.linalg.norm(e, axis=1))
        pixels.append(codes)
        if step == steps:
            break
        seen = codes + noise_px * rng.standard_normal(codes.shape)
        J = interaction_matrix(task, parameters(seen, P))
        wanted = (goal - seen).reshape(len(E), -1)
        known = np.asarray(np.isfinite(J).all(axis=(1, 2)) & np.isfinite(wanted).all(axis=1))
        unknown += int((~known).sum())
        # Without parameters, the robot stays where it is.
        J, wanted = np.where(known[:, None, None], J, 0.0), np.where(known[:, None], wanted, 0.0)
        velocity = (np.linalg.pinv(J) @ wanted[..., None])[..., 0]
        # What the images really do with this velocity.
        moved = (interaction_matrix(task, true(codes, P)) @ velocity[..., None])[..., 0]
        rates.append((e * moved).sum(axis=1) / np.square(e).sum(axis=1))
        E = task.motion(gain[:, None] * velocity / settings.rate_hz, np.eye(4)) @ E
    away = inverse(E)
    return Runs(
        gain,
        np.array(errors),
        np.array(rates),
        np.array(pixels),
        np.linalg.norm(away[:, :3, 3], axis=1),
        rotation_angle(away),
        unknown,
    )


def _quantities(settings: FeedbackStudy, case: str, runs: Runs, noise_px: float) -> list[Quantity]:
    found = []
    for gain in settings.gains_per_s:
        mine = runs.gain == gain
        error, rate, n = runs.error_px[:, mine], runs.rate[:, mine], int(mine.sum())
        component = f"gain={gain:g}"
        add = partial(Quantity, case=case, component=component, n=n)
        # Asymptotic stability is about the way there: at the goal, V is rounding or noise.
        nearest = max(_ARRIVED_PX, 10 * noise_px * np.sqrt(4 * settings.targets))
        under_way = np.asarray(error[:-1] > nearest)
        grown = np.asarray(under_way & (np.diff(error, axis=0) > _ROUNDING * error[:-1]))
        steps = int(under_way.sum())
        found += [
            add("steps_under_way", float(steps), unit="1"),
            add("final_error_median", float(np.median(error[-1])), unit="px"),
            add("final_position_median", float(np.median(runs.position_m[mine])), unit="m"),
            add("final_angle_median", float(np.median(runs.angle_rad[mine])), unit="rad"),
            add("decreased_share", float((error[-1] < error[0]).mean())),
        ]
        if noise_px == 0.0:
            found.append(add("arrived_share", float((error[-1] < _expected(settings, gain, error)).mean())))
        if steps:
            found += [
                Quantity("lyapunov_increases_share", float(grown.sum() / steps), case, component, n=steps),
                Quantity("lyapunov_rate_min", float(rate[under_way].min()), case, component, n=steps),
                Quantity("lyapunov_rate_median", float(np.median(rate[under_way])), case, component, n=steps),
            ]
    return found


def _expected(settings: FeedbackStudy, gain: float, error: Floats) -> Floats:
    """Return the errors (n,) that count as arrived: ten times what `e^(−λt)` leaves of the first."""
    return np.asarray(10.0 * error[0] * np.exp(-gain * settings.duration_s))


def _table(settings: FeedbackStudy, case: str, runs: Runs) -> pd.DataFrame:
    """Return V over its first value: one row per instant and gain, median and worst over starts."""
    V = np.square(runs.error_px / runs.error_px[0])
    parts = []
    for gain in settings.gains_per_s:
        mine = V[:, runs.gain == gain]
        columns = {"case": case, "gain_per_s": gain, "time_s": np.arange(len(mine)) / settings.rate_hz}
        spread = {"median": np.median(mine, axis=1), "lowest": mine.min(axis=1), "highest": mine.max(axis=1)}
        parts.append(pd.DataFrame({**columns, **{f"V_{name}": v for name, v in spread.items()}}))
    return pd.concat(parts, ignore_index=True)
