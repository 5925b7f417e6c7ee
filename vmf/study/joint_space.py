"""Parameters over joint angles instead of SE(3), so that no kinematics needs to be known (Ch. 6)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from vmf.approximate import Polynomial
from vmf.errors import InputError, Loss
from vmf.estimate import MlEstimator, unit_depth_gauge
from vmf.geometry import StereoCameras, in_view, inverse, stereo_code
from vmf.optimise import levenberg_marquardt
from vmf.solve import COSTS, by_row, views
from vmf.spec.studies import JointSpaceStudy
from vmf.study.arm import Arm, JointLift, KinematicLift, TrigonometricLift
from vmf.study.result import Quantity, StudyResult, mean_quantity
from vmf.study.rig import rig_cameras, visible_points

Floats = NDArray[np.float64]

# The most joints whose unknowns are counted.
_MOST_JOINTS = 7
_TRIES = 400
# Targets fitted at once.
_CHUNK = 4


@dataclass(frozen=True)
class World:
    """An arm that carries a rig in front of targets.

    Attributes
    ----------
    arm, home : the true arm, and its angles (n,) in rad at home.
    cameras, size : the true cameras, and their images' width and height (px).
    """

    arm: Arm
    home: Floats
    cameras: StereoCameras
    size: tuple[int, int]

    def codes(self, delta: Floats, P_home: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """Return codes (…, 4) of points (…, 3) of S at home after joint motions (…, n), and if in view."""
        E = self.arm.E_S_from_W(self.home + delta) @ inverse(self.arm.E_S_from_W(self.home))
        P = (E[..., :3, :3] @ P_home[..., None])[..., 0] + E[..., :3, 3]
        codes, depth = stereo_code(self.cameras, P)
        return codes, in_view(codes, depth, self.size)


@dataclass(frozen=True)
class Questions:
    """What Q joint motions from home make of n targets.

    Attributes
    ----------
    delta : (Q, n_joints) true motions in rad.
    before, after : (Q, n, 4) codes with noise.
    target : (Q, n) which of training, −1 for none.
    """

    delta: Floats
    before: Floats
    after: Floats
    target: NDArray[np.int64]


@dataclass(frozen=True)
class Method:
    """A function and what it is solved with; both are the same unless the arm was changed after training."""

    name: str
    learned: JointLift
    solved: JointLift


def joint_space(settings: JointSpaceStudy) -> StudyResult:
    """Learn over joints and over SE(3) from the same frames, and ask both for joint motions."""
    from vmf.study.figures.joint_space import draw_errors, draw_unknowns

    rng = np.random.default_rng(settings.seed)
    world = World(
        Arm(settings.links),
        np.array(settings.home_rad),
        rig_cameras(settings.rig),
        (settings.rig.width_px, settings.rig.height_px),
    )
    P = visible_points(settings.box, settings.rig, settings.targets, rng)
    delta, clean, noise = _frames(settings, world, P, rng)
    pixels = clean + noise
    asked = {
        "trained_code": _questions(settings, world, rng, P),
        "held_out": _questions(settings, world, rng, None),
    }
    rows = []
    for n in settings.frames:
        for method in methods(settings, world):
            rows_home = learn(method.learned, delta[:n], pixels[:n])
            for protocol, questions in asked.items():
                visited = pixels[: settings.home_visits]
                parameters = _parameters(method.learned, visited, rows_home, questions)
                found, converged = solve_joints(method.solved, parameters, questions)
                rows += _errors(n, method.name, protocol, questions, found, converged)
    for protocol, questions in asked.items():
        still = np.zeros_like(questions.delta)
        rows += _errors(
            max(settings.frames), "no motion", protocol, questions, still, np.ones(len(still), bool)
        )
    errors = pd.DataFrame(
        rows, columns=["frames", "method", "protocol", "question", "joint", "truth", "estimate", "converged"]
    )
    exact = _questions(settings.model_copy(update={"pixel_px": 0.0}), world, rng, P)
    quantities = [
        *_error_quantities(errors),
        *_model_quantities(settings, world, delta, clean, exact),
        *_unknown_quantities(settings),
        *_configuration_quantities(settings, world, rng),
    ]
    drawings = {
        "errors": partial(draw_errors, settings, errors),
        "unknowns": partial(draw_unknowns, settings, list(_unknown_quantities(settings))),
    }
    return StudyResult(tuple(quantities), {"errors": errors}, drawings, losses=_unanswered(errors))


def _unanswered(errors: pd.DataFrame) -> tuple[Loss, ...]:
    """Return which functions answered no question of a kind, however much they had learned."""
    by_kind = errors.groupby(["method", "protocol"], sort=False)
    return tuple(
        Loss(f"{method}, {protocol}", "no question has an answer", rows["question"].nunique())
        for (method, protocol), rows in by_kind
        if not rows["converged"].any()
    )


def methods(settings: JointSpaceStudy, world: World) -> Iterator[Method]:
    """Yield the function over joints, and those over SE(3) with right and wrong kinematics."""
    joints = TrigonometricLift(world.arm.n_joints)
    yield Method("joint space", joints, joints)
    exact = KinematicLift(world.arm, world.home)
    yield Method("SE(3), exact kinematics", exact, exact)
    for error in settings.wrong:
        lift = KinematicLift(Arm(settings.links, error), world.home)
        yield Method(f"SE(3), {error.name}", exact if error.after_training else lift, lift)


def _frames(
    settings: JointSpaceStudy, world: World, P: Floats, rng: np.random.Generator
) -> tuple[Floats, Floats, Floats]:
    """Return joint motions from home (N, n), codes (N, K, 4), NaN out of view, and the noise on them."""
    n, reach = world.arm.n_joints, settings.reach_rad
    delta = rng.uniform(-reach, reach, (max(settings.frames), n))
    delta[: settings.home_visits] = 0.0
    codes, seen = world.codes(delta[:, None, :], P)
    noise = settings.pixel_px * rng.standard_normal(codes.shape)
    return delta, np.where(seen[..., None], codes, np.nan), noise


def _questions(
    settings: JointSpaceStudy, world: World, rng: np.random.Generator, P_trained: Floats | None
) -> Questions:
    """Return questions about targets of training, or about new ones; all are in view before and after.

    Raises
    ------
    InputError : hardly any motion leaves them there.
    """
    Q, n, reach = settings.questions, settings.question_targets, settings.reach_rad
    if P_trained is None:
        which = np.full((_TRIES * Q, n), -1)
        P = visible_points(settings.box, settings.rig, len(which) * n, rng).reshape(-1, n, 3)
    else:
        order = rng.permuted(np.tile(np.arange(len(P_trained)), (_TRIES * Q, 1)), axis=1)
        which = order[:, :n]
        P = P_trained[which]
    delta = rng.uniform(-reach, reach, (len(which), world.arm.n_joints))
    after, seen = world.codes(delta[:, None, :], P)
    kept = np.flatnonzero(seen.all(axis=1))[:Q]
    if len(kept) < Q:
        raise InputError(
            f"study.reach_rad: {len(kept)} of {len(which)} motions leave the targets in view, "
            f"at least {Q} are accepted"
        )
    before, _ = world.codes(np.zeros_like(delta[kept, None, :]), P[kept])
    noise = settings.pixel_px * rng.standard_normal((2, Q, n, 4))
    return Questions(delta[kept], before + noise[0], after[kept] + noise[1], which[kept])


def learn(lift: JointLift, delta: Floats, pixels: Floats) -> Floats:
    """Return every target's parameters at home (K, 2, 3, k+1), unit-depth gauge.

    The pixel of a target is a projective camera of the lift; fitted by least reprojection error, the camera
    says where the target is at home, and `e` is the pixel less that.
    """
    K = pixels.shape[1]
    views = np.moveaxis(pixels.reshape(len(delta), K, 2, 2), 0, 2).reshape(2 * K, len(delta), 2)
    views = views - np.nanmean(views, axis=1, keepdims=True)
    x_bar, rest = lift.lift(delta), lift.lift(np.zeros(delta.shape[1]))
    fits = []
    # A few at a time: all at once need gigabytes.
    for begin in range(0, 2 * K, _CHUNK):
        some = views[begin : begin + _CHUNK]
        estimator = MlEstimator(lift.size, len(some))
        estimator.partial_fit(np.broadcast_to(x_bar, (len(some), *x_bar.shape)), some)
        fits.append(estimator.estimate().rows)
    rows = unit_depth_gauge(np.concatenate(fits), rest)
    at_home = rows[:, :2] @ rest
    rows[:, :2] -= at_home[..., None] * rows[:, 2:]
    return rows.reshape(K, 2, 3, lift.size)


def _parameters(lift: JointLift, visited: Floats, rows: Floats, questions: Questions) -> Floats:
    """Return parameters (Q, n, 2, 3, k+1): a trained target's own, or by a polynomial over visited codes.

    `visited` (V, K, 4) are the codes that the targets had at home.
    """
    if bool((questions.target >= 0).all()):
        return np.asarray(rows[questions.target])
    polynomial = Polynomial(degree=2)
    known = np.flatnonzero(np.isfinite(rows).all(axis=(1, 2, 3)))
    codes = visited[:, known].reshape(-1, 4)
    polynomial.partial_fit(codes, np.tile(rows[known].reshape(len(known), -1), (len(visited), 1)))
    found = polynomial.predict(questions.before.reshape(-1, 4)).parameters
    return found.reshape(*questions.target.shape, 2, 3, lift.size)


def solve_joints(lift: JointLift, rows: Floats, questions: Questions) -> tuple[Floats, NDArray[np.bool_]]:
    """Return joint motions (Q, n) by least reprojection error from no motion, NaN for none; if converged."""
    Q, n_joints = questions.delta.shape
    flat = rows.reshape(Q, -1, 3, lift.size)
    e = (questions.after - questions.before).reshape(Q, -1, 2)
    usable: NDArray[np.bool_] = np.asarray(np.isfinite(flat).all(axis=(1, 2, 3)))
    rest = lift.lift(np.zeros(n_joints))
    blank = np.zeros((3, lift.size))
    blank[2] = rest / (rest @ rest)
    flat = np.where(usable[:, None, None, None], flat, blank)

    rows, e = by_row(flat), e.swapaxes(1, 2)

    def problem(x: Floats, index: NDArray[np.int64]) -> tuple[Floats, Floats]:
        r, J = COSTS["geometric"](views(rows[index], lift.lift(x), lift.jacobian(x)), e[index])
        A = len(index)
        return r.reshape(A, -1), J.reshape(A, n_joints, -1).swapaxes(1, 2)

    fit = levenberg_marquardt(problem, np.zeros((Q, n_joints)))
    return np.where(usable[:, None], fit.x, np.nan), fit.converged & usable


def _errors(
    frames: int,
    method: str,
    protocol: str,
    questions: Questions,
    found: Floats,
    converged: NDArray[np.bool_],
) -> list[tuple[int, str, str, int, int, float, float, bool]]:
    return [
        (
            frames,
            method,
            protocol,
            int(q),
            int(j) + 1,
            float(questions.delta[q, j]),
            float(found[q, j]),
            bool(converged[q]),
        )
        for q, j in np.ndindex(found.shape)
    ]


def error_norms(errors: pd.DataFrame) -> pd.DataFrame:
    """Return the norm of the joints' errors (rad), one row per frames, method, protocol and question."""
    keys = ["frames", "method", "protocol", "question"]
    square = (errors["estimate"] - errors["truth"]) ** 2
    sums = errors[keys].assign(error_rad=square).groupby(keys, sort=False, as_index=False)
    # Without an answer there is no norm.
    norms = pd.DataFrame(sums.sum(min_count=len(errors["joint"].unique())))
    norms["error_rad"] **= 0.5
    return norms


def _error_quantities(errors: pd.DataFrame) -> Iterator[Quantity]:
    last = errors["frames"].max()
    for (frames, method, protocol), rows in error_norms(errors).groupby(
        ["frames", "method", "protocol"], sort=False
    ):
        component = f"{protocol}, frames={frames}"
        known = rows["error_rad"].dropna().to_numpy(float)
        yield Quantity("answered_share", len(known) / len(rows), str(method), component, n=len(rows))
        if len(known):
            yield mean_quantity("joint_error_mean", known, str(method), component, "rad")
            median = float(np.median(known))
            yield Quantity("joint_error_median", median, str(method), component, "rad", len(known))
    ends = errors[errors["frames"] == last]
    for (method, protocol, joint), rows in ends.groupby(["method", "protocol", "joint"], sort=False):
        off = (rows["estimate"] - rows["truth"]).abs().dropna().to_numpy(float)
        if len(off):
            yield mean_quantity("abs_error_mean", off, str(method), f"{protocol}, joint={joint}", "rad")


def _model_quantities(
    settings: JointSpaceStudy, world: World, delta: Floats, clean: Floats, questions: Questions
) -> Iterator[Quantity]:
    """Yield the errors that are left without noise: what a lift cannot express."""
    for method in methods(settings, world):
        rows = learn(method.learned, delta, clean)
        found, _ = solve_joints(method.solved, rows[questions.target], questions)
        off = np.linalg.norm(found - questions.delta, axis=1)
        yield Quantity("model_error_median", float(np.median(off)), method.name, unit="rad", n=len(off))


def _unknown_quantities(settings: JointSpaceStudy) -> Iterator[Quantity]:
    """Yield parameters of one target in one camera: over SE(3), and over one to seven joints."""
    yield Quantity("unknowns", 38, "SE(3)")
    for n in range(1, _MOST_JOINTS + 1):
        yield Quantity("unknowns", TrigonometricLift(n).unknowns, "joint space", f"joints={n}")


def _configuration_quantities(
    settings: JointSpaceStudy, world: World, rng: np.random.Generator
) -> Iterator[Quantity]:
    """Yield how far the errors of one code after one joint motion differ from one configuration to another.

    A motion E' is seen alike wherever the arm is. A joint motion is not: the joints beyond the first turn the
    axes before them, so Θ over joints is a function of the code at one configuration only.
    """
    Q, reach = settings.questions, settings.reach_rad
    P = visible_points(settings.box, settings.rig, Q, rng)
    delta, other = rng.uniform(-reach, reach, (2, Q, world.arm.n_joints))
    before, _ = stereo_code(world.cameras, P)
    at_home, _ = world.codes(delta, P)
    for case, moved in (("first joint", np.eye(world.arm.n_joints)[0]), ("all joints", 1.0)):
        elsewhere = World(world.arm, world.home + other * moved, world.cameras, world.size)
        codes, _ = elsewhere.codes(delta, P)
        change = np.linalg.norm((codes - at_home)[:, :2], axis=1)
        motion = np.linalg.norm((at_home - before)[:, :2], axis=1)
        yield Quantity("configuration_change_median", float(np.median(change)), case, unit="px", n=Q)
        yield Quantity("configuration_change_share", float(np.median(change / motion)), case, n=Q)
