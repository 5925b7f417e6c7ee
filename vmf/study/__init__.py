"""Studies: what can be shown about the method itself, each from its settings to numbers and figures."""

from vmf.study.registry import STUDIES, carry_out
from vmf.study.result import QUANTITIES, Drawing, Quantity, StudyResult

__all__ = ["QUANTITIES", "STUDIES", "Drawing", "Quantity", "StudyResult", "carry_out"]
