"""What a trained function knows of the targets it is asked about."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vmf.errors import InputError
from vmf.experiment.move import TargetReport, number
from vmf.experiment.views import Pairs
from vmf.learn import Learner, Region

Floats = NDArray[np.float64]

# So many of its own codes tell whether a model has learned anything.
_SAMPLE = 50


@dataclass(frozen=True)
class Known:
    """What the function knows of n targets.

    Attributes
    ----------
    ids : their names.
    support : (n,) data behind the parameters at the codes asked, NaN where both cameras do not see a target.
    refused : (n,) whether there are no parameters.
    initial_px, desired_px : (n,) how far the codes lie outside the trained region, at least; NaN where no
        camera sees a target.
    """

    ids: tuple[str, ...]
    support: Floats
    refused: NDArray[np.bool_]
    initial_px: Floats
    desired_px: Floats

    @classmethod
    def of(cls, learner: Learner, pairs: Pairs) -> Known:
        """Ask the learner and the region of the codes it has seen.

        Raises
        ------
        InputError : it has learned nothing.
        """
        trained = _trained_codes(learner)
        noise = learner.noise
        region = Region.of(trained, None if noise is None else noise.scale_px)
        codes = _asked_codes(learner, pairs)
        seen = np.isfinite(codes).all(axis=1)
        support, refused = np.full(len(codes), np.nan), np.zeros(len(codes), bool)
        found = learner.parameters(learner.rectified(codes[seen]))
        support[seen] = found.support
        refused[seen] = np.isnan(found.rows).any(axis=(1, 2, 3))
        return cls(
            pairs.ids, support, refused, region.outside_px(pairs.initial), region.outside_px(pairs.desired)
        )

    def doubts(self) -> tuple[str, ...]:
        """Say why some targets should not be asked about."""
        said = []
        for i, name in enumerate(self.ids):
            for view, outside in (("initial", self.initial_px[i]), ("desired", self.desired_px[i])):
                if outside > 0.0:
                    said.append(
                        f"target {name} lies {outside:.3g} px outside the region of trained codes "
                        f"in the {view} view"
                    )
            if self.refused[i]:
                said.append(
                    f"target {name} has a code without learned parameters (support {self.support[i]:.3g})"
                )
        return tuple(said)

    def reports(self, weights: Floats) -> tuple[TargetReport, ...]:
        """Return one report per target, with the weights (n,) that the solver gave them."""
        columns = zip(self.ids, weights, self.support, self.initial_px, self.desired_px, strict=True)
        return tuple(
            TargetReport(
                id=name,
                weight=number(weight),
                rejected=bool(weight == 0.0),
                support=number(support),
                initial_outside_px=number(initial),
                desired_outside_px=number(desired),
            )
            for name, weight, support, initial, desired in columns
        )


def _asked_codes(learner: Learner, pairs: Pairs) -> Floats:
    """Return the codes (n, 4) that index the parameters: of the view with more of them."""
    n_initial, n_desired = (np.isfinite(view).all(axis=1).sum() for view in (pairs.initial, pairs.desired))
    return pairs.desired if learner.task.closed and n_desired > n_initial else pairs.initial


def _trained_codes(learner: Learner) -> Floats:
    """Return the codes (N, 4) that the model was trained with.

    Raises
    ------
    InputError : it answers none of them; with what it said about that when it was trained.
    """
    tracks = learner.tracks
    codes = np.zeros((0, 4)) if tracks is None else tracks.pixels[np.isfinite(tracks.pixels).all(axis=1)]
    some = codes[:: max(len(codes) // _SAMPLE, 1)]
    if not len(some) or np.isnan(learner.parameters(learner.rectified(some)).rows).any(axis=(1, 2, 3)).all():
        why = "; ".join(learner.losses) or "too little was seen in training"
        raise InputError(f"model: it answers none of the codes it was trained with: {why}")
    return codes
