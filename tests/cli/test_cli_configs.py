"""Every file in `configs/` runs in miniature, and leaves a complete run directory behind."""

from __future__ import annotations

import hashlib
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml
from mcap_edits import copy
from vmf_command import (
    COLUMNS,
    CONFIGS,
    FEW,
    MINI,
    NO_SWEEP,
    SMALL_FILM,
    SUMMARY,
    errors,
    record,
    same_results,
    summary,
    train,
    vmf,
)

from vmf.data.recording import RecordingData, read
from vmf.reconstruct import label
from vmf.spec import is_study, load, load_study

RECORD = {"status", "command", "started", "finished", "spec", "overrides", "seeds", "inputs", "version"}
RECORD |= {"git_commit", "git_dirty", "packages", "wall_s", "cpu_s", "peak_memory_mib"}
PATHS = sorted(path for path in CONFIGS.rglob("*.yaml") if path.parent.name != "unknowns")
NAMES = [str(path.relative_to(CONFIGS)) for path in PATHS if not is_study(path)]
STUDIES = [str(path.relative_to(CONFIGS)) for path in PATHS if is_study(path)]
# What makes a study of each kind small.
MINI_STUDY: dict[str, tuple[str, ...]] = {
    "stereo_codes": ("study.pixels=2",),
    "approximators": (
        "study.approximators=[{kind: cmac}, {kind: polynomial}]",
        "study.codes=[20, 60]",
        "study.tests=10",
        "study.timed=20",
        "study.repeats=1",
    ),
    "feedback": (
        "study.starts=2",
        "study.duration_s=0.5",
        "study.sources=[analytic, transport]",
        "study.training={frames: 40, targets: 6}",
    ),
    "joint_space": ("study.frames=[60, 120]", "study.targets=4", "study.questions=4", "study.wrong=[]"),
    "kaczmarz": (
        "study.points=12",
        "study.epochs=3",
        "study.orders=2",
        "study.rank_overlays=[2]",
        "study.lattices=[{dimensions: 1, span_px: 8, codes: 20}]",
    ),
    "cmac_parameters": ("study.points=60", "study.tests=10", "study.parameters=[3]", "study.grid=5"),
    "planar_sift": ("study.frames=12", "study.posters=8", "study.runs=1", "study.looks=2"),
}
LOST = "data.simulate.lost=[{target: 1, camera: left, from_frame: 12, frames: 4, shows: edge}]"
# Columns of `quantities.csv`, and the start of the names of those that measure time.
QUANTITIES = ["quantity", "case", "component", "unit", "value", "n", "ci_low", "ci_high"]
TIMES = "time_"
# These show what others show already, or show it slowly.
LONGER = ("accuracy/", "real/")
# What can be done with these is what can be done with their siblings, which differ in what is simulated.
ALIKE = tuple(
    f"thesis/{name}.yaml"
    for name in (
        "pan_tilt_disturbed",
        "translation_disturbed",
        "translation_arm",
        "six_dof_hand_guided",
        "noise_isolated",
        "multires",
    )
)
# What these are for is the comparison.
COMPARED = ("thesis/translation_3d.yaml", "thesis/six_dof_3d.yaml")
# Rendering takes its time.
FILMED = ("thesis/pan_tilt_hand_guided.yaml",)
# The whole of KITTI's drive takes a minute; the first seconds of it take one.
MOST_BYTES = 1_000_000


@dataclass(frozen=True)
class Finished:
    """A config's miniature run, figures included."""

    name: str
    run: Path
    code: int
    overrides: tuple[str, ...]
    out: Path


def miniature(config: Path, folder: Path) -> tuple[str, ...]:
    """Overrides that make a config small; skips where its recording is absent."""
    spec = load(config).spec
    recording, source = spec.data.recording, spec.data.simulate
    if source is not None:
        more = []
        if source.motion == "hand_guided":
            # As much motion in fewer frames; a tracker loses what jumps.
            more.append("data.simulate.rate_hz=2" if source.tracker is None else "data.simulate.rate_hz=6")
        if source.lost:
            more.append(LOST)
        if spec.evaluate.beyond:
            more.append("evaluate.beyond=[10]")
        return (*MINI, *more)
    assert recording is not None
    if config.name == "matched.yaml":
        return (*FEW, NO_SWEEP, *tracked(folder))
    path = (config.parent / recording.path).resolve()
    if not path.exists():
        pytest.skip(f"no recording at {path}")
    if path.stat().st_size < MOST_BYTES:
        return (*FEW, NO_SWEEP)
    cut = copy(path, folder / path.name, last_s=6.0)
    return (*FEW, NO_SWEEP, f"data.recording.path={cut}")


def tracked(folder: Path) -> tuple[str, ...]:
    """Overrides that have a config learn from the tracks of a film."""
    film, tracks = folder / "film.mcap", folder / "tracks.mcap"
    said = vmf("simulate", CONFIGS / "quickstart.yaml", "--images", "-o", film, *SMALL_FILM, "--quiet")
    assert said.code == 0, said
    sift = ("--tracker", "sift", "features=120", "void_after_m=3")
    assert vmf("track", film, "-o", tracks, *sift, "--quiet").code == 0
    no_images = ("data.recording.images=null", "data.recording.tracks.topic=/stereo/tracks")
    return (f"data.recording.path={tracks}", *no_images, "evaluate.gaps=[1, 2]")


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.long if n.startswith(LONGER) else ()) for n in NAMES]
)
def test_every_config_does_all_it_should_in_miniature(name: str, tmp_path: Path) -> None:
    config = CONFIGS / name
    overrides = miniature(config, tmp_path)
    said = vmf("train", config, *overrides, "--out", tmp_path, "--jobs", 1, "--json", plots=True)
    assert said.code in (0, 3), said.err
    finished = Finished(name, said.run, said.code, overrides, tmp_path)
    check_directory(finished)
    check_record(finished)
    check_tables(finished)
    if name not in (*ALIKE, *COMPARED):
        check_again(finished)
    if name not in (*ALIKE, *COMPARED, *FILMED):
        check_evaluation(finished)
    if name not in (*ALIKE, *FILMED):
        check_comparison(finished)


@pytest.mark.parametrize("name", STUDIES)
def test_every_study_does_all_it_should_in_miniature(name: str, tmp_path: Path) -> None:
    config = CONFIGS / name
    overrides = MINI_STUDY[load_study(config).spec.study.kind]
    said = vmf("study", config, *overrides, "--out", tmp_path, "--json", "--quiet", plots=True)
    found = record(said.run)
    # So little may teach a function nothing, which then is said.
    assert said.code == (3 if found["losses"] else 0), said
    assert said.err.count("lost: ") == len(found["losses"])
    assert found.keys() >= RECORD
    assert (found["status"], found["command"], found["overrides"]) == ("done", "study", list(overrides))
    drawn = {path.name for path in (said.run / "plots").iterdir()}
    stems = {name.removesuffix(".png") for name in drawn if name.endswith(".png")}
    assert stems
    assert drawn == {f"{stem}.{kind}" for stem in stems for kind in ("png", "pdf")}
    table = pd.read_csv(said.run / "quantities.csv")
    assert list(table) == QUANTITIES
    assert table["value"].notna().all()
    assert not table.duplicated(["quantity", "case", "component"]).any()
    again = vmf("study", said.run / "spec.yaml", "--out", tmp_path / "again", "--json", "--quiet", plots=True)
    same_study(said.run, again.run)


def same_study(a: Path, b: Path) -> None:
    """All but times is the same byte for byte, figures of times included in what is not."""
    names = sorted(str(path.relative_to(a)) for path in a.rglob("*.*") if path.name != "run.json")
    assert names == sorted(str(path.relative_to(b)) for path in b.rglob("*.*") if path.name != "run.json")
    for name in names:
        one, other = (a / name).read_bytes(), (b / name).read_bytes()
        if name == "quantities.csv":
            one, other = (
                b"\n".join(r for r in t.split(b"\n") if not r.startswith(TIMES.encode()))
                for t in (one, other)
            )
        assert one == other or Path(name).stem.startswith(TIMES), name


def check_directory(finished: Finished) -> None:
    """Everything is there, nothing else, and `latest` leads to it."""
    run = finished.run
    names = {path.name for path in run.iterdir()}
    # Pairs are compared with other functions, too.
    assert ("paired.csv" in names) == bool(load(CONFIGS / finished.name).spec.also)
    # Only there if an answer went without a target, and if a tile has equations.
    assert names - {"rejected.csv", "paired.csv", "condition.csv"} == {
        "run.json",
        "spec.yaml",
        "model.npz",
        "errors.parquet",
        "summary.csv",
        "plots",
    }
    drawn = {path.name for path in (run / "plots").iterdir()}
    stems = {name.removesuffix(".png") for name in drawn if name.endswith(".png")}
    assert stems >= {"comparison_held_out", "update_map"}
    assert drawn == {f"{stem}.{kind}" for stem in stems for kind in ("png", "pdf")}
    for path in (run / "plots").iterdir():
        assert path.read_bytes()[:4] == (b"\x89PNG" if path.suffix == ".png" else b"%PDF")
    assert run.parent == finished.out / Path(finished.name).stem
    assert re.fullmatch(r"[0-9a-f]{10}-\d{8}T\d{6}\.\d+Z", run.name)
    latest = run.parent / "latest"
    assert latest.is_symlink()
    assert latest.resolve() == run.resolve()


def check_record(finished: Finished) -> None:
    """`run.json` says what ran and on what."""
    said = record(finished.run)
    assert said.keys() >= RECORD
    assert said["status"] == "done"
    assert said["command"] == "train"
    assert said["overrides"] == list(finished.overrides)
    assert said["spec"] == yaml.safe_load((finished.run / "spec.yaml").read_text())
    assert said["packages"].keys() >= {"numpy", "scipy", "pandas", "pydantic"}
    assert said["wall_s"] > 0
    assert said["peak_memory_mib"] > 1
    assert (finished.code == 3) == bool(said["losses"])
    recording = load(CONFIGS / finished.name, finished.overrides).spec.data.recording
    if recording is None:
        assert said["seeds"]["simulate"] == 1
        return
    path = (CONFIGS / finished.name).parent / recording.path
    assert said["inputs"] == {str(path.resolve()): hashlib.sha256(path.read_bytes()).hexdigest()}


def check_tables(finished: Finished) -> None:
    """Tables have exactly the columns of the contract."""
    table, counted = errors(finished.run), summary(finished.run)
    assert list(table) == COLUMNS
    assert list(counted) == SUMMARY
    task = load(CONFIGS / finished.name).spec.task
    own = {
        "pan_tilt": ["pan", "tilt"],
        "translation": ["t_x", "t_y", "t_z"],
        "planar": ["heading", "t_x", "t_y"],
        "six_dof": ["rot_x", "rot_y", "rot_z", "t_x", "t_y", "t_z"],
    }[task]
    assert set(table["component"]) == {*own, "angle", "distance"}
    assert set(table["status"]) <= {"ok", "refused", "diverged"}
    assert set(table["method"]) == answering(finished)
    assert set(table["unit"]) == {"rad", "m"}
    answered = table["status"] == "ok"
    for column in ("estimate", "abs_error"):
        assert (table[column].notna() == answered).all()
    assert table["truth"].notna().all()
    assert (table.loc[answered, "abs_error"] >= 0).all()
    assert (counted["ci_low"].dropna() <= counted["ci_high"].dropna()).all()


def answering(finished: Finished) -> set[str]:
    """Who answers a trained run's questions; there is a bound where the truth is known."""
    simulated = load(CONFIGS / finished.name).spec.data.simulate is not None
    others = {f"vmf[{other.name}]" for other in load(CONFIGS / finished.name).spec.also}
    drifts = {"odometry"} if load(CONFIGS / finished.name).spec.noise.drifts else set()
    return {"vmf", "no_motion"} | others | drifts | ({"cramer_rao"} if simulated else set())


def check_again(finished: Finished) -> None:
    """`spec.yaml` runs, and gives the same bytes."""
    again = train(finished.run / "spec.yaml", finished.out / "again", code=finished.code)
    assert same_results(finished.run, again)
    assert (again / "spec.yaml").read_bytes() == (finished.run / "spec.yaml").read_bytes()
    assert (again / "model.npz").read_bytes() == (finished.run / "model.npz").read_bytes()


def check_evaluation(finished: Finished) -> None:
    """The model can be evaluated."""
    said = vmf("evaluate", finished.run, "--json", "--quiet", *FEW)
    assert said.code in (0, 3), said.err
    assert said.run.parent == finished.run.resolve() / "evaluations"
    assert list(errors(said.run)) == COLUMNS
    assert {"vmf", "no_motion"} <= set(errors(said.run)["method"])
    assert record(said.run)["command"] == "evaluate"
    inputs = record(said.run)["inputs"]
    model = finished.run / "model.npz"
    assert inputs[str(model)] == hashlib.sha256(model.read_bytes()).hexdigest()


def check_comparison(finished: Finished) -> None:
    """The rivals answer the same questions where the cameras are known."""
    run = train(
        CONFIGS / finished.name, finished.out, *finished.overrides, command="compare-3d", code=finished.code
    )
    spec = load(CONFIGS / finished.name).spec
    source = spec.data.recording
    calibrated = source is None or source.calibration is not None
    rivals = {label(r.method, r.error) for r in spec.rivals} if calibrated else set()
    table = errors(run)
    assert set(table["method"]) == answering(finished) | rivals
    assert (run / "paired.csv").exists() == bool(rivals)
    assert (run / "points.csv").exists() == (source is None)
    trained = errors(finished.run)
    mine = table[table["method"].isin(answering(finished))].reset_index(drop=True)
    assert mine.equals(trained)


def test_recorded_motions_of_a_cut_recording_are_those_of_the_whole(
    tmp_path: Path, shared_data: Path
) -> None:
    """The copies these tests make say what the original says."""
    spec = load(CONFIGS / "real/starry_night.yaml").spec
    source = spec.data.recording
    assert source is not None

    def at(path: Path) -> RecordingData:
        return read(source.model_copy(update={"path": str(path)}), spec.mounting, tmp_path)

    whole = at(shared_data / "starry_night.mcap")
    part = at(copy(shared_data / "starry_night.mcap", tmp_path / "part.mcap", last_s=10.0))
    n = part.tracks.n_frames
    assert 50 < n < whole.tracks.n_frames
    np.testing.assert_array_equal(part.tracks.E_S_from_W, whole.tracks.E_S_from_W[:n])
