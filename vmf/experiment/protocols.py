"""The questions an experiment asks: at trained codes, and on data held out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vmf.data import Query, Tracks
from vmf.errors import InputError
from vmf.experiment.errors_table import Asked
from vmf.spec import Spec

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


def checkpoints(spec: Spec, n_frames: int) -> tuple[int, ...]:
    """Return the frame counts at which statistics are taken: the spec's, or the last.

    Raises
    ------
    InputError : a checkpoint lies beyond the data or before the second frame.
    """
    chosen = spec.evaluate.checkpoints
    if chosen is None:
        return (n_frames,)
    bad = [c for c in chosen if not 2 <= c <= n_frames]
    if bad:
        raise InputError(
            f"evaluate.checkpoints: found {bad[0]}, a number of frames from 2 to {n_frames} is accepted"
        )
    return tuple(sorted(set(chosen)))


def beyond(spec: Spec, n_frames: int) -> tuple[int, ...]:
    """Return the frame counts beyond which all answers at trained codes are one case.

    Raises
    ------
    InputError : there are no frames beyond one of them.
    """
    bad = [c for c in spec.evaluate.beyond if c >= n_frames]
    if bad:
        raise InputError(
            f"evaluate.beyond: found {bad[0]}, a number of frames from 1 to {n_frames - 1} is accepted"
        )
    return tuple(sorted(set(spec.evaluate.beyond)))


def curve_frames(spec: Spec, n_frames: int) -> Ints:
    """Return the frame counts after which a motion is solved: checkpoints, a curve between them, the last.

    A geometric curve is so where frames are dense enough for that; as many points as frames are all of them.
    """
    points = min(spec.evaluate.curve_points, n_frames - 1)
    last = np.arange(max(2, n_frames - spec.evaluate.curve_last + 1), n_frames + 1)
    asked_anyway = np.union1d(np.array(checkpoints(spec, n_frames), np.int64), last)
    if spec.evaluate.curve_spacing == "even":
        even = np.linspace(2, n_frames, points).round().astype(np.int64)
        return np.union1d(even, asked_anyway)
    number = np.arange(points)
    geometric = np.geomspace(2, n_frames, points).round().astype(np.int64)
    curve = np.maximum.accumulate(geometric - number) + number
    curve = np.minimum(curve, n_frames - number[::-1])
    return np.union1d(curve, asked_anyway)


def thinned(frames: Ints, points: int, checkpoints: Sequence[int] | None, last: int = 0) -> Ints:
    """Return which questions (K,) at trained codes are asked of who need not be asked all.

    Parameters
    ----------
    frames : (Q,) frame counts after which there are questions.
    points : how many of them to take, spread evenly over those before the last.
    checkpoints : frame counts to take beside these; the last one if they are left out.
    last : how many last frame counts to take in any case.
    """
    dense = frames > frames[-1] - last
    before = np.nonzero(~dense)[0]
    even = np.linspace(0, len(before) - 1, min(points, len(before))).round().astype(np.int64)
    kept = np.nonzero(dense | np.isin(frames, frames[-1:] if checkpoints is None else checkpoints))[0]
    return np.union1d(before[even], kept)


@dataclass(frozen=True)
class FirstView:
    """The view whose codes the thesis queries: the first that shows enough targets in both cameras.

    Attributes
    ----------
    frame : its frame.
    targets : (n,) the targets seen there by both cameras.
    names : (n,) their names.
    pixels : (N, n, 4) those targets in all frames, NaN where not seen.
    """

    frame: int
    targets: Ints
    names: NDArray[np.str_]
    pixels: Floats

    @property
    def codes(self) -> Floats:
        """The trained codes (n, 4)."""
        return np.asarray(self.pixels[self.frame])


def first_view(tracks: Tracks, least: int) -> FirstView | None:
    """Return the first view of at least so many targets in both cameras, None where there is none."""
    both = np.asarray(np.isfinite(tracks.pixels).all(axis=1))
    per_frame = np.bincount(tracks.frame[both], minlength=tracks.n_frames)
    enough = np.nonzero(per_frame >= least)[0]
    if not len(enough):
        return None
    frame = int(enough[0])
    targets = np.sort(tracks.target[both & (tracks.frame == frame)])
    return FirstView(frame, targets, np.array(tracks.ids)[targets], pixels_of(tracks, targets))


def pixels_of(tracks: Tracks, targets: Ints) -> Floats:
    """Return the pixels (N, n, 4) of some targets in all frames, NaN where not seen."""
    column = np.full(tracks.n_targets, -1)
    column[targets] = np.arange(len(targets))
    mine = column[tracks.target] >= 0
    pixels = np.full((tracks.n_frames, len(targets), 4), np.nan)
    pixels[tracks.frame[mine], column[tracks.target[mine]]] = tracks.pixels[mine]
    return pixels


def least_targets(spec: Spec) -> int:
    """Return how many shared targets a question about a recording needs: the spec's, or the task's.

    One more than the motion needs where a single wrong track would otherwise go unnoticed.
    """
    if spec.evaluate.min_targets is not None:
        return spec.evaluate.min_targets
    if spec.solver.known == "rotation":
        return 1
    return {"pan_tilt": 1, "translation": 2, "planar": 2, "six_dof": 4}[spec.task]


def askable(spec: Spec, view: FirstView, counts: Ints) -> Ints:
    """Return the counts after which the newest view still shows enough of the first view's targets."""
    seen = np.isfinite(view.pixels[counts - 1].reshape(len(counts), -1, 2, 2)).all(axis=-1).any(axis=-1)
    return np.asarray(counts[(counts > view.frame + 1) & (seen.sum(axis=1) >= least_targets(spec))])


def trained_code_questions(
    view: FirstView, counts: Ints, E_true: Floats, seen: Floats | None = None
) -> Asked:
    """Return the thesis's questions: from the first view to the newest one, after each count of frames.

    Parameters
    ----------
    view : the first view.
    counts : (F,) frames learned before each question, all beyond the first view.
    E_true : (N, 4, 4) true poses `E_S_from_W`.
    seen : (N, n, 4) pixels of targets that moved after training, None where none did.
    """
    newest = counts - 1
    first = np.full_like(newest, view.frame)
    desired = view.pixels if seen is None else seen
    query = Query(view.pixels[first], desired[newest], E_true[first], E_true[newest])
    case = np.array([f"frame={count}" for count in counts])
    return Asked("trained_code", 0, counts, case, query, view.names[None])


@dataclass(frozen=True)
class Fold:
    """A block of a recording kept from training.

    Attributes
    ----------
    train : frames to learn from.
    test : frames to ask about, one contiguous block.
    """

    train: Ints
    test: Ints


def folds(spec: Spec, n_frames: int) -> tuple[Fold, ...]:
    """Return the blocks of time: the last part alone, or `folds` contiguous blocks in turn."""
    frames = np.arange(n_frames)
    if spec.evaluate.folds == 1:
        cut = round(spec.evaluate.train_fraction * n_frames)
        return (Fold(frames[:cut], frames[cut:]),)
    blocks = np.array_split(frames, spec.evaluate.folds)
    return tuple(Fold(np.setdiff1d(frames, block), block) for block in blocks)


def held_out_pairs(spec: Spec, tracks: Tracks, frames: Ints, fold: int) -> list[Asked]:
    """Return one set of questions per gap: all pairs of frames that far apart with enough shared targets.

    A target counts as shared if both cameras see it in the first view and any camera in the second.
    """
    asked = []
    index = {(int(f), int(t)): i for i, (f, t) in enumerate(zip(tracks.frame, tracks.target, strict=True))}
    by_frame: dict[int, list[int]] = {}
    for frame, target in zip(tracks.frame, tracks.target, strict=True):
        by_frame.setdefault(int(frame), []).append(int(target))
    both = np.asarray(np.isfinite(tracks.pixels).all(axis=1))
    inside = set(frames.tolist())
    for number, gap in enumerate(spec.evaluate.gaps):
        pairs, shared = [], []
        for i in frames.tolist():
            if i + gap not in inside:
                continue
            mates = [t for t in by_frame.get(i, []) if both[index[i, t]] and (i + gap, t) in index]
            if len(mates) >= least_targets(spec):
                pairs.append((i, i + gap))
                shared.append(mates)
        if pairs:
            trial = fold * len(spec.evaluate.gaps) + number
            asked.append(_asked(tracks, index, trial, f"gap={gap}", pairs, shared))
    return asked


def _asked(
    tracks: Tracks,
    index: dict[tuple[int, int], int],
    trial: int,
    case: str,
    pairs: list[tuple[int, int]],
    shared: list[list[int]],
) -> Asked:
    most = max(len(mates) for mates in shared)
    views = np.full((2, len(pairs), most, 4), np.nan)
    names = np.full((len(pairs), most), "", object)
    for q, ((i, j), mates) in enumerate(zip(pairs, shared, strict=True)):
        views[0, q, : len(mates)] = tracks.pixels[[index[i, t] for t in mates]]
        views[1, q, : len(mates)] = tracks.pixels[[index[j, t] for t in mates]]
        names[q, : len(mates)] = [tracks.ids[t] for t in mates]
    first, second = np.array(pairs, np.int64).T
    E = tracks.E_S_from_W
    query = Query(views[0], views[1], E[first], E[second])
    cases = np.full(len(pairs), case)
    return Asked("held_out", trial, second, cases, query, names.astype(str), start=first)
