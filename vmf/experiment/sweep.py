"""`vmf sweep`: many points of one experiment, their trials in one pool."""

from __future__ import annotations

import fcntl
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from vmf.errors import InputError
from vmf.experiment.check import check
from vmf.experiment.parallel import Crew, Failure, T, W, Why, attempt, crew
from vmf.experiment.point import Closed, ClosingWork, OpenPoint, Point
from vmf.experiment.program import program
from vmf.experiment.run import Progress, runnable_anywhere
from vmf.experiment.run_directory import sha256
from vmf.experiment.study_sweep import StudyPoint, StudyWorkers, carry_out_points
from vmf.experiment.work import TrialResult, TrialWork
from vmf.spec import Variant, is_study, load_all, load_studies, spec_hash, variants

# say(line): something to be heard at once.
Say = Callable[[str], None]
# Losses are told in words until there are too many of them.
_MOST_LOSSES = 10
Workers = Crew[TrialWork | ClosingWork, TrialResult | Closed]


@dataclass(frozen=True)
class SweepOptions:
    """Where a sweep goes and who works it off; nothing here changes a number.

    Attributes
    ----------
    out : the directory that the sweep's own directory goes to.
    jobs : processes of this machine.
    scheduler : address of a Dask scheduler whose workers do the trials instead.
    plots, pdf : whether every point that is worked off gets its figures, and as PDF beside PNG.
    """

    out: Path = Path("runs")
    jobs: int = 1
    scheduler: str | None = None
    plots: bool = False
    pdf: bool = True


@dataclass(frozen=True)
class PointResult:
    """What became of a point: its results, or why there are none; `kept` if an earlier call did it."""

    point: Point | StudyPoint
    result: Closed | Failure
    kept: bool = False

    @property
    def failure(self) -> Failure | None:
        """Why there are no results."""
        return self.result if isinstance(self.result, Failure) else None

    @property
    def losses(self) -> tuple[str, ...]:
        """What was lost on the way to the results."""
        return () if isinstance(self.result, Failure) else self.result.losses


@dataclass(frozen=True)
class SweepResult:
    """What the command prints.

    Attributes
    ----------
    directory : of the sweep, one run directory per point below it.
    points : all points, in the order of the grid.
    notes : what is worth knowing about them.
    """

    directory: Path
    points: tuple[PointResult, ...]
    notes: tuple[str, ...]

    @property
    def failed(self) -> tuple[PointResult, ...]:
        """The points without results."""
        return tuple(point for point in self.points if point.failure is not None)

    @property
    def losses(self) -> tuple[str, ...]:
        """What was lost at which points, the same words once."""
        counted = Counter(loss for point in self.points for loss in dict.fromkeys(point.losses))
        said = [loss if n == 1 else f"{loss} at {n} points each" for loss, n in counted.items()]
        more = len(said) - _MOST_LOSSES
        return (*said[:_MOST_LOSSES], *([f"and {more} more, see run.json of each point"] if more > 0 else []))

    @property
    def all_wrong(self) -> bool:
        """Whether every point's input is wrong."""
        return all(p.failure is not None and p.failure.why is Why.INPUT for p in self.points)


def sweep(
    spec: Path,
    texts: Sequence[str],
    grid: Path | None,
    command: str,
    options: SweepOptions,
    progress: Progress | None = None,
    say: Say | None = None,
) -> SweepResult:
    """Work off every point of a grid that is not done yet.

    The trials of all points share the workers, so that none is idle at the end of a point. A point that
    fails is said at once and the others go on; the next call of the same sweep tries it again.

    Parameters
    ----------
    spec : the file that all points have in common.
    texts : `key=a,b,c` settings, of which the product is taken.
    grid : a file with more of them; see `vmf.spec.variants`.
    command : `train` or `compare-3d`.
    options : where to, and who works.
    progress, say : how far it is, and lines to be heard at once.

    Raises
    ------
    InputError : a point's spec is wrong (before any work), or the directory or the scheduler is of no use.
    UnfinishedError : the scheduler went away.
    """
    given = variants(texts, grid)
    if is_study(spec):
        return _sweep_study(spec, given, command, options, progress, say)
    directory, points = _points(spec, given, command, options.out)
    with _alone_in(directory):
        work = _Sweep(points, options, progress, say or (lambda line: None))
        if work.trials:
            workers: Workers = _workers(options, work.trials)
            with workers:
                work.run(workers)
    notes = _notes(len(given) - len(points), work.results.values())
    kept = [one.point.path for one in work.results.values() if one.kept]
    bare = sum(not (path / "plots").is_dir() for path in kept) if options.plots else 0
    if bare:
        notes += (f"figures of {bare} points that were done before are not drawn: their trials are gone",)
    return SweepResult(directory, tuple(work.results[point.path] for point in points), notes)


def _points(spec: Path, given: Sequence[Variant], command: str, out: Path) -> tuple[Path, list[Point]]:
    """Return the sweep's directory, and its points, each once."""
    loaded = load_all(spec, [variant.overrides for variant in given])
    name = _name([one.spec.name for one in loaded]) or spec.stem
    wrong: dict[str, None] = {}
    for one in loaded:
        try:
            check(one.spec, None)
        except InputError as error:
            wrong |= dict.fromkeys(error.lines)
    if wrong:
        raise InputError(*wrong)
    directory = out / f"{name}-{'' if command == 'train' else command + '-'}sweep"
    points: dict[Path, Point] = {}
    for variant, one in zip(given, loaded, strict=True):
        runnable = runnable_anywhere(one)
        path = directory / spec_hash(runnable)
        points.setdefault(path, Point(path, runnable, one.overrides, variant.settings, command))
    return directory, list(points.values())


def _name(given: list[str | None]) -> str | None:
    names = list(dict.fromkeys(given))
    if len(names) > 1:
        shown = " and ".join(map(repr, names[:2]))
        raise InputError(f"name: found {shown}, a sweep has one directory: one name is accepted")
    return names[0]


def _sweep_study(
    spec: Path,
    given: Sequence[Variant],
    command: str,
    options: SweepOptions,
    progress: Progress | None,
    say: Say | None,
) -> SweepResult:
    """Carry out every point of a study that is not done yet; studies draw their figures always."""
    if command != "train":
        raise InputError(f"--command: found {command}, a study is carried out as it is: none is accepted")
    loaded = load_studies(spec, [variant.overrides for variant in given])
    directory = options.out / f"{_name([one.spec.name for one in loaded]) or spec.stem}-sweep"
    points: dict[Path, StudyPoint] = {}
    for variant, one in zip(given, loaded, strict=True):
        path = directory / spec_hash(one.spec)
        points.setdefault(path, StudyPoint(path, one.spec, one.overrides, variant.settings))
    with _alone_in(directory):
        closed = {path: point.closed() for path, point in points.items()}
        results = {
            path: PointResult(points[path], done, kept=True)
            for path, done in closed.items()
            if done is not None
        }
        todo = [point for path, point in points.items() if closed[path] is None]
        if todo:
            workers: StudyWorkers = _workers(options, len(todo))
            with workers:
                for point, result in carry_out_points(todo, workers, options.pdf):
                    results[point.path] = PointResult(point, result)
                    if isinstance(result, Failure) and say is not None:
                        say(f"failed: {point}: {result}")
                    if progress is not None:
                        progress(len(results), len(points), "studies")
    notes = _notes(len(given) - len(points), results.values())
    return SweepResult(directory, tuple(results[path] for path in points), notes)


@contextmanager
def _alone_in(directory: Path) -> Iterator[None]:
    """Hold the directory against a second sweep; the kernel lets go of it however this process ends."""
    try:
        directory.mkdir(parents=True, exist_ok=True)
        stream = (directory / ".lock").open("w")
    except OSError as error:
        raise InputError(f"--out: {error.filename or directory}: {error.strerror}") from error
    with stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise InputError(f"{directory}: another sweep is at work here, one is accepted") from error
        yield


def _workers(options: SweepOptions, pieces: int) -> Crew[W, T]:
    if options.scheduler is None:
        return crew(options.jobs, pieces)
    try:
        from vmf.experiment.cluster import Cluster
    except ModuleNotFoundError as error:
        raise InputError(
            f"--scheduler: the package {error.name} is not installed, pip install 'vmf[cluster]' brings it"
        ) from error
    return Cluster[W, T](options.scheduler)


class _Sweep:
    """The points that are not done yet, on their way through the workers."""

    def __init__(
        self, points: Sequence[Point], options: SweepOptions, progress: Progress | None, say: Say
    ) -> None:
        self.results: dict[Path, PointResult] = {}
        self._figures, self._progress, self._say = (options.plots, options.pdf), progress, say
        self._todo: list[tuple[Point, Mapping[str, str]]] = []
        self._open: dict[Path, OpenPoint] = {}
        self._closing: deque[ClosingWork] = deque()
        checksums: dict[str, Mapping[str, str] | Failure] = {}
        for point in points:
            inputs = _inputs(point, checksums)
            if isinstance(inputs, Failure):
                self._failed(point, inputs)
            elif (closed := point.closed(inputs)) is not None:
                with suppress(OSError):
                    point.remove_trials()
                self.results[point.path] = PointResult(point, closed, kept=True)
            else:
                self._todo.append((point, inputs))
        self.trials = sum(point.spec.evaluate.trials for point, _ in self._todo)
        self._done = 0

    def run(self, workers: Workers) -> None:
        """Work until every point has its result."""
        trials = self._trials()
        try:
            while True:
                while workers.room and (work := self._next(trials)) is not None:
                    if isinstance(work, ClosingWork) and not workers.shares_disk:
                        self._take(work, attempt(work))
                    else:
                        workers.submit(work)
                if not workers.busy:
                    return
                for done, result in workers.wait():
                    self._take(done, result)
        except BaseException:
            for opened in self._open.values():
                if opened.failure is None:
                    opened.interrupt()
            raise

    def _trials(self) -> Iterator[TrialWork]:
        for point, inputs in self._todo:
            opened = self._open[point.path] = OpenPoint(point, inputs)
            try:
                opened.make_ready()
            except (OSError, InputError) as error:
                self._fail(opened, _of_disk(error))
                self._advance(point.spec.evaluate.trials)
                continue
            missing = tuple(opened.missing)
            self._advance(point.spec.evaluate.trials - len(missing))
            if not missing:
                self._closing.append(opened.closing(*self._figures))
            for number in missing:
                if opened.failure is None:
                    yield opened.trial(number)

    def _next(self, trials: Iterator[TrialWork]) -> TrialWork | ClosingWork | None:
        if not self._closing and (trial := next(trials, None)) is not None:
            return trial
        return self._closing.popleft() if self._closing else None

    def _take(self, work: TrialWork | ClosingWork, result: TrialResult | Closed | Failure) -> None:
        path = work.point.path if isinstance(work, ClosingWork) else work.directory
        assert path is not None
        opened = self._open[path]
        if isinstance(result, Failure):
            if opened.failure is None:
                self._fail(opened, result)
                self._advance(len(opened.missing))
        elif isinstance(result, Closed):
            with suppress(OSError):
                opened.point.remove_trials()
            del self._open[path]
            self.results[path] = PointResult(opened.point, result)
        elif isinstance(work, TrialWork):
            # Of a point that has failed meanwhile, too: the next call will have it.
            try:
                opened.keep(work.number, result)
            except OSError as error:
                if opened.failure is None:
                    self._fail(opened, _of_disk(error))
                    self._advance(len(opened.missing))
            if opened.failure is None:
                self._advance(1)
                if not opened.missing:
                    self._closing.append(opened.closing(*self._figures))

    def _advance(self, trials: int) -> None:
        self._done += trials
        if self._progress is not None:
            self._progress(self._done, self.trials, "trials")

    def _fail(self, opened: OpenPoint, failure: Failure) -> None:
        opened.fail(failure)
        self._failed(opened.point, failure)

    def _failed(self, point: Point, failure: Failure) -> None:
        self.results[point.path] = PointResult(point, failure)
        self._say(f"failed: {point}: {failure}")


def _of_disk(error: OSError | InputError) -> Failure:
    if isinstance(error, InputError):
        return Failure(Why.INPUT, error.lines)
    return Failure(Why.INPUT, (f"{error.filename or 'its directory'}: {error.strerror}",))


def _inputs(point: Point, known: dict[str, Mapping[str, str] | Failure]) -> Mapping[str, str] | Failure:
    """Return the SHA-256 of the point's recording by its path, each file being read once."""
    source = point.spec.data.recording
    if source is None:
        return {}
    if source.path not in known:
        try:
            known[source.path] = {source.path: sha256(Path(source.path))}
        except OSError as error:
            line = f"data.recording.path: {source.path}: {error.strerror}, a recording (MCAP) is accepted"
            known[source.path] = Failure(Why.INPUT, (line,))
    return known[source.path]


def _notes(again: int, results: Iterable[PointResult]) -> tuple[str, ...]:
    """Return what is worth knowing of how the points came about."""
    notes = []
    if again:
        notes.append(f"{again} points say the same as another one, and are one with it")
    mine = str(program())
    made_by = Counter(r.result.program for r in results if isinstance(r.result, Closed))
    for other, count in made_by.items():
        if other != mine:
            notes.append(
                f"{count} points kept from vmf {other}, this is vmf {mine}; remove them to redo them"
            )
    return tuple(notes)
