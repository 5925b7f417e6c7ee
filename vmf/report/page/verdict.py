"""How a number of ours agrees with one of the thesis."""

from __future__ import annotations

from enum import Enum

from vmf.report.page.claims import Claim
from vmf.report.page.measure import Value

# Agreement: within so much of the thesis's number either way.
WITHIN = 0.25

DEFINITION = (
    f"Reproduced: our number divided by the thesis’s lies between {1 / (1 + WITHIN):.2f} and "
    f"{1 + WITHIN:.2f} (within {WITHIN * 100:.0f} % either way), or a bound that the thesis states is kept. "
    "Better: an error, or a number of frames, that is smaller than that. Not reproduced: everything else, "
    "with the reason; and every number of which most questions were left unanswered. What the thesis says "
    "without a number is as it says, or not, where its words say on which side of something ours should be."
)


class Verdict(Enum):
    """How it agrees; the value is what the page says."""

    REPRODUCED = "reproduced"
    BETTER = "better"
    NOT = "not reproduced"
    AGREES = "as it says"
    DIFFERS = "not as it says"
    WORDS = "in words"
    NO_NUMBER = "no number"
    NOT_RUN = "not run"

    @property
    def slug(self) -> str:
        """The name as a style sheet has it."""
        return self.name.lower().replace("_", "-")


def verdict(claim: Claim, value: Value | None, ran: bool = True) -> Verdict:
    """Return how a measured number agrees with the thesis's; `ran` says whether there is a run at all."""
    if value is None or value.too_short:
        return Verdict.NO_NUMBER if ran else Verdict.NOT_RUN
    if claim.thesis is None:
        if claim.means is None:
            return Verdict.WORDS
        agrees = value.number is not None and not value.mostly_lost and claim.means.agrees(value.number)
        return Verdict.AGREES if agrees else Verdict.DIFFERS
    if value.number is None or value.mostly_lost:
        # What is left of a few answers is not what the thesis counted.
        return Verdict.NOT
    ratio = value.number / claim.thesis
    kept = {"at_most": ratio <= 1.0, "at_least": ratio >= 1.0}.get(claim.reading, False)
    if kept or 1 / (1 + WITHIN) <= ratio <= 1 + WITHIN:
        return Verdict.REPRODUCED
    if claim.reading == "error" and ratio < 1.0:
        return Verdict.BETTER
    return Verdict.NOT
