"""The experiment spec: one frozen, typed model for everything a YAML file may say."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, PositiveInt, model_validator

from vmf.spec.approximators import AnyApproximator, CmacApproximator, PolynomialApproximator
from vmf.spec.base import Model, NonNegative, Positive, Ratio
from vmf.spec.images import FOLLOWED, ImageSource, RenderedImages, TargetTracker

Vector3 = tuple[float, float, float]
TaskName = Literal["pan_tilt", "translation", "planar", "six_dof"]
Mounting = Literal["eye_in_hand", "eye_to_hand"]
Protocol = Literal["trained_code", "held_out"]
RivalName = Literal["triangulate_arun", "pnp", "bundle"]


class Workspace(Model):
    """Where simulated targets and poses are drawn; what is left out takes the task's default.

    Targets are drawn uniformly in the box `target_low_m`..`target_high_m`, in S at the start pose. S moves
    within `travel_m` of the start on each axis, and turns by at most `angle_rad` on each of the task's
    angles (`six_dof` without it: any rotation). `tool_start_m` is where the tool starts in front of fixed
    cameras, with z ahead (eye-to-hand; left out: 2 m ahead).
    """

    target_low_m: Vector3 | None = None
    target_high_m: Vector3 | None = None
    travel_m: Vector3 | None = None
    angle_rad: Positive | None = None
    tool_start_m: Vector3 | None = None


class Rig(Model):
    """A parallel stereo rig: both cameras at ±baseline/2 across and `forward_m` in front of S."""

    width_px: PositiveInt = 640
    height_px: PositiveInt = 480
    fx_px: Positive = 469.0
    fy_px: Positive = 472.0
    cx_px: float = 344.0
    cy_px: float = 255.0
    baseline_m: Positive = 0.20
    forward_m: float = 0.10


class LostTracker(Model):
    """A tracker of a simulated target that loses it for some frames of training.

    It then shows `nothing`, or stays at the `edge` of the image where its target was nearest to it, as if
    that had left the image there: the same pixel frame after frame, and nobody says that it is wrong.
    """

    target: Annotated[int, Field(ge=0)]
    camera: Literal["left", "right", "both"] = "both"
    from_frame: PositiveInt
    frames: PositiveInt
    shows: Literal["nothing", "edge"] = "nothing"


class Simulate(Model):
    """Simulated data: a rig, targets, and a robot moved around.

    With a `tracker`, what is learned has gone through images: they are rendered and tracked on the way, and
    `noise.pixel_px` is that of held-out questions, which are not.
    """

    rig: Literal["dragonfly"] | Rig = "dragonfly"
    frames: Annotated[int, Field(ge=2)] = 400
    targets: PositiveInt | None = None
    motion: Literal["random", "hand_guided"] = "random"
    rate_hz: Positive = 30.0
    workspace: Workspace = Workspace()
    images: RenderedImages = RenderedImages()
    tracker: TargetTracker | None = None
    lost: tuple[LostTracker, ...] = ()
    seed: Annotated[int, Field(ge=0)] = 1

    @model_validator(mode="after")
    def _trackers_lose_by_themselves(self) -> Simulate:
        if self.tracker is not None and self.lost:
            raise ValueError(
                "lost is for targets without images; with a tracker it is the tracker that loses"
            )
        return self

    @model_validator(mode="after")
    def _tracker_follows_what_is_drawn(self) -> Simulate:
        kind = None if self.tracker is None else self.tracker.kind
        if kind is not None and FOLLOWED[kind] != self.images.targets:
            raise ValueError(
                f"tracker {kind} follows images.targets: {FOLLOWED[kind]}, found {self.images.targets}"
            )
        return self


class PoseSource(Model):
    """The topic that carries the robot's pose; `parent`/`child` pick a transform out of several."""

    topic: str
    parent: str | None = None
    child: str | None = None


class JointSource(Model):
    """The JointState topic of a pan-tilt unit and the names of its two joints."""

    topic: str
    pan: str = "pan"
    tilt: str = "tilt"


class TrackSource(Model):
    """The topic that carries `vmf.StereoTracks`."""

    topic: str


class Intrinsics(Model):
    """Pinhole intrinsics of one camera."""

    fx_px: Positive
    fy_px: Positive
    cx_px: float
    cy_px: float


class RigCalibration(Model):
    """A published calibration, for the 3-D rivals only: the learner never sees it.

    A point `P` in S has left-camera coordinates `L_R_S (P − S_p_L_m)`; the right camera's x is smaller by
    the baseline.
    """

    left: Intrinsics
    right: Intrinsics | None = None
    baseline_m: Positive
    L_R_S: tuple[Vector3, Vector3, Vector3]
    S_p_L_m: Vector3 = (0.0, 0.0, 0.0)


class Recording(Model):
    """A recording (MCAP): where the poses (or joints) and the tracks are, and how they are joined.

    Instead of `tracks` there may be `images`, which are tracked on the way.
    """

    path: str
    pose: PoseSource | None = None
    joints: JointSource | None = None
    tracks: TrackSource | None = None
    images: ImageSource | None = None
    sync: Literal["nearest", "interpolate"] = "nearest"
    sync_tolerance_s: Positive = 0.02
    calibration: RigCalibration | None = None

    @model_validator(mode="after")
    def _one_source_of_motion(self) -> Recording:
        if (self.pose is None) == (self.joints is None):
            raise ValueError("give exactly one of pose / joints")
        return self

    @model_validator(mode="after")
    def _one_source_of_tracks(self) -> Recording:
        if (self.tracks is None) == (self.images is None):
            raise ValueError("give exactly one of tracks / images")
        return self


class Data(Model):
    """Exactly one of `simulate` and `recording`."""

    simulate: Simulate | None = None
    recording: Recording | None = None

    @model_validator(mode="after")
    def _exactly_one(self) -> Data:
        if (self.simulate is None) == (self.recording is None):
            raise ValueError("give exactly one of simulate / recording")
        return self


class Noise(Model):
    """Standard deviations of the Gaussian noise put on simulated data, and the share of wrong matches.

    `outlier_ratio` is that of targets in one view which are taken for something else; of questions, which
    have two views, nearly twice as many correspondences are wrong. With `drift_m_per_sqrt_m` and
    `drift_rad_per_sqrt_m` recorded poses are odometry: after d metres of travel each coordinate and angle
    is off by that much times √d, each a random walk in the moving frame.
    """

    pixel_px: NonNegative = 3.0
    point_m: NonNegative = 0.0
    pose_m: NonNegative = 0.0
    pose_rad: NonNegative = 0.0
    drift_m_per_sqrt_m: NonNegative = 0.0
    drift_rad_per_sqrt_m: NonNegative = 0.0
    outlier_ratio: Ratio = 0.0

    @property
    def drifts(self) -> bool:
        """Whether recorded poses are odometry."""
        return self.drift_m_per_sqrt_m > 0.0 or self.drift_rad_per_sqrt_m > 0.0


Estimator = Literal["qr", "tls", "ml"]


class PipelineLearner(Model):
    """Algorithm 1 of the thesis: every observation paired with every other, one factor per tile.

    `matrices: exact` isolates noise to the right-hand sides (thesis Ch. 6): image-based errors enter the
    matrices as they would be without noise, which only a simulation knows.
    """

    kind: Literal["pipeline"] = "pipeline"
    engine: Literal["sequential", "compressed"] = "compressed"
    length: PositiveInt | None = None
    estimator: Estimator = "qr"
    readout: Literal["kaczmarz", "mean", "pooled"] = "mean"
    matrices: Literal["observed", "exact"] = "observed"

    @model_validator(mode="after")
    def _engine_can_do_it(self) -> PipelineLearner:
        if self.engine == "compressed" and self.readout == "kaczmarz":
            raise ValueError("readout kaczmarz depends on the order of updates and needs engine: sequential")
        if self.estimator == "ml" and self.readout != "mean":
            raise ValueError(f"readout {self.readout} works on factors; estimator ml needs readout: mean")
        if self.matrices == "exact" and (self.engine, self.estimator) != ("sequential", "qr"):
            raise ValueError("matrices: exact needs engine: sequential and estimator: qr")
        return self


class TransportLearner(Model):
    """One lifted camera per tracked target, transported to every visited stereo code.

    `visited: own` lets exactly visited codes answer with their own target's parameters, `approximated` asks
    the approximator about them like about any other code.
    """

    kind: Literal["transport"] = "transport"
    visited: Literal["approximated", "own"] = "approximated"
    estimator: Estimator = "ml"
    loss: Literal["squared", "huber", "tukey"] = "squared"


class StructuredLearner(Model):
    """Two camera matrices shared by all targets, from the robot's own motion: robust bundle adjustment.

    Θ_S is analytic at the code's triangulated point, so the approximator has nothing to do. `distortion:
    radial` learns a radial distortion of each lens too.
    """

    kind: Literal["structured"] = "structured"
    distortion: Literal["none", "radial"] = "none"


class Solver(Model):
    """How a motion is solved from parameters and image-based errors.

    `cost: ml` finds the motion and the true stereo codes together. `auto` is `ml`, but `geometric` for the
    pipeline, whose parameters belong to the codes as they were observed.
    """

    cost: Literal["auto", "algebraic", "geometric", "ml"] = "auto"
    cameras: Literal["left", "right", "both"] = "both"
    start: Literal["zero", "linear", "multi"] = "multi"
    known: Literal["none", "rotation"] = "none"
    max_iterations: PositiveInt = 100


class CalibrationError(Model):
    """What is wrong with a rival's cameras: what the true rig has beyond its calibration."""

    focal_percent: Annotated[float, Field(gt=-100.0)] = 0.0
    principal_px: float = 0.0
    rotation_deg: float = 0.0
    baseline_percent: Annotated[float, Field(gt=-100.0)] = 0.0


class Rival(Model):
    """A 3-D reconstruction method, with exact cameras or cameras that are off by a stated error."""

    method: RivalName
    error: CalibrationError = CalibrationError()


class CalibrationSweep(Model):
    """How far a rival's cameras may be off before it falls behind: one kind of error at a time, growing.

    `compare-3d` asks `methods` the held-out questions with each of these errors, but no more than
    `questions` of each case, spread evenly, and fewer where they hold very many targets.
    """

    focal_percent: tuple[Annotated[Positive, Field(le=100.0)], ...] = (0.5, 1.0, 2.0, 4.0)
    principal_px: tuple[Positive, ...] = (2.0, 5.0, 10.0, 20.0)
    rotation_deg: tuple[Annotated[Positive, Field(le=180.0)], ...] = (0.1, 0.2, 0.5, 1.0)
    baseline_percent: tuple[Annotated[Positive, Field(le=100.0)], ...] = (1.0, 2.0, 5.0, 10.0)
    methods: tuple[RivalName, ...] = ("bundle",)
    questions: PositiveInt = 200


class Evaluate(Model):
    """What is asked of the trained function, and how the answers are counted.

    A motion is solved after `curve_points` numbers of frames between 2 and all, in steps that grow with them
    or `even` ones; as many points as frames are every frame. `beyond` counts all answers at trained
    codes after more than so many frames as one case.
    """

    protocol: tuple[Protocol, ...] = ("trained_code", "held_out")
    trials: PositiveInt = 1
    checkpoints: tuple[PositiveInt, ...] | None = None
    beyond: tuple[PositiveInt, ...] = ()
    curve_points: Annotated[int, Field(ge=0)] = 40
    curve_spacing: Literal["geometric", "even"] = "geometric"
    queries: PositiveInt = 60
    query_targets: PositiveInt | None = None
    train_fraction: Annotated[float, Field(gt=0.0, lt=1.0)] = 0.6
    folds: PositiveInt = 1
    gaps: tuple[PositiveInt, ...] = (5,)
    min_targets: PositiveInt | None = None
    bootstrap: PositiveInt = 2000


AnyLearner = Annotated[PipelineLearner | TransportLearner | StructuredLearner, Field(discriminator="kind")]


class OtherFunction(Model):
    """Another function that learns from the same data and is asked the same questions, as `vmf[name]`.

    What it leaves out is as in the rest of the spec. With fewer `curve_points` than that, it is asked after
    fewer frames.
    """

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_.-]+$")]
    lift: Literal["general", "thesis"] | None = None
    learner: AnyLearner | None = None
    approximator: AnyApproximator | None = None
    solver: Solver | None = None
    curve_points: Annotated[int, Field(ge=0)] | None = None

    def within(self, spec: Spec) -> Spec:
        """Return the spec of this function alone."""
        own = {
            key: value
            for key in ("lift", "learner", "approximator", "solver")
            if (value := getattr(self, key))
        }
        evaluate = spec.evaluate
        if self.curve_points is not None:
            evaluate = evaluate.model_copy(update={"curve_points": self.curve_points})
        return spec.model_copy(update={**own, "evaluate": evaluate, "also": ()})


class Spec(Model):
    """An experiment, complete: what a file leaves out takes the defaults written here."""

    name: str | None = None
    task: TaskName
    mounting: Mounting = "eye_in_hand"
    lift: Literal["general", "thesis"] = "general"
    data: Data
    noise: Noise = Noise()
    learner: AnyLearner = StructuredLearner()
    approximator: AnyApproximator = PolynomialApproximator()
    solver: Solver = Solver()
    also: tuple[OtherFunction, ...] = ()
    rivals: tuple[Rival, ...] = (
        Rival(method="triangulate_arun"),
        Rival(method="pnp"),
        Rival(method="bundle"),
    )
    calibration_sweep: CalibrationSweep | None = CalibrationSweep()
    evaluate: Evaluate = Evaluate()

    @model_validator(mode="after")
    def _functions_are_possible(self) -> Spec:
        _approximator_suits_the_learner(self)
        names = [other.name for other in self.also]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"also: found the name {name!r} twice, a name of its own is expected")
        for other in self.also:
            try:
                _approximator_suits_the_learner(other.within(self))
            except ValueError as error:
                raise ValueError(f"also, {other.name}: {error}") from None
        return self


def _approximator_suits_the_learner(spec: Spec) -> None:
    if not isinstance(spec.learner, PipelineLearner):
        return
    if not isinstance(spec.approximator, CmacApproximator):
        # Without tiles, every visited code has its own equations, whose solutions are approximated.
        if spec.learner.readout != "mean":
            raise ValueError(
                f"learner.readout: {spec.learner.readout} joins the tiles of approximator.kind: cmac, "
                f"found {spec.approximator.kind}"
            )
    elif spec.approximator.training != "albus":
        raise ValueError(
            f"approximator.training: {spec.approximator.training} needs learner.kind: transport; the "
            "tiles of the pipeline hold equations of their own"
        )
