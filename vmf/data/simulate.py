"""Simulated robots: noise-free truth, and the noisy observations a robot would record."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from vmf.data import workspace
from vmf.data.poses import BodyPoses, PanTiltJoints, Poses
from vmf.data.query import Query, Truth
from vmf.data.tracks import Tracks, from_dense
from vmf.errors import InputError
from vmf.geometry import StereoCameras, from_rotation_translation, in_view, inverse, parallel_rig
from vmf.geometry.camera import R_CAMERA_FROM_BODY
from vmf.spec.model import LostTracker, Noise, Rig, Simulate, Spec
from vmf.tasks import Task, make_task

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
START_NS = 1_000_000_000_000_000_000


@dataclass(frozen=True)
class World:
    """A simulated rig and the targets around it, fixed for one trial.

    Attributes
    ----------
    task, mounting : what moves.
    cameras : the exact cameras, for simulating and for the rivals; hidden from the learner.
    image_size : (width, height) px.
    region : the workspace.
    """

    task: Task
    mounting: str
    cameras: StereoCameras
    image_size: tuple[int, int]
    region: workspace.Region


@dataclass(frozen=True)
class Simulation:
    """One simulated recording.

    Attributes
    ----------
    world : rig and workspace.
    tracks : what the learner sees.
    poses : the poses or joints as recorded, noise included.
    targets_W : (K, 3) true targets in W (m).
    E_true : (N, 4, 4) true poses `E_S_from_W`.
    clean : (N, K, 4) true pixels.
    noise_px : (N, K, 4) Gaussian noise on them.
    """

    world: World
    tracks: Tracks
    poses: Poses
    targets_W: Floats
    E_true: Floats
    clean: Floats
    noise_px: Floats


@dataclass(frozen=True)
class Disturbed:
    """What is seen of targets that have moved after training.

    Attributes
    ----------
    pixels : (N, K, 4) px, NaN where a target has left the images.
    moved_W : (N, K, 3) how far it has moved, in W (m).
    noise_px : (N, K, 4) Gaussian noise on the pixels.
    """

    pixels: Floats
    moved_W: Floats
    noise_px: Floats


def rig(model: Rig) -> tuple[Floats, tuple[int, int]]:
    """Return the intrinsic matrix K (3, 3) of both cameras and the image size of a rig."""
    K = np.array([[model.fx_px, 0.0, model.cx_px], [0.0, model.fy_px, model.cy_px], [0.0, 0.0, 1.0]])
    return K, (model.width_px, model.height_px)


def rig_axes(task: Task) -> Floats:
    """Return `R_camera_from_S` (3, 3): S has camera axes for arms, body axes for heads and bases."""
    return np.eye(3) if task.name in ("six_dof", "translation") else R_CAMERA_FROM_BODY


def simulated_rig(simulate: Simulate) -> Rig:
    """Return the rig of a spec, by name or as given."""
    return Rig() if simulate.rig == "dragonfly" else simulate.rig


def left_camera_position(model: Rig, task: Task) -> Floats:
    """Return the left camera's centre (3,) in S: half a baseline to the left, `forward_m` in front."""
    return np.asarray(rig_axes(task).T @ np.array([-model.baseline_m / 2, 0.0, model.forward_m]))


def make_world(spec: Spec) -> World:
    """Return the world that a spec's `data.simulate` describes."""
    simulate = _simulate_of(spec)
    task = make_task(spec.task, spec.lift)
    model = simulated_rig(simulate)
    K, size = rig(model)
    cameras = parallel_rig(K, K, model.baseline_m, rig_axes(task), left_camera_position(model, task))
    where = workspace.region(task, spec.mounting, simulate.motion, simulate.workspace)
    return World(task, spec.mounting, cameras, size, where)


def trial_streams(spec: Spec, trial: int) -> tuple[np.random.Generator, np.random.Generator]:
    """Return a trial's generators for training data and for held-out queries, spawned from the seed."""
    seed = np.random.SeedSequence(_simulate_of(spec).seed, spawn_key=(trial,))
    training, queries = seed.spawn(2)
    return np.random.default_rng(training), np.random.default_rng(queries)


def image_stream(spec: Spec, trial: int = 0) -> np.random.Generator:
    """Return the generator for the images of a trial, apart from those of `trial_streams`."""
    seed = np.random.SeedSequence(_simulate_of(spec).seed, spawn_key=(trial,))
    return np.random.default_rng(seed.spawn(3)[2])


def simulate(spec: Spec, rng: np.random.Generator) -> Simulation:
    """Simulate one training recording.

    Raises
    ------
    InputError : the workspace hardly ever shows all targets.
    """
    source = _simulate_of(spec)
    world = make_world(spec)
    n_targets = source.targets or workspace.TARGETS[spec.task]
    P_W = _visible_targets(rng, world, n_targets)
    args = (rng, world.task, world.region, world.cameras, world.image_size, P_W)
    if source.motion == "hand_guided":
        E, seconds = workspace.hand_guided_poses(*args, source.frames, source.rate_hz)
    else:
        rest = workspace.visible_poses(*args, source.frames - 1)
        E = np.concatenate([world.region.start[None], rest])
        seconds = np.arange(source.frames) / source.rate_hz
    # The truth is what a noise-free robot would report, to the last bit: a recording then holds the same.
    E_true = _recorded(rng, world, E, Noise(pose_m=0.0, pose_rad=0.0)).motions(spec.mounting)
    clean, _ = workspace.codes(world.cameras, E_true, P_W)
    pixels, noise_px = _observed(rng, clean, spec.noise, world.image_size)
    for lost in source.lost:
        _lose(pixels, lost, world.image_size)
    poses = _recorded(rng, world, E, spec.noise)
    times = START_NS + np.rint(seconds * 1e9).astype(np.int64)
    tracks = from_dense(times, poses.motions(spec.mounting), pixels, image_size=world.image_size, exact=clean)
    return Simulation(world, tracks, poses, P_W, E_true, clean, noise_px)


def held_out_queries(spec: Spec, rng: np.random.Generator) -> Query:
    """Return queries on new targets at new poses, one shot each, with the spec's noise.

    Every query draws its own targets, an initial pose and a desired pose from the same workspace.
    """
    return held_out_questions(spec, rng)[0]


def held_out_questions(spec: Spec, rng: np.random.Generator) -> tuple[Query, Truth]:
    """Return the same queries as `held_out_queries`, and the truth about them."""
    world = make_world(spec)
    source = _simulate_of(spec)
    n_targets = spec.evaluate.query_targets or source.targets or workspace.TARGETS[spec.task]
    n = spec.evaluate.queries
    E = np.empty((n, 2, 4, 4))
    P_W = np.empty((n, n_targets, 3))
    for i in range(n):
        P_W[i] = _visible_targets(rng, world, n_targets)
        E[i] = workspace.visible_poses(
            rng, world.task, world.region, world.cameras, world.image_size, P_W[i], 2
        )
    clean, _ = workspace.codes(world.cameras, E, P_W[:, None])
    seen, noise_px = _observed(rng, clean, spec.noise, world.image_size)
    points = workspace.in_S(E[:, 0], P_W)
    truth = Truth(points, np.concatenate([noise_px[:, 0], noise_px[:, 1]], axis=-1), np.zeros_like(points))
    return Query(seen[:, 0], seen[:, 1], E[:, 0], E[:, 1]), truth


def disturbed_views(simulation: Simulation, spec: Spec, rng: np.random.Generator) -> Disturbed:
    """Return what is seen of targets that moved by N(0, `point_m`) after training (Fig. 5.8)."""
    world = simulation.world
    shape = (len(simulation.E_true), *simulation.targets_W.shape)
    moved_W = spec.noise.point_m * rng.standard_normal(shape)
    clean, depth = workspace.codes(world.cameras, simulation.E_true, simulation.targets_W + moved_W)
    pixels, noise_px = _observed(rng, clean, spec.noise, world.image_size)
    pixels[~in_view(clean, depth, world.image_size)] = np.nan
    return Disturbed(pixels, moved_W, noise_px)


def trained_code_truth(
    simulation: Simulation, first: int, newest: Ints, targets: Ints, disturbed: Disturbed | None = None
) -> Truth:
    """Return the truth of queries from frame `first` to frames `newest` (Q,) about some targets (n,)."""
    E = simulation.E_true[first]
    points = workspace.in_S(E, simulation.targets_W[targets])
    shape = (len(newest), *points.shape)
    before = np.broadcast_to(simulation.noise_px[first, targets], (*shape[:2], 4))
    moved, noise_px = np.zeros(shape), simulation.noise_px
    if disturbed is not None:
        moved = disturbed.moved_W[newest][:, targets] @ E[:3, :3].T
        noise_px = disturbed.noise_px
    after = noise_px[newest][:, targets]
    return Truth(np.broadcast_to(points, shape), np.concatenate([before, after], axis=-1), moved)


def _simulate_of(spec: Spec) -> Simulate:
    if spec.data.simulate is None:
        raise ValueError("the spec's data are recorded, not simulated")
    return spec.data.simulate


def _visible_targets(rng: np.random.Generator, world: World, n: int) -> Floats:
    """Targets (n, 3) in W that the start pose shows, each drawn until it does."""
    found = np.empty((0, 3))
    for _ in range(10_000):
        P = workspace.draw_targets(rng, world.region, (max(n, 16),))
        shown = workspace.sees(
            world.cameras, world.image_size, np.broadcast_to(world.region.start, (len(P), 4, 4)), P[:, None]
        )
        found = np.concatenate([found, P[shown]])
        if len(found) >= n:
            return found[:n]
    raise InputError(
        "data.simulate.workspace: the start pose shows no point of the target box in both cameras"
    )


def check_drift(spec: Spec) -> None:
    """Raise `InputError` where odometry is to drift in what the task does not move."""
    if spec.noise.drifts and spec.task == "pan_tilt":
        raise InputError(
            "noise.drift_m_per_sqrt_m, drift_rad_per_sqrt_m: pan_tilt does not travel, 0 is accepted"
        )
    if spec.noise.drift_rad_per_sqrt_m > 0.0 and spec.task == "translation":
        raise InputError("noise.drift_rad_per_sqrt_m: translation does not turn, 0 is accepted")


def check_lost(spec: Spec) -> None:
    """Raise `InputError` where a tracker is to lose a target that there is not, or after the last frame."""
    source = _simulate_of(spec)
    targets = source.targets or workspace.TARGETS[spec.task]
    for lost in source.lost:
        if lost.target >= targets:
            raise InputError(
                f"data.simulate.lost: found target {lost.target}, 0 to {targets - 1} are accepted"
            )
        if lost.from_frame >= source.frames:
            raise InputError(
                f"data.simulate.lost: found from_frame {lost.from_frame}, "
                f"1 to {source.frames - 1} are accepted"
            )


def _lose(pixels: Floats, lost: LostTracker, image_size: tuple[int, int]) -> None:
    """Take from pixels (N, K, 4) what a tracker does not see, or sees in the wrong place."""
    frames = slice(lost.from_frame, lost.from_frame + lost.frames)
    for camera, name in enumerate(("left", "right")):
        if lost.camera not in (name, "both"):
            continue
        seen = pixels[:, lost.target, 2 * camera : 2 * camera + 2]
        seen[frames] = np.nan if lost.shows == "nothing" else _edge(seen[lost.from_frame], image_size)


def _edge(pixel: Floats, image_size: tuple[int, int]) -> Floats:
    """Return the pixel (2,) on the border of an image that is nearest to one inside."""
    high = np.array(image_size) - 1.0
    to = np.stack([pixel, high - pixel])
    side, axis = np.unravel_index(np.argmin(to), to.shape)
    edge = pixel.copy()
    edge[axis] = high[axis] if side else 0.0
    return edge


def _observed(
    rng: np.random.Generator, clean: Floats, noise: Noise, image_size: tuple[int, int]
) -> tuple[Floats, Floats]:
    """Pixels with Gaussian noise and a share of wrong correspondences anywhere in the images; that noise."""
    noise_px = noise.pixel_px * rng.standard_normal(clean.shape)
    pixels = clean + noise_px
    if noise.outlier_ratio > 0.0:
        wrong = rng.random(clean.shape[:-1]) < noise.outlier_ratio
        anywhere = rng.uniform(-0.5, np.array([*image_size, *image_size]) - 0.5, clean.shape)
        pixels = np.where(wrong[..., None], anywhere, pixels)
    return pixels, noise_px


def _recorded(rng: np.random.Generator, world: World, E_true: Floats, noise: Noise) -> Poses:
    """Poses as a robot reports them: W_T_S or B_T_tool, or the joints of a pan-tilt unit."""
    if world.task.name == "pan_tilt":
        angles = world.task.world().coordinates(E_true, np.eye(4))
        angles = angles + noise.pose_rad * rng.standard_normal(angles.shape)
        return PanTiltJoints(angles[:, 0], angles[:, 1])
    T = E_true if world.mounting == "eye_to_hand" else inverse(E_true)
    if noise.drifts:
        T = drifted(rng, world.task.name, T, noise)
    R = Rotation.from_matrix(T[:, :3, :3])
    if noise.pose_rad > 0.0:
        R = R * Rotation.from_rotvec(noise.pose_rad * rng.standard_normal((len(T), 3)))
    position = T[:, :3, 3] + noise.pose_m * rng.standard_normal((len(T), 3))
    return BodyPoses(position, R.as_quat(canonical=True))


def drifted(rng: np.random.Generator, task: str, T: Floats, noise: Noise) -> Floats:
    """Return poses (N, 4, 4) as odometry has them: what is added up of steps that are each a little off.

    A base drifts in its plane alone, and what does not turn does not drift in its rotation.
    """
    steps = inverse(T[:-1]) @ T[1:]
    root = np.sqrt(np.linalg.norm(steps[:, :3, 3], axis=1))[:, None]
    turns, moves = {
        "planar": ((0.0, 0.0, 1.0), (1.0, 1.0, 0.0)),
        "translation": ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)),
    }.get(task, ((1.0, 1.0, 1.0), (1.0, 1.0, 1.0)))
    shift = noise.drift_m_per_sqrt_m * root * np.array(moves) * rng.standard_normal((len(steps), 3))
    turn = noise.drift_rad_per_sqrt_m * root * np.array(turns) * rng.standard_normal((len(steps), 3))
    steps = steps @ from_rotation_translation(Rotation.from_rotvec(turn).as_matrix(), shift)
    measured = T.copy()
    for i, step in enumerate(steps):
        measured[i + 1] = measured[i] @ step
    return measured
