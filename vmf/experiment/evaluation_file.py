"""`vmf evaluate --mcap`: the questions and answers of an evaluation as a recording."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from vmf.data import Tracks
from vmf.data.recording import RecordingData, schemas
from vmf.data.recording.container import Contents, Topic, messages, visit
from vmf.data.recording.encode import json_stamp
from vmf.data.recording.foxglove import (
    DESIRED,
    LAYERS,
    OBSERVED,
    PREDICTED,
    Drawn,
    image_annotations,
    pose_in_frame,
)
from vmf.data.recording.output import Output, output
from vmf.data.recording.shown import (
    ANNOTATION_TOPICS,
    BODY_TRANSFORM_TOPIC,
    CALIBRATION_TOPICS,
    CAMERA_TRANSFORM_TOPICS,
    Frames,
    Observed,
    show_body,
    show_cameras,
    show_targets,
)
from vmf.data.recording.transforms import read_transforms
from vmf.data.recording.write import SPEC_NAME
from vmf.data.simulate import START_NS, rig, simulated_rig
from vmf.errors import InputError
from vmf.experiment.cameras import about, known_cameras
from vmf.experiment.error_messages import SCHEMA, error_schema, error_topic, errors_by_question
from vmf.experiment.functions import Answer
from vmf.experiment.model_file import Model
from vmf.experiment.moments import Clock
from vmf.experiment.predicted import predicted_pixels
from vmf.progress import Report
from vmf.solve import command
from vmf.spec import Spec, dump, spec_hash
from vmf.spec.model import Recording

Floats = NDArray[np.float64]

DESIRED_POSE_TOPIC = "/robot/desired_pose"
PREDICTED_POSE_TOPIC = "/robot/predicted_pose"
# Below these are topics of one kind of questions each, where frames have several.
QUESTION_TOPICS = ("/stereo/left/questions", "/stereo/right/questions")
_OWN = (*ANNOTATION_TOPICS, *QUESTION_TOPICS, DESIRED_POSE_TOPIC, PREDICTED_POSE_TOPIC)
_COPIED = (
    *schemas.IMAGE_SCHEMAS,
    *schemas.POSE_SCHEMAS,
    *schemas.CALIBRATION_SCHEMAS,
    schemas.JOINT_STATE,
    schemas.STEREO_TRACKS,
)


@dataclass(frozen=True)
class Evaluation:
    """What was asked of a model, and what came of it.

    Attributes
    ----------
    spec : what was asked for.
    model : the model.
    answers : of the learned function, one per set of questions.
    errors : the tidy table of all methods.
    data : the recording that was asked about, None for a simulation.
    """

    spec: Spec
    model: Model
    answers: list[Answer]
    errors: pd.DataFrame
    data: RecordingData | None


def write_evaluation(path: Path, evaluation: Evaluation, progress: Report | None = None) -> tuple[str, ...]:
    """Write an evaluation, and return what a person should know about it.

    Of a recording, images, poses, tracks and calibrations are copied as they are. Each question stands at
    the frame of its initial view: all targets seen there, where they should be, and where the function
    expects them after the motion that it answered. Of several at one frame the first answered is drawn
    there; besides, each kind of questions has topics of its own, to be shown or hidden. Simulated questions
    have no images and no time; they follow each other at the rate of the simulation.

    Raises
    ------
    InputError : the file cannot be written.
    """
    spec = evaluation.spec
    told = _Told(evaluation)
    with output(path) as out:
        if evaluation.data is None:
            notes = _simulated(out, evaluation, told, progress)
        else:
            notes = _recorded(out, evaluation, evaluation.data, told, progress)
        more = about(spec) | {"trained_spec_hash": spec_hash(evaluation.model.spec)}
        out.attach(SPEC_NAME, dump(spec), told.start_ns, **more)
    return notes


@dataclass(frozen=True)
class _Question:
    """One question and its answer: where it stands among all questions, and what is to be drawn."""

    answer: Answer
    index: int
    predicted: Floats

    @property
    def name(self) -> str:
        asked = self.answer.asked
        return f"{asked.protocol} {asked.case[self.index]}"

    @property
    def topic(self) -> str:
        """What topics of questions of this kind end in."""
        return "/" + re.sub(r"\W+", "_", self.name).strip("_")

    @property
    def answered(self) -> bool:
        return bool(self.answer.solutions.status[self.index] == "ok")

    def drawn(self) -> list[Drawn]:
        asked, i = self.answer.asked, self.index
        query = asked.query
        ids = np.broadcast_to(asked.names, query.initial.shape[:2])[i].tolist()
        status = str(self.answer.solutions.status[i])
        return [
            Drawn(DESIRED, ids, query.desired[i], self.name),
            Drawn(PREDICTED, ids, self.predicted, "" if status == "ok" else status),
        ]

    def observed(self) -> Drawn:
        asked = self.answer.asked
        ids = np.broadcast_to(asked.names, asked.query.initial.shape[:2])[self.index].tolist()
        return Drawn(OBSERVED, ids, asked.query.initial[self.index])


class _Told:
    """Everything about questions that is to be written, question by question.

    Attributes
    ----------
    start_ns : time of the first message.
    """

    def __init__(self, evaluation: Evaluation) -> None:
        self._evaluation = evaluation
        self._errors = errors_by_question(evaluation.errors)
        self._schema = error_schema(evaluation.errors)
        self._predicted = [
            predicted_pixels(evaluation.model.learner, answer.asked.query, answer.solutions)
            for answer in evaluation.answers
        ]
        data = evaluation.data
        self.start_ns = START_NS if data is None else int(data.tracks.times_ns[0])

    def __iter__(self) -> Iterator[_Question]:
        """Yield all questions."""
        for answer, predicted in zip(self._evaluation.answers, self._predicted, strict=True):
            for i in range(len(answer.asked.query)):
                yield _Question(answer, i, predicted[i])

    def by_frame(self) -> dict[int, list[_Question]]:
        """Return the questions of each frame of a recording."""
        found: dict[int, list[_Question]] = {}
        for question in self:
            start = question.answer.asked.start
            assert start is not None
            found.setdefault(int(start[question.index]), []).append(question)
        return found

    def write_errors(self, out: Output, question: _Question, time_ns: int, log_time_ns: int) -> None:
        """Write a question's errors."""
        asked, i = question.answer.asked, question.index
        for method, parts in self._errors[asked.protocol, asked.trial, i]:
            content = {
                "timestamp": json_stamp(time_ns),
                "protocol": asked.protocol,
                "case": str(asked.case[i]),
                "trial": asked.trial,
                "query": i,
                "frame": int(asked.frame[i]),
                "method": method,
                **parts,
            }
            out.json(error_topic(method), SCHEMA, self._schema, content, log_time_ns)

    def write_poses(
        self,
        out: Output,
        question: _Question,
        frames: Frames,
        time_ns: int,
        log_time_ns: int,
        kind: str = "",
    ) -> None:
        """Write where a question wants the body, and where the answer takes it, on topics of its `kind`."""
        query, i = question.answer.asked.query, question.index
        goal = pose_in_frame(frames.pose(query.E_desired[i]), frames.fixed, time_ns)
        out.protobuf(DESIRED_POSE_TOPIC + kind, goal, log_time_ns)
        E_to_from = question.answer.solutions.E_to_from[i]
        if np.isfinite(E_to_from).all():
            T = command(frames.pose(query.E_initial[i]), E_to_from, frames.mounting)
            predicted = pose_in_frame(T, frames.fixed, time_ns)
            out.protobuf(PREDICTED_POSE_TOPIC + kind, predicted, log_time_ns)


def _simulated(out: Output, evaluation: Evaluation, told: _Told, progress: Report | None) -> tuple[str, ...]:
    spec = evaluation.spec
    simulate = spec.data.simulate
    assert simulate is not None
    frames = Frames.of(spec.mounting)
    size = _simulated_size(spec)
    cameras = known_cameras(spec, size)
    if cameras is not None:
        show_cameras(out, cameras, frames, told.start_ns)
    period_ns = round(1e9 / simulate.rate_hz)
    questions = list(told)
    for number, question in enumerate(questions):
        time = told.start_ns + number * period_ns
        show_body(out, question.answer.asked.query.E_initial[question.index], frames, time)
        for camera in range(2):
            show_targets(out, [question.observed(), *question.drawn()], camera, time)
        told.write_errors(out, question, time, time)
        told.write_poses(out, question, frames, time, time)
        if progress is not None:
            progress(number + 1, len(questions), "questions written")
    return (f"{len(questions)} simulated questions written without images, one every {period_ns / 1e9:g} s",)


def _recorded(
    out: Output, evaluation: Evaluation, data: RecordingData, told: _Told, progress: Report | None
) -> tuple[str, ...]:
    source = evaluation.spec.data.recording
    assert source is not None
    contents = visit(data.path, lambda topic: False, lambda message: None)
    clock = Clock(contents, source, data)
    frames = _frames(evaluation.spec, source, contents)
    names = {topic.name for topic, n in contents.counts if n}
    cameras = known_cameras(evaluation.spec, data.tracks.image_size or _smallest_size(data.tracks))
    if cameras is not None and not names & {*CALIBRATION_TOPICS, *CAMERA_TRANSFORM_TOPICS}:
        first_ns = told.start_ns if contents.span_ns is None else contents.span_ns[0]
        show_cameras(out, cameras, frames, told.start_ns, first_ns)
    observed, questions = Observed(data.tracks), told.by_frame()
    E, total = data.tracks.E_S_from_W, data.tracks.n_frames
    methods = {error_topic(method) for method in evaluation.errors["method"].unique()}
    kinds = _kinds(questions)

    def is_wanted(topic: Topic) -> bool:
        own = topic.name in methods or any(f"{topic.name}/".startswith(f"{name}/") for name in _OWN)
        return topic.schema in _COPIED and not own

    done: set[int] = set()
    for message in messages(data.path, is_wanted):
        out.copy(message)
        moment = clock.moment(message)
        if moment is None:
            continue
        frame, log_time = moment.frame, message.log_time_ns
        asked = [] if frame is None else questions.get(frame, [])
        for camera in moment.cameras:
            seen = [] if frame is None else [observed.drawn(frame)]
            # One gap alone: more crosses than these are hard to tell apart.
            targets = [*seen, *(_shown(asked).drawn() if asked else [])]
            show_targets(out, targets, camera, moment.time_ns, log_time)
            row = len(LAYERS) + 1
            for kind in kinds:
                # Where nothing is asked, too: what was drawn last would stay.
                of_kind = [drawn for one in asked if one.topic == kind for drawn in one.drawn()]
                annotations = image_annotations(of_kind, camera, moment.time_ns, row)
                out.protobuf(QUESTION_TOPICS[camera] + kind, annotations, log_time)
                row += 2
        if frame is None or not moment.ticks or frame in done:
            continue
        done.add(frame)
        time = int(data.tracks.times_ns[frame])
        if BODY_TRANSFORM_TOPIC not in names:
            show_body(out, E[frame], frames, time, log_time)
        for question in asked:
            told.write_errors(out, question, time, log_time)
            if kinds:
                told.write_poses(out, question, frames, time, log_time, question.topic)
        if asked:
            told.write_poses(out, _shown(asked), frames, time, log_time)
        if progress is not None:
            progress(len(done), total, "frames written")
    left_out = sum(len(asked) for frame, asked in questions.items() if frame not in done)
    notes = [clock.note] if clock.note else []
    several = next((asked for asked in questions.values() if len(asked) > 1), None)
    if several is not None:
        cases = ", ".join(question.name for question in several)
        notes.append(
            f"of questions at one frame ({cases}) the first answered is drawn; each kind has topics of its "
            f"own, such as {QUESTION_TOPICS[0]}{several[0].topic}; all their errors are written"
        )
    if left_out:
        notes.append(f"{left_out} questions are not in the recording: no message of their frames was found")
    return tuple(notes)


def _kinds(questions: dict[int, list[_Question]]) -> tuple[str, ...]:
    """Return the kinds of questions, as they end topics; none if no frame has several questions."""
    if all(len(asked) <= 1 for asked in questions.values()):
        return ()
    return tuple(dict.fromkeys(question.topic for asked in questions.values() for question in asked))


def _shown(asked: Sequence[_Question]) -> _Question:
    """Return the question that is drawn at a frame: the first that was answered, if any was."""
    return next((question for question in asked if question.answered), asked[0])


def _frames(spec: Spec, source: Recording, contents: Contents) -> Frames:
    """Return the names of the frames, as the recording's poses have them."""
    parent = None if source.pose is None else source.pose.parent
    if parent is None and source.pose is not None:
        topic = source.pose.topic
        first = next(messages(contents.path, lambda t: t.name == topic), None)
        try:
            found = {} if first is None else read_transforms((first,), topic)[0]
        except InputError:
            found = {}
        parent = next((pair[0] for pair in found), None)
    return Frames.of(spec.mounting, parent)


def _smallest_size(tracks: Tracks) -> tuple[int, int] | None:
    """Return the size of the smallest images that hold all pixels; none where nothing was seen."""
    xy = tracks.pixels.reshape(-1, 2)
    xy = xy[np.isfinite(xy).all(axis=1)]
    if not len(xy):
        return None
    # Pixel centres have integer coordinates, so an image reaches to its size − 0.5.
    width, height = np.maximum(np.ceil(xy.max(axis=0) + 0.5), 1.0).astype(int).tolist()
    return width, height


def _simulated_size(spec: Spec) -> tuple[int, int]:
    assert spec.data.simulate is not None
    return rig(simulated_rig(spec.data.simulate))[1]
