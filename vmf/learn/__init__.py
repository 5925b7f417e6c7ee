"""Learners of the visuomotor function: from tracks to Θ_S."""

from vmf.learn.base import Answer, Learner
from vmf.learn.compressed import CompressedPipeline
from vmf.learn.pipeline import PipelineLearner
from vmf.learn.region import Region
from vmf.learn.sequential import SequentialPipeline
from vmf.learn.structured import StructuredLearner
from vmf.learn.transport import TransportLearner

__all__ = [
    "Answer",
    "CompressedPipeline",
    "Learner",
    "PipelineLearner",
    "Region",
    "SequentialPipeline",
    "StructuredLearner",
    "TransportLearner",
]
