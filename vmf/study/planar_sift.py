"""A mobile base that learns from SIFT features and then drives to a view in one command (Figs. 5.51–5.53).

§5.5: A base is driven through a room by hand. Its features are kept in the thesis's keypoint database, and
each function learns from what is found again and from odometry that drifts. Then a view is shown in which the
base should be, and where it stands it sees another one: the features of both give one motion command,
which is driven by odometry alone.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from vmf.data import Query, Tracks
from vmf.data.poses import BodyPoses
from vmf.data.simulate import Simulation, make_world
from vmf.data.tracks import from_dense
from vmf.errors import InputError, Loss
from vmf.geometry import inverse
from vmf.learn import Learner
from vmf.spec.model import Noise, Spec
from vmf.spec.studies import PlanarSiftStudy
from vmf.study.mobile_base import Parking, in_plane, park, planar_pose, wander
from vmf.study.result import Quantity, StudyResult, mean_quantity

if TYPE_CHECKING:
    from vmf.data.images import Image
    from vmf.data.render import Film
    from vmf.track.epipolar import EpipolarGate

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_RATE_HZ = 5.0
COLUMNS = (
    "run",
    "method",
    "status",
    "start_matches",
    "end_matches",
    "heading_error_rad",
    "x_error_m",
    "y_error_m",
    "command_heading_error_rad",
    "command_x_error_m",
    "command_y_error_m",
    "pixel_error_x_px",
    "pixel_error_y_px",
)


@dataclass(frozen=True)
class Snapshot:
    """The stereo features of a view.

    Attributes
    ----------
    image : of the left camera.
    codes : (n, 4) px.
    descriptors : (2, n, 128) in the left and the right image.
    """

    image: Image
    codes: Floats
    descriptors: NDArray[np.float32]

    def matches(self, other: Snapshot, ratio: float) -> Ints:
        """Return pairs (m, 2) of features that are each other's nearest by far, in both cameras."""
        from vmf.track.sift import matches

        pairs = (
            {tuple(pair) for pair in matches(self.descriptors[c], other.descriptors[c], ratio).tolist()}
            for c in (0, 1)
        )
        return np.array(sorted(set.intersection(*pairs)), np.int64).reshape(-1, 2)


@dataclass(frozen=True)
class Training:
    """What the tour through the room left.

    Attributes
    ----------
    film : the room, to be seen from elsewhere.
    tracks : the features found again, at poses by odometry.
    gate : the epipolar geometry of the rig, learned from the features.
    counts : (N, 4) features in the left image, stereo matches, features found again, database entries.
    way : (N, 4, 4) true poses `W_T_S`.
    """

    film: Film
    tracks: Tracks
    gate: EpipolarGate
    counts: Ints
    way: Floats


@dataclass(frozen=True)
class Run:
    """One command and the way it was driven.

    Attributes
    ----------
    method : whose command.
    goal : (4, 4) true pose of the desired view.
    parking : None where there was no command.
    row : of `runs.csv`.
    seen : (m, 2) distance left to the goal (m), and features that match the desired view there.
    """

    number: int
    method: str
    goal: Floats
    parking: Parking | None
    row: Mapping[str, object]
    seen: Floats


def planar_sift(settings: PlanarSiftStudy) -> StudyResult:
    """Train, show a desired view, drive there by odometry, and look how far off the base is.

    Raises
    ------
    InputError : the room shows no features that are found again.
    """
    from vmf.study.figures import planar_sift as figures

    training = train(settings)
    learners = {name: _taught(one, training.tracks) for name, one in functions(settings).items()}
    streams = np.random.SeedSequence(settings.seed, spawn_key=(1,)).spawn(settings.runs)
    runs: list[Run] = []
    views: list[tuple[Snapshot, Snapshot, Snapshot | None]] = []
    for number, stream in enumerate(streams):
        done, shown = _one_run(settings, training, learners, number, np.random.default_rng(stream))
        runs += done
        views.append(shown)
    table = pd.DataFrame([run.row for run in runs], columns=list(COLUMNS))
    counts = pd.DataFrame(
        training.counts, columns=["features", "stereo_matches", "database_matches", "database"]
    )
    drawings = {
        "matches": partial(figures.draw_matches, settings, views[0]),
        "robot_path": partial(figures.draw_paths, settings, training.way, runs),
        "matches_on_the_way": partial(figures.draw_seen, runs),
    }
    return StudyResult(
        (*_of_training(settings, training), *_of_runs(table)),
        {"runs": table, "frames": counts},
        drawings,
        losses=_losses(learners, runs),
    )


def _losses(learners: Mapping[str, Learner], runs: Sequence[Run]) -> tuple[Loss, ...]:
    """Return which functions have learned nothing, or never had a command."""
    found = []
    for name, learner in learners.items():
        mine = [run for run in runs if run.method == name]
        if learner.refused is not None:
            found.append(Loss(name, f"nothing was learned: {learner.refused}", 1))
        elif all(run.parking is None for run in mine):
            found.append(Loss(name, "none of the runs had a command", len(mine)))
    return tuple(found)


def functions(settings: PlanarSiftStudy) -> dict[str, Spec]:
    """Return the functions by name: ours, and the thesis's, which pairs only what was matched."""
    data = {"simulate": {"rig": settings.rig.model_dump(), "frames": 2}}
    reach = {
        "travel_m": (settings.area_m[0] / 2, settings.area_m[1] / 2, 0.0),
        "angle_rad": settings.heading_rad,
    }
    look = {"size_m": settings.poster_m, "blur_px": settings.blur_px, "noise": settings.image_noise}
    data["simulate"] |= {"workspace": reach, "images": look, "targets": settings.posters}
    ours = {"task": "planar", "data": data, "noise": {"pixel_px": 0.0}}
    thesis = {
        "learner": {"kind": "pipeline", "engine": "compressed", "estimator": "qr", "length": 1},
        "approximator": {"kind": "cmac", "gauge": "thesis"},
        "solver": {"cost": "algebraic", "start": "zero", "cameras": "left"},
    }
    return {"vmf": Spec.model_validate(ours), "vmf[thesis]": Spec.model_validate(ours | thesis)}


def train(settings: PlanarSiftStudy) -> Training:
    """Drive through the room and keep what the features did.

    Raises
    ------
    InputError : no feature was found again.
    """
    from vmf.data.render import film

    seed = np.random.SeedSequence(settings.seed, spawn_key=(0,))
    rng, of_images, of_odometry = map(np.random.default_rng, seed.spawn(3))
    spec = functions(settings)["vmf"]
    reach = (settings.area_m[0] / 2, settings.area_m[1] / 2, settings.heading_rad)
    way = wander(rng, reach, settings.frames, settings.frames_per_leg)
    low, high = np.array(settings.posters_low_m), np.array(settings.posters_high_m)
    posters = rng.uniform(low, high, (settings.posters, 3))
    simulate = spec.data.simulate
    assert simulate is not None
    world = make_world(spec)
    times = np.rint(np.arange(settings.frames) * 1e9 / _RATE_HZ).astype(np.int64)
    nothing = np.zeros((settings.frames, 0, 4))
    E = inverse(way)
    seen = from_dense(times, E, nothing, image_size=world.image_size)
    poses = BodyPoses(way[:, :3, 3], np.tile([0.0, 0.0, 0.0, 1.0], (settings.frames, 1)))
    shot = film(Simulation(world, seen, poses, posters, E, nothing, nothing), simulate, of_images)
    return _toured(settings, shot, way, times, of_odometry)


def _toured(
    settings: PlanarSiftStudy, shot: Film, way: Floats, times: NDArray[np.int64], rng: np.random.Generator
) -> Training:
    """Track the film with odometry beside it, as `vmf track --tracker sift void_after_m=…` does."""
    from vmf.data.render import grey
    from vmf.data.simulate import drifted
    from vmf.spec.images import SiftTracker as Options
    from vmf.track.base import Odometry
    from vmf.track.sift import SiftTracker

    odometry = drifted(rng, "planar", way, _noise(settings)) if _noise(settings).drifts else way
    steps = np.linalg.norm(np.diff(odometry[:, :3, 3], axis=0), axis=1)
    travelled = np.append(0.0, np.cumsum(steps))
    options = Options(features=settings.features, void_after_m=settings.void_after_m)
    found: dict[str, dict[int, Floats]] = {}
    counts = []
    with SiftTracker(options) as tracker:
        for i, (left, right) in enumerate(shot.frames()):
            tracker.moved_to(Odometry(odometry[i], float(travelled[i])))
            sightings = tracker.step(grey(left), grey(right))
            for name, pixel in zip(sightings.ids, sightings.pixels, strict=True):
                found.setdefault(name, {})[i] = pixel
            database = tracker.database
            counts.append((*tracker.counts, len(database.matches), len(database.keypoints)))
    again = {name: seen for name, seen in found.items() if len(seen) > 1}
    if not again:
        raise InputError("study: no feature was found again; more or larger posters, more frames may help")
    frame = np.concatenate([list(seen) for seen in again.values()]).astype(np.int64)
    target = np.repeat(np.arange(len(again)), [len(seen) for seen in again.values()])
    pixels = np.concatenate([list(seen.values()) for seen in again.values()])
    size = shot.simulation.world.image_size
    tracks = Tracks(times, inverse(odometry), frame, target, pixels, tuple(again), size)
    return Training(shot, tracks, tracker.gate, np.array(counts, np.int64), way)


def snapshot(settings: PlanarSiftStudy, left: Image, right: Image, gate: EpipolarGate) -> Snapshot:
    """Return a view's stereo features.

    Rows of the images need not correspond: every feature is compared with every other, and the matches that
    contradict the rig's epipolar geometry are left out.
    """
    from vmf.data.render import grey
    from vmf.track.features import FeatureDetector
    from vmf.track.sift import matches

    detect = FeatureDetector(settings.features)
    first, second = detect(grey(left)), detect(grey(right))
    pairs = matches(first.descriptors, second.descriptors, settings.ratio)
    first, second = first.select(pairs[:, 0]), second.select(pairs[:, 1])
    codes = np.column_stack([first.pixels, second.pixels])
    keep = np.flatnonzero(gate.agree(codes))
    both = np.stack([first.descriptors[keep], second.descriptors[keep]])
    return Snapshot(left, codes[keep], both)


def _one_run(
    settings: PlanarSiftStudy,
    training: Training,
    learners: Mapping[str, Learner],
    number: int,
    rng: np.random.Generator,
) -> tuple[list[Run], tuple[Snapshot, Snapshot, Snapshot | None]]:
    start, goal = _places(settings, rng)
    desired, initial = (_seen_from(settings, training, T) for T in (goal, start))
    pairs = initial.matches(desired, settings.ratio)
    asked = Query(
        initial.codes[None, pairs[:, 0]],
        desired.codes[None, pairs[:, 1]],
        inverse(start)[None],
        inverse(goal)[None],
    )
    runs = []
    final: Snapshot | None = None
    commands = _commands(settings, learners, asked)
    # What odometry alone makes of the right command.
    commands["exact"] = ("ok", asked.truth[0])
    for method, (status, E) in commands.items():
        row: dict[str, object] = {"run": number, "method": method, "status": status}
        row["start_matches"] = len(pairs)
        if status != "ok":
            runs.append(Run(number, method, goal, None, row, np.zeros((0, 2))))
            continue
        off = in_plane(inverse(asked.truth[0]) @ E)
        row |= {"command_x_error_m": abs(off[0]), "command_y_error_m": abs(off[1])}
        row["command_heading_error_rad"] = abs(off[2])
        way = park(
            np.random.default_rng([settings.seed, number]),
            start,
            start @ inverse(E),
            _noise(settings),
            settings.stop_m,
            settings.stop_rad,
        )
        arrived = _seen_from(settings, training, way.true[-1])
        row |= _arrival(settings, way, goal, arrived, desired)
        seen = _on_the_way(settings, training, way, goal, desired) if number == 0 else np.zeros((0, 2))
        runs.append(Run(number, method, goal, way, row, seen))
        if method == "vmf":
            final = arrived
    return runs, (initial, desired, final)


def _commands(
    settings: PlanarSiftStudy, learners: Mapping[str, Learner], asked: Query
) -> dict[str, tuple[str, Floats]]:
    """Return how each function's question ended, and its motion E' (4, 4)."""
    from vmf.experiment.asking import answer

    found = {}
    for name, spec in functions(settings).items():
        if not asked.initial.shape[1]:
            found[name] = ("refused", np.full((4, 4), np.nan))
            continue
        solutions = answer(spec, learners[name], asked)
        found[name] = (str(solutions.status[0]), solutions.E_to_from[0])
    return found


def _arrival(
    settings: PlanarSiftStudy, way: Parking, goal: Floats, arrived: Snapshot, desired: Snapshot
) -> dict[str, object]:
    x, y, heading = np.abs(in_plane(inverse(goal) @ way.true[-1])).tolist()
    pairs = arrived.matches(desired, settings.ratio)
    off = np.abs(arrived.codes[pairs[:, 0], :2] - desired.codes[pairs[:, 1], :2])
    across, down = off.mean(axis=0).tolist() if len(off) else (np.nan, np.nan)
    return {
        "status": "ok" if way.stopped else "not stopped",
        "end_matches": len(pairs),
        "heading_error_rad": heading,
        "x_error_m": x,
        "y_error_m": y,
        "pixel_error_x_px": across,
        "pixel_error_y_px": down,
    }


def _on_the_way(
    settings: PlanarSiftStudy, training: Training, way: Parking, goal: Floats, desired: Snapshot
) -> Floats:
    """Return distances to the goal (m), and how many features match the desired view from there (m, 2)."""
    some = np.unique(np.linspace(0, len(way.true) - 1, settings.looks).round().astype(int))
    rows = []
    for T in way.true[some]:
        left = float(np.linalg.norm(T[:2, 3] - goal[:2, 3]))
        view = _seen_from(settings, training, T)
        rows.append((left, len(view.matches(desired, settings.ratio))))
    return np.array(rows)


def _places(settings: PlanarSiftStudy, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return a start and its goal, poses `W_T_S` (4, 4) in the area, the start with heading zero."""
    half = np.array(settings.area_m) / 2
    goal = np.array(settings.goal_m)
    low, high = np.maximum(-half, -half - goal), np.minimum(half, half - goal)
    x, y = rng.uniform(low, high)
    start = planar_pose(x, y, 0.0)
    return start, start @ planar_pose(goal[0], goal[1], settings.goal_heading_rad)


def _seen_from(settings: PlanarSiftStudy, training: Training, T: Floats) -> Snapshot:
    left, right = training.film.pair(inverse(T))
    return snapshot(settings, left, right, training.gate)


def _taught(spec: Spec, tracks: Tracks) -> Learner:
    from vmf.experiment.build import build_learner

    learner = build_learner(spec)
    learner.partial_fit(tracks)
    return learner


def _of_training(settings: PlanarSiftStudy, training: Training) -> list[Quantity]:
    names = ("features", "stereo_matches", "database_matches")
    found = [
        mean_quantity(f"{name}_per_frame", training.counts[:, k].astype(float))
        for k, name in enumerate(names)
    ]
    found += [
        Quantity(f"{name}_{end}", float(of(training.counts[:, k])), n=settings.frames)
        for k, name in enumerate(names)
        for end, of in (("least", np.min), ("most", np.max))
    ]
    steps = np.linalg.norm(np.diff(training.way[:, :3, 3], axis=0), axis=1)
    found += [
        Quantity("keypoints_found_again", float(training.tracks.n_targets)),
        Quantity("area", float(np.prod(settings.area_m)), unit="m²"),
        Quantity("travelled", float(steps.sum()), unit="m"),
    ]
    return found


def _of_runs(table: pd.DataFrame) -> list[Quantity]:
    found = [
        mean_quantity("start_matches", table[table["method"] == "exact"]["start_matches"].to_numpy(float))
    ]
    kinds = {
        "arrival_error": {"heading": "heading_error_rad", "t_x": "x_error_m", "t_y": "y_error_m"},
        "command_error": {
            "heading": "command_heading_error_rad",
            "t_x": "command_x_error_m",
            "t_y": "command_y_error_m",
        },
        "pixel_error": {"x": "pixel_error_x_px", "y": "pixel_error_y_px"},
    }
    for method in table["method"].unique():
        mine = table[table["method"] == method]
        done = mine[mine["status"] == "ok"]
        found.append(Quantity("arrived", float(len(done)), method, n=len(mine)))
        for name, columns in kinds.items():
            for component, column in columns.items():
                values = done[column].to_numpy(float)
                values = values[np.isfinite(values)]
                if len(values):
                    found.append(mean_quantity(name, values, method, component, column.rsplit("_", 1)[1]))
        if len(done):
            found.append(mean_quantity("end_matches", done["end_matches"].to_numpy(float), method))
    return found


def _noise(settings: PlanarSiftStudy) -> Noise:
    return Noise(
        drift_m_per_sqrt_m=settings.drift_m_per_sqrt_m, drift_rad_per_sqrt_m=settings.drift_rad_per_sqrt_m
    )
