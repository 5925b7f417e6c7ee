"""The experiment spec: one frozen, typed model for everything a YAML file may say."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, PositiveInt, model_validator

from vmf.spec.approximators import AnyApproximator, CmacApproximator, PolynomialApproximator
from vmf.spec.base import Drift, Model, NonNegative, Positive, Ratio
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
    """Lowest corner of the box of targets. Eye-in-hand about 2 m ahead, eye-to-hand ±0.1 m about the tool."""
    target_high_m: Vector3 | None = None
    """Highest corner of the box of targets."""
    travel_m: Vector3 | None = None
    """Half the width of the box in which S moves, along each axis; by default 1 m (eye-to-hand 0.3, 0.4, 0.3
    m).
    """
    angle_rad: Positive | None = None
    """By default 0.6, planar 0.5; `six_dof` any rotation, but 0.6 if hand-guided or eye-to-hand."""
    tool_start_m: Vector3 | None = None
    """Only eye-to-hand."""


class Rig(Model):
    """A parallel stereo rig: both cameras at ±baseline/2 across and `forward_m` in front of S."""

    width_px: PositiveInt = 640
    """Width of both images."""
    height_px: PositiveInt = 480
    """Height of both images."""
    fx_px: Positive = 469.0
    """Focal length along x."""
    fy_px: Positive = 472.0
    """Focal length along y."""
    cx_px: float = 344.0
    """Principal point, x."""
    cy_px: float = 255.0
    """Principal point, y."""
    baseline_m: Positive = 0.20
    """Distance between the cameras."""
    forward_m: float = 0.10
    """How far the cameras are in front of S."""


class LostTracker(Model):
    """A tracker of a simulated target that loses it for some frames of training.

    It then shows `nothing`, or stays at the `edge` of the image where its target was nearest to it, as if
    that had left the image there: the same pixel frame after frame, and nobody says that it is wrong.
    """

    target: Annotated[int, Field(ge=0)]
    """Its number, from 0."""
    camera: Literal["left", "right", "both"] = "both"
    """Where it is lost."""
    from_frame: PositiveInt
    """The first frame without it."""
    frames: PositiveInt
    """For how many frames."""
    shows: Literal["nothing", "edge"] = "nothing"
    """What is reported instead."""


class Simulate(Model):
    """Simulated data: a rig, targets, and a robot moved around.

    With a `tracker`, what is learned has gone through images: they are rendered and tracked on the way, and
    `noise.pixel_px` is that of held-out questions, which are not.
    """

    rig: Literal["dragonfly"] | Rig = "dragonfly"
    """The cameras: the thesis's rig (Table 5.1) or one of your own."""
    frames: Annotated[int, Field(ge=2)] = 400
    """How many views are learned from."""
    targets: PositiveInt | None = None
    """How many targets there are; by default pan_tilt 1, translation 2, planar 2, six_dof 6."""
    motion: Literal["random", "hand_guided"] = "random"
    """`random`: every frame anywhere in the workspace. `hand_guided`: a smooth path through it."""
    rate_hz: Positive = 30.0
    """Frames per second: time stamps, and how far a hand-guided motion gets between frames."""
    workspace: Workspace = Workspace()
    """Where targets and poses lie."""
    images: RenderedImages = RenderedImages()
    """What `vmf simulate --images` draws."""
    tracker: TargetTracker | None = None
    """Without one, targets are seen by themselves, with `noise`."""
    lost: tuple[LostTracker, ...] = ()
    """Targets that are lost for a while."""
    seed: Annotated[int, Field(ge=0)] = 1
    """Of all random numbers: the same seed gives the same data."""

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
    """Name of the channel."""
    parent: str | None = None
    """Frame that poses are in."""
    child: str | None = None
    """Frame whose poses they are."""


class JointSource(Model):
    """The JointState topic of a pan-tilt unit and the names of its two joints."""

    topic: str
    """Name of the channel."""
    pan: str = "pan"
    """Name of the pan joint."""
    tilt: str = "tilt"
    """Name of the tilt joint."""


class TrackSource(Model):
    """The topic that carries `vmf.StereoTracks`."""

    topic: str
    """Name of the channel."""


class Intrinsics(Model):
    """Pinhole intrinsics of one camera."""

    fx_px: Positive
    """Focal length along x."""
    fy_px: Positive
    """Focal length along y."""
    cx_px: float
    """Principal point, x."""
    cy_px: float
    """Principal point, y."""


class RigCalibration(Model):
    """A published calibration, for the 3-D rivals only: the learner never sees it.

    A point `P` in S has left-camera coordinates `L_R_S (P − S_p_L_m)`; the right camera's x is smaller by
    the baseline.
    """

    left: Intrinsics
    """The left camera."""
    right: Intrinsics | None = None
    """The right camera, by default like the left one."""
    baseline_m: Positive
    """Distance between the cameras."""
    L_R_S: tuple[Vector3, Vector3, Vector3]
    """Rows of the rotation from S to the left camera."""
    S_p_L_m: Vector3 = (0.0, 0.0, 0.0)
    """Where the left camera is, in S."""


class Recording(Model):
    """A recording (MCAP): where the poses (or joints) and the tracks are, and how they are joined.

    Instead of `tracks` there may be `images`, which are tracked on the way.
    """

    path: str
    """The MCAP file, from the spec's own directory."""
    pose: PoseSource | None = None
    """Where the poses of S are: exactly one of `pose` and `joints`."""
    joints: JointSource | None = None
    """Angles of a pan-tilt unit instead of poses."""
    tracks: TrackSource | None = None
    """Where the tracked targets are: exactly one of `tracks` and `images`."""
    images: ImageSource | None = None
    """Images that are tracked on the way, instead of tracks."""
    sync: Literal["nearest", "interpolate"] = "nearest"
    """What pose a track gets: the nearest in time, or one interpolated between two."""
    sync_tolerance_s: Positive = 0.02
    """Tracks farther in time from any pose are dropped and counted."""
    calibration: RigCalibration | None = None
    """For the rivals alone; without it there are none."""

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
    """Data made up."""
    recording: Recording | None = None
    """Data recorded."""

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
    """On every pixel coordinate of every observation."""
    point_m: NonNegative = 0.0
    """Targets move by so much, on each axis, between training and question."""
    pose_m: NonNegative = 0.0
    """On each coordinate of every recorded position."""
    pose_rad: NonNegative = 0.0
    """On every recorded orientation, about each axis."""
    drift_m_per_sqrt_m: Drift = 0.0
    """Random walk of recorded positions."""
    drift_rad_per_sqrt_m: Drift = 0.0
    """Random walk of recorded orientations."""
    outlier_ratio: Ratio = 0.0
    """Share of targets in a view that are something else."""

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
    """`compressed` has the same factors in constant time per frame; `sequential` is the literal loop over
    pairs.
    """
    length: PositiveInt | None = None
    """How many observations of each target are kept to pair with; by default all."""
    estimator: Estimator = "qr"
    """`qr`: least squares with a constant fixed, as in the thesis. `tls`: no entry fixed. `ml`: least
    reprojection error.
    """
    readout: Literal["kaczmarz", "mean", "pooled"] = "mean"
    """What a code's tiles answer together: steps of Kaczmarz's rule in order, the mean of their solutions,
    or the solution of all their equations.
    """
    matrices: Literal["observed", "exact"] = "observed"
    """Whether noise is in the matrices too."""

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
    """Who answers at visited codes."""
    estimator: Estimator = "ml"
    """`qr`: least squares with a constant fixed. `tls`: no entry fixed. `ml`: least reprojection error,
    started from `tls`.
    """
    loss: Literal["squared", "huber", "tukey"] = "squared"
    """How wrong tracks weigh in `ml`: fully, less, or not at all beyond a limit."""


class StructuredLearner(Model):
    """Two camera matrices shared by all targets, from the robot's own motion: robust bundle adjustment.

    Θ_S is analytic at the code's triangulated point, so the approximator has nothing to do. `distortion:
    radial` learns a radial distortion of each lens too.
    """

    kind: Literal["structured"] = "structured"
    distortion: Literal["none", "radial"] = "none"
    """Whether a lens coefficient of each camera is learned."""


class Solver(Model):
    """How a motion is solved from parameters and image-based errors.

    `cost: ml` finds the motion and the true stereo codes together. `auto` is `ml`, but `geometric` for the
    pipeline, whose parameters belong to the codes as they were observed.
    """

    cost: Literal["auto", "algebraic", "geometric", "ml"] = "auto"
    """What is minimised: `algebraic` (thesis), `geometric` (pixels), `ml` (pixels of both views, robustly).
    """
    cameras: Literal["left", "right", "both"] = "both"
    """Whose image-based errors are used."""
    start: Literal["zero", "linear", "multi"] = "multi"
    """Where the search starts: at no motion, at the linear solution, or at these and one more (the best end
    is kept).
    """
    known: Literal["none", "rotation"] = "none"
    """`rotation`: it is given with the question, and only the translation is solved for."""
    max_iterations: PositiveInt = 100
    """Steps of Levenberg and Marquardt's method from each start."""


class CalibrationError(Model):
    """What is wrong with a rival's cameras: what the true rig has beyond its calibration."""

    focal_percent: Annotated[float, Field(gt=-100.0)] = 0.0
    """Both focal lengths of both cameras."""
    principal_px: float = 0.0
    """Principal points, right and down."""
    rotation_deg: float = 0.0
    """Cameras turned towards each other."""
    baseline_percent: Annotated[float, Field(gt=-100.0)] = 0.0
    """Distance between the cameras."""


class Rival(Model):
    """A 3-D reconstruction method, with exact cameras or cameras that are off by a stated error.

    It learns nothing, and need not be asked after every number of frames after which functions are.
    """

    method: RivalName
    """Which one."""
    error: CalibrationError = CalibrationError()
    """How far its cameras are off."""
    curve_points: Annotated[int, Field(ge=0)] | None = None
    """After how many of them it is asked, beside the checkpoints, spread evenly; by default after all."""


class CalibrationSweep(Model):
    """How far a rival's cameras may be off before it falls behind: one kind of error at a time, growing.

    `compare-3d` asks `methods` the held-out questions with each of these errors, but no more than
    `questions` of each case, spread evenly, and fewer where they hold very many targets.
    """

    focal_percent: tuple[Annotated[Positive, Field(le=100.0)], ...] = (0.5, 1.0, 2.0, 4.0)
    """Errors of the focal lengths."""
    principal_px: tuple[Positive, ...] = (2.0, 5.0, 10.0, 20.0)
    """Errors of the principal points."""
    rotation_deg: tuple[Annotated[Positive, Field(le=180.0)], ...] = (0.1, 0.2, 0.5, 1.0)
    """Errors of the rotation between the cameras."""
    baseline_percent: tuple[Annotated[Positive, Field(le=100.0)], ...] = (1.0, 2.0, 5.0, 10.0)
    """Errors of the baseline."""
    methods: tuple[RivalName, ...] = ("bundle",)
    """Who is asked."""
    questions: PositiveInt = 200
    """At most so many of each case."""


class Evaluate(Model):
    """What is asked of the trained function, and how the answers are counted.

    A motion is solved after `curve_points` numbers of frames between 2 and all, in steps that grow with them
    or `even` ones; as many points as frames are every frame. The last `curve_last` frames are all asked about
    beside these, and whatever is counted over many frames counts each of them. `beyond` counts all answers at
    trained codes after more than so many frames as one case.
    """

    protocol: tuple[Protocol, ...] = ("trained_code", "held_out")
    """What is asked: the newest view from a trained one (thesis), and what was held out."""
    trials: PositiveInt = 1
    """How often a simulation is made anew, with other random numbers."""
    checkpoints: tuple[PositiveInt, ...] | None = None
    """Frame counts of which statistics are taken; by default the last."""
    beyond: tuple[PositiveInt, ...] = ()
    """Frame counts beyond which answers are counted together."""
    curve_points: Annotated[int, Field(ge=0)] = 40
    """How many points the curves over the frames have; 0 is none."""
    curve_spacing: Literal["geometric", "even"] = "geometric"
    """How they lie between 2 and all frames."""
    curve_last: Annotated[int, Field(ge=0)] = 0
    """So many last frames are all asked about, whatever one's curve points; 0 is none."""
    queries: PositiveInt = 60
    """Held-out questions of each trial of a simulation."""
    query_targets: PositiveInt | None = None
    """Targets of a held-out question of a simulation; by default as many as in training."""
    train_fraction: Annotated[float, Field(gt=0.0, lt=1.0)] = 0.6
    """Share of a recording's time that is learned from; the rest is asked about."""
    folds: PositiveInt = 1
    """More than 1: a recording is cut into so many blocks of time, each asked about by what the others
    taught.
    """
    gaps: tuple[PositiveInt, ...] = (5,)
    """How many frames the two views of a held-out question of a recording are apart."""
    min_targets: PositiveInt | None = None
    """Targets a question about a recording needs; by default pan_tilt 1, translation 2, planar 2, six_dof 4,
    but 1 with `known: rotation`.
    """
    bootstrap: PositiveInt = 2000
    """Resamples from which intervals of means are taken."""


AnyLearner = Annotated[PipelineLearner | TransportLearner | StructuredLearner, Field(discriminator="kind")]


class OtherFunction(Model):
    """Another function that learns from the same data and is asked the same questions, as `vmf[name]`.

    What it leaves out is as in the rest of the spec. With fewer `curve_points` than that, it is asked after
    fewer frames, but after the last `evaluate.curve_last` all the same.
    """

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_.-]+$")]
    """Its name in tables: `vmf[name]`."""
    lift: Literal["general", "thesis"] | None = None
    """As of the spec."""
    learner: AnyLearner | None = None
    """As of the spec."""
    approximator: AnyApproximator | None = None
    """As of the spec."""
    solver: Solver | None = None
    """As of the spec."""
    curve_points: Annotated[int, Field(ge=0)] | None = None
    """As of `evaluate`."""

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
    """Name of the run directory; by default the file's."""
    task: TaskName
    """How the robot moves: two angles, a translation, in a plane, or freely."""
    mounting: Mounting = "eye_in_hand"
    """Cameras on what moves, or fixed cameras that look at it."""
    lift: Literal["general", "thesis"] = "general"
    """`thesis`: the 8 entries of pan-tilt motions as printed; see the method, C3."""
    data: Data
    """What is learned from."""
    noise: Noise = Noise()
    """On simulated data."""
    learner: AnyLearner = StructuredLearner()
    """How the function is learned."""
    approximator: AnyApproximator = PolynomialApproximator()
    """How it is carried from visited stereo codes to others."""
    solver: Solver = Solver()
    """How a motion is found from it."""
    also: tuple[OtherFunction, ...] = ()
    """Other functions, that learn from the same draws and answer the same questions."""
    rivals: tuple[Rival, ...] = (
        Rival(method="triangulate_arun"),
        Rival(method="pnp"),
        Rival(method="bundle"),
    )
    """3-D reconstruction methods that are asked too (`compare-3d`, `evaluate`); they need the cameras."""
    calibration_sweep: CalibrationSweep | None = CalibrationSweep()
    """Rivals with worse and worse calibration (`compare-3d`); `null` is none."""
    evaluate: Evaluate = Evaluate()
    """What is asked, and how answers are counted."""

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
