"""The command line: it parses, calls one function of `experiment`, and prints."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer

from vmf.errors import InputError, Loss, UnfinishedError

if TYPE_CHECKING:
    from vmf.experiment import RunResult
    from vmf.progress import Reporter

_HELP = """Learn the visuomotor function: from pixel errors straight to one position command.

A first run, then the errors of its model on new targets at new poses:

    vmf train configs/quickstart.yaml

    vmf evaluate runs/quickstart/latest

Beside 3-D reconstruction with calibrated cameras, on the same points, poses and noise:

    vmf compare-3d configs/thesis/six_dof.yaml evaluate.trials=10

Any setting can be given behind the spec: approximator.tile_px=16 noise.pixel_px=1e-3
"""

app = typer.Typer(
    help=_HELP,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

SpecArgument = Annotated[Path, typer.Argument(metavar="SPEC", help="The experiment, a YAML file.")]
OverrideArgument = Annotated[
    list[str] | None, typer.Argument(metavar="[KEY=VALUE]...", help="Dotted settings over the spec's.")
]
OutOption = Annotated[Path, typer.Option(help="Where run directories go.")]
JobsOption = Annotated[int, typer.Option(min=0, help="Processes for trials; 0 means one per core.")]
ResumeOption = Annotated[bool, typer.Option(help="Go on with an unfinished run of the same spec.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print the result table as JSON.")]
QuietOption = Annotated[bool, typer.Option(help="No progress and no log.")]


@app.command()
def train(
    spec: SpecArgument,
    overrides: OverrideArgument = None,
    out: OutOption = Path("runs"),
    jobs: JobsOption = 0,
    resume: ResumeOption = False,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Learn from simulated or recorded data; write model, errors, summary and plots."""
    _experiment("train", spec, overrides, out, jobs, resume, as_json, quiet)


@app.command(name="compare-3d")
def compare_3d(
    spec: SpecArgument,
    overrides: OverrideArgument = None,
    out: OutOption = Path("runs"),
    jobs: JobsOption = 0,
    resume: ResumeOption = False,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Compare with 3-D reconstruction on the same points, poses and noise draws."""
    _experiment("compare-3d", spec, overrides, out, jobs, resume, as_json, quiet)


@app.command()
def study(
    spec: Annotated[Path, typer.Argument(metavar="SPEC", help="The study, a YAML file.")],
    overrides: OverrideArgument = None,
    out: OutOption = Path("runs"),
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Show something about the method itself; write quantities, tables and figures.

    vmf study configs/thesis/stereo_codes.yaml study.pixels=8
    """
    from vmf.experiment import run_study
    from vmf.spec import load_study
    from vmf.study_table import as_text, to_json

    with _progress(quiet, "nothing was finished"):
        result = run_study(load_study(spec, overrides or ()), out)
    typer.echo(to_json(result) if as_json else as_text(result))
    for note in () if quiet else result.notes:
        typer.echo(f"note: {note}", err=True)
    _end(result.losses)


@app.command()
def evaluate(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="A run directory, or its `latest` link.")],
    overrides: OverrideArgument = None,
    data: Annotated[Path | None, typer.Option(help="Another recording of the same rig.")] = None,
    out: Annotated[Path | None, typer.Option(help="Where to instead of RUN/evaluations.")] = None,
    mcap: Annotated[
        Path | None, typer.Option(metavar="FILE.mcap", help="Also as a recording, to look at in Foxglove.")
    ] = None,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Evaluate a trained model on held-out targets and poses."""
    from vmf.experiment import evaluate as evaluate_run

    with _progress(quiet) as progress:
        result = evaluate_run(run, tuple(overrides or ()), data, progress.report, out, mcap)
    _print_result(result, as_json, quiet)


@app.command()
def simulate(
    spec: SpecArgument,
    overrides: OverrideArgument = None,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="FILE.mcap", help="Where to.")] = ...,  # type: ignore[assignment]
    images: Annotated[bool, typer.Option(help="Render what both cameras see.")] = False,
    quiet: QuietOption = False,
) -> None:
    """Write a simulated recording.

    With --images both cameras' images are rendered, for `vmf track`, as
    data.simulate.images says: targets (texture, tag, blob, chessboard) of
    size_m before a background (texture, plain), distortion (k1, k2) of the
    lenses, blur_px, noise (grey levels), exposure (a factor) and
    exposure_drift (of it, from frame to frame), format (jpeg, png) and
    jpeg_quality. Tracking needs a motion that can be followed:

        vmf simulate configs/quickstart.yaml --images -o film.mcap
        data.simulate.motion=hand_guided data.simulate.rate_hz=10
        data.simulate.images.distortion=[-0.1,0.02]
    """
    from vmf.experiment.simulated import hard_to_follow, write_simulation
    from vmf.spec import load

    with _progress(quiet, "nothing was written") as progress:
        tracks = write_simulation(load(spec, overrides or ()), output, images, progress.report)
    typer.echo(
        f"{output}: {tracks.n_frames} frames, {tracks.n_targets} targets, {len(tracks.frame)} observations"
    )
    note = hard_to_follow(tracks) if images and not quiet else None
    if note is not None:
        typer.echo(f"note: {note}", err=True)


@app.command()
def solve(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="A run directory, or a model.npz.")],
    overrides: Annotated[
        list[str] | None, typer.Argument(metavar="[KEY=VALUE]...", help="Settings, as solver.cameras=left.")
    ] = None,
    target: Annotated[
        list[str] | None,
        typer.Option(
            metavar="INITIAL:DESIRED",
            help="A target's xL,yL,xR,yR (px) in both views, with - for what is not seen; once per target.",
        ),
    ] = None,
    file: Annotated[
        str | None, typer.Option(metavar="FILE", help="YAML or JSON with all there is to say; - is stdin.")
    ] = None,
    initial: Annotated[
        str | None, typer.Option(metavar="FILE", help="A vmf.StereoTracks message, or a list of codes.")
    ] = None,
    desired: Annotated[str | None, typer.Option(metavar="FILE", help="The same of the desired view.")] = None,
    pose: Annotated[
        str | None, typer.Option(metavar="X,Y,Z,QX,QY,QZ,QW", help="Present pose, as it was trained with.")
    ] = None,
    joints: Annotated[
        str | None, typer.Option(metavar="PAN,TILT", help="Present angles of a pan-tilt unit (rad).")
    ] = None,
    rotation: Annotated[
        str | None, typer.Option(metavar="QX,QY,QZ,QW", help="With known: rotation, that of the motion E'.")
    ] = None,
    orientation: Annotated[
        str | None, typer.Option(metavar="QX,QY,QZ,QW", help="The same, as that of --pose at the goal.")
    ] = None,
    style: Annotated[
        str, typer.Option("--format", help="yaml, json, pose_stamped or pose_with_covariance_stamped.")
    ] = "yaml",
    frame_id: Annotated[str | None, typer.Option(help="Frame that --pose is in, for messages.")] = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="FILE", help="Where to instead of stdout.")
    ] = None,
    anyway: Annotated[bool, typer.Option("--anyway", help="Ask outside the trained region, too.")] = False,
) -> None:
    """Turn an initial and a desired view into one motion command.

    The motion E' takes coordinates in the moving frame S at the initial view to S at the desired view.

    With --pose, the pose to command is W_T_S inv(E') eye-in-hand and E' B_T_tool eye-to-hand.
    """
    from vmf.experiment import Sources, solve_views
    from vmf.move_output import check_format, rendered, write

    check_format(style)
    sources = Sources(tuple(target or ()), file, initial, desired, pose, joints, rotation, orientation)
    move = solve_views(run, sources.read(), tuple(overrides or ()), anyway=anyway, frame_id=frame_id)
    text = rendered(move, style)
    for note in move.notes:
        typer.echo(f"note: {note}", err=True)
    if text is not None and output is not None:
        write(output, text)
    elif text is not None:
        typer.echo(text)
    if move.motion is None:
        typer.echo(f"{move.status}: {move.reason}; there is no command", err=True)
        raise typer.Exit(3)


@app.command()
def track(
    recording: Annotated[Path, typer.Argument(metavar="FILE.mcap", help="A recording with stereo images.")],
    options: Annotated[
        list[str] | None, typer.Argument(metavar="[KEY=VALUE]...", help="Settings of the tracker.")
    ] = None,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="TRACKS.mcap", help="Where to.")] = ...,  # type: ignore[assignment]
    tracker: Annotated[
        str, typer.Option(help="meanshift, camshift, klt, sift, aruco, apriltag or chessboard.")
    ] = "klt",
    left: Annotated[str | None, typer.Option(metavar="TOPIC", help="The left camera's images.")] = None,
    right: Annotated[str | None, typer.Option(metavar="TOPIC", help="The right camera's images.")] = None,
    region: Annotated[
        list[str] | None,
        typer.Option(metavar="X,Y,W,H", help="A target in the first left image; may be given again."),
    ] = None,
    pair_tolerance_s: Annotated[
        float | None, typer.Option(min=1e-9, help="Between two images of a pair.")
    ] = None,
    pose: Annotated[
        str | None, typer.Option(metavar="TOPIC", help="Poses, for sift with void_after_m.")
    ] = None,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Turn stereo images into stereo tracks, with the poses beside them."""
    from vmf.experiment import tracking

    source = tracking.image_source(
        tracker, tuple(options or ()), left, right, tuple(region or ()), pair_tolerance_s
    )
    with _progress(quiet, "nothing was written") as progress:
        result = tracking.track(recording, output, source, progress.report, pose)
    typer.echo(result.to_json() if as_json else "\n".join(result.lines()))
    if not quiet:
        for repair in result.repairs:
            typer.echo(f"note: repaired: {repair}", err=True)
    _end(result.losses)


@app.command(name="import")
def import_(
    kind: Annotated[str, typer.Argument(metavar="FORMAT", help="euroc, tum, kitti, npz, csv or rosbag2.")],
    source: Annotated[Path, typer.Argument(metavar="SOURCE", help="A folder, or a file.")],
    options: Annotated[
        list[str] | None, typer.Argument(metavar="[KEY=VALUE]...", help="Settings of the format.")
    ] = None,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="FILE.mcap", help="Where to.")] = ...,  # type: ignore[assignment]
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Turn a folder of stereo images or tracks, with poses, into a recording.

    euroc: mav0 with cam0, cam1 and state_groundtruth_estimate0 or vicon0.

    tum: left.txt and right.txt, or folders image_left and image_right; groundtruth.txt.

    kitti: image_0 and image_1, or image_2 and image_3; times.txt, poses.txt.

    npz: arrays times_s, poses or position_m and quaternion_xyzw, pixels, ids, image_size.

    csv: pose.csv (time_s, x_m, y_m, z_m, qx, qy, qz, qw) and tracks.csv
    (time_s, id, x_L_px, y_L_px, x_R_px, y_R_px), or one file with all columns.

    rosbag2: a directory with metadata.yaml, in MCAP or SQLite.
    """
    from vmf.experiment.importing import import_recording

    with _progress(quiet, "nothing was written") as progress:
        result = import_recording(kind, source, output, tuple(options or ()), progress.report)
    typer.echo(result.to_json() if as_json else "\n".join(result.lines()))
    for repair in () if quiet else result.repairs:
        typer.echo(f"note: repaired: {repair}", err=True)
    _end(result.losses)


@app.command()
def info(path: Annotated[Path, typer.Argument(help="A recording, a run directory or a model.npz.")]) -> None:
    """Say what a recording, a run or a model holds."""
    from vmf.experiment.inspect import inspect

    lines, losses = inspect(path)
    typer.echo("\n".join(lines))
    _end(losses)


@app.command()
def sweep(
    spec: SpecArgument,
    settings: Annotated[
        list[str] | None,
        typer.Argument(metavar="[KEY=VALUE[,VALUE]...]...", help="Dotted settings, values with commas."),
    ] = None,
    grid: Annotated[
        Path | None, typer.Option(metavar="FILE.yaml", help="Settings in a file; the command line beats it.")
    ] = None,
    command: Annotated[str, typer.Option(help="What to do at each point: train or compare-3d.")] = "train",
    out: OutOption = Path("runs"),
    jobs: JobsOption = 0,
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="A Dask scheduler whose workers do the trials."),
    ] = None,
    plots: Annotated[bool, typer.Option("--plots", help="Draw figures too: seconds a point.")] = False,
    pdf: Annotated[bool, typer.Option("--pdf/--no-pdf", help="Figures as PDF beside PNG.")] = True,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Run every combination of settings; what is done already is skipped.

    Six points, the last setting varying fastest. Commas in brackets, braces
    and quotes belong to a value.

        vmf sweep SPEC noise.pixel_px=0,1,3 evaluate.queries=20,60

    The same from a file (--grid), which may list its points one by one:

        sweep: {noise.pixel_px: [0, 1, 3], evaluate.queries: [20, 60]}

        sweep: [{noise.pixel_px: 0}, {noise.pixel_px: 3, solver.start: zero}]

    Every point is a run directory OUT/NAME-sweep/HASH, NAME being the spec's
    (with --command compare-3d: OUT/NAME-compare-3d-sweep/HASH). Made again,
    the command goes on where it was stopped, in whatever way, tries points
    that failed once more, and replaces those whose recording has changed.
    `vmf table OUT/NAME-sweep` prints them all.

    The workers of a scheduler need the same vmf, and a spec's recording at
    the same path. It has to be one that you trust with your account: work
    travels as it is run.
    """
    import os

    from vmf.experiment import SweepOptions
    from vmf.experiment import sweep as run_sweep
    from vmf.sweep_table import as_text, to_json

    if command not in ("train", "compare-3d"):
        raise InputError(f"--command: found {command!r}, accepted: train, compare-3d")
    options = SweepOptions(out, jobs or os.cpu_count() or 1, scheduler, plots, pdf)
    with _progress(quiet, "finished trials are on disk, the same command goes on from there") as progress:
        result = run_sweep(spec, settings or (), grid, command, options, progress.report, progress.say)
    typer.echo(to_json(result) if as_json else as_text(result))
    for note in () if quiet else result.notes:
        typer.echo(f"note: {note}", err=True)
    for loss in result.losses:
        typer.echo(f"lost: {loss}", err=True)
    if result.failed or result.losses:
        raise typer.Exit(2 if result.all_wrong else 3)


@app.command()
def table(
    runs: Annotated[
        list[Path],
        typer.Argument(metavar="RUN...", help="Finished runs, or directories of runs such as a sweep's."),
    ],
    style: Annotated[str, typer.Option("--format", help="markdown, csv or latex.")] = "markdown",
    as_json: Annotated[bool, typer.Option("--json", help="Print the rows as JSON.")] = False,
) -> None:
    """Print runs side by side, with the settings in which they differ."""
    from vmf.experiment.table import side_by_side
    from vmf.table_formats import FORMATS, to_json

    if style not in FORMATS:
        raise InputError(f"--format: found {style!r}, accepted: {', '.join(FORMATS)}")
    found = side_by_side(runs)
    typer.echo(to_json(found) if as_json else FORMATS[style](found.rows))
    for note in found.notes:
        typer.echo(f"note: {note}", err=True)
    _end(found.losses)


@app.command()
def report(
    runs: Annotated[
        list[Path],
        typer.Argument(metavar="RUN...", help="Finished runs, or directories of runs such as a sweep's."),
    ],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="FILE.html", help="Where to.")] = Path(
        "report.html"
    ),
    thesis: Annotated[
        bool | None,
        typer.Option(
            "--thesis/--no-thesis",
            help="The thesis's numbers beside ours; by default if a run is of its experiments.",
        ),
    ] = None,
    quiet: QuietOption = False,
) -> None:
    """Write one self-contained HTML page of runs: numbers, figures, specs.

    Runs of configs/thesis/ (`make thesis`) stand beside what the thesis printed.
    """
    from vmf.experiment.reporting import report as write_report

    result = write_report(runs, output, thesis)
    runs_said = "1 run" if result.runs == 1 else f"{result.runs} runs"
    typer.echo(f"{result.path}: {runs_said}, {result.size / 1e6:.1f} MB")
    for note in () if quiet else result.notes:
        typer.echo(f"note: {note}", err=True)
    _end(result.losses)


@app.command()
def bench(
    names: Annotated[
        list[str] | None, typer.Argument(metavar="[NAME]...", help="Figures to measure; all by default.")
    ] = None,
    quick: Annotated[bool, typer.Option(help="Miniature sizes, to see that everything runs.")] = False,
    out: Annotated[Path, typer.Option(help="Where bench.json and bench.txt go.")] = Path("runs"),
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Measure the performance figures of this machine, each as a ratio against an alternative."""
    from vmf.bench import Effort, as_text, run, to_json, writable, write

    writable(out)
    with _progress(quiet) as progress:
        report = run(names or (), Effort(quick), progress.report)
    typer.echo(to_json(report) if as_json else as_text(report))
    path = write(report, out)
    if not quiet:
        typer.echo(f"note: {path}", err=True)


def _experiment(
    command: str,
    spec: Path,
    overrides: list[str] | None,
    out: Path,
    jobs: int,
    resume: bool,
    as_json: bool,
    quiet: bool,
) -> None:
    import os

    from vmf.experiment import RunOptions, run_experiment
    from vmf.spec import load

    options = RunOptions(out, jobs or os.cpu_count() or 1, resume)
    loaded = load(spec, overrides or ())
    with _progress(quiet) as progress:
        result = run_experiment(loaded, command, options, progress.report)
    _print_result(result, as_json, quiet)


class _progress:  # noqa: N801
    """A progress bar with rate and time left on a terminal, plain lines elsewhere, nothing if quiet."""

    def __init__(
        self, quiet: bool, interrupted: str = "finished trials are on disk, --resume goes on from there"
    ) -> None:
        self._quiet, self._interrupted = quiet, interrupted

    def __enter__(self) -> Reporter:
        from vmf.progress import reporter

        self._reporter = reporter(self._quiet)
        return self._reporter

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._reporter.stop()
        if kind is not None and issubclass(kind, KeyboardInterrupt):
            # Typer would make this exit code 1, the code of a bug.
            typer.echo(f"interrupted; {self._interrupted}", err=True)
            raise typer.Exit(130)


def _print_result(result: RunResult, as_json: bool, quiet: bool) -> None:
    from vmf.result_table import as_text, to_json

    if as_json:
        typer.echo(to_json(result))
    else:
        typer.echo(as_text(result))
    if not quiet:
        for note in result.notes:
            typer.echo(f"note: {note}", err=True)
    _end(result.losses)


def _end(losses: tuple[Loss, ...]) -> None:
    for loss in losses:
        typer.echo(f"lost: {loss}", err=True)
    if losses:
        raise typer.Exit(3)


def main() -> None:
    """Run the program; known errors become one line each and exit code 2."""
    try:
        app()
    except InputError as error:
        _complain(error.lines, 2)
    except UnfinishedError as error:
        _complain(error.lines, 3)
    except BrokenPipeError:
        sys.exit(0)


def _complain(lines: tuple[str, ...], code: int) -> NoReturn:
    for line in lines:
        print(line, file=sys.stderr)
    sys.exit(code)
