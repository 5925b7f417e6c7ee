"""`vmf evaluate`: what a trained model may be asked, and models that are no good."""

from __future__ import annotations

import io
import pickle
import shutil
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from vmf_command import COLUMNS, CONFIGS, QUICK, SUMMARY, errors, record, summary, train, vmf

QUICKSTART = CONFIGS / "quickstart.yaml"
FRAMES = 30


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return train(QUICKSTART, tmp_path_factory.mktemp("runs"), *QUICK)


@pytest.fixture
def run(trained: Path, tmp_path: Path) -> Path:
    """A copy of the trained run that a test may damage."""
    return Path(shutil.copytree(trained, tmp_path / "run", ignore=shutil.ignore_patterns("evaluations")))


def test_a_run_is_evaluated_in_place_or_by_its_latest_link(trained: Path) -> None:
    direct = vmf("evaluate", trained, "--json", "--quiet")
    linked = vmf("evaluate", trained.parent / "latest", "--json", "--quiet")
    assert (direct.code, linked.code) == (0, 0)
    assert direct.run.parent == linked.run.parent == trained.resolve() / "evaluations"
    assert (direct.run / "errors.parquet").read_bytes() == (linked.run / "errors.parquet").read_bytes()
    assert (trained / "evaluations" / "latest").resolve() == linked.run.resolve()
    assert list(errors(direct.run)) == COLUMNS
    assert list(summary(direct.run)) == SUMMARY
    assert record(direct.run)["status"] == "done"


def test_the_held_out_questions_of_trial_0_get_the_answers_they_got_in_training(trained: Path) -> None:
    """The model is that of trial 0, and its draws depend on the seed alone."""
    run = vmf("evaluate", trained, "--json", "--quiet").run
    of_training = errors(trained).query("protocol == 'held_out' and method == 'vmf' and trial == 0")
    now = errors(run).query("protocol == 'held_out' and method == 'vmf'")
    assert len(now) == 4 * 5
    assert now.reset_index(drop=True).equals(of_training.reset_index(drop=True))


def test_what_is_asked_may_change_and_the_run_says_so(trained: Path) -> None:
    overrides = [
        "evaluate.queries=7",
        "solver.cameras=left",
        "noise.pixel_px=0.5",
        "evaluate.protocol=[held_out]",
    ]
    run = vmf("evaluate", trained, *overrides, "rivals=[]", "--json", "--quiet").run
    table = errors(run)
    assert set(table["protocol"]) == {"held_out"}
    assert set(table["method"]) == {"vmf", "cramer_rao", "no_motion"}
    assert len(table) == 7 * 3 * 5
    assert record(run)["overrides"] == [*overrides, "rivals=[]"]
    assert record(run)["spec"]["noise"]["pixel_px"] == 0.5
    assert record(run)["spec"]["data"] == record(trained)["spec"]["data"]


def test_a_target_that_moved_after_training_disturbs_its_trained_code(trained: Path) -> None:
    def distance(*more: str) -> float:
        run = vmf("evaluate", trained, "evaluate.protocol=[trained_code]", *more, "--json", "--quiet").run
        rows = errors(run).query("method == 'vmf' and component == 'distance'")
        return float(rows["abs_error"].mean())

    assert distance("noise.point_m=0.3") > 1.5 * distance()


@pytest.mark.parametrize(
    "override",
    [
        "learner.kind=pipeline",
        "approximator.kind=cmac",
        "task=planar",
        "mounting=eye_to_hand",
        "lift=thesis",
        "data.simulate.seed=2",
        "data={recording: {path: x}}",
    ],
)
def test_what_a_trained_model_is_cannot_change(trained: Path, override: str) -> None:
    line = vmf("evaluate", trained, override).refused("a trained model cannot change this", "solver.…")
    assert line.startswith(f"command line: {override}: ")


def test_a_wrong_override_is_refused_like_that_of_a_spec(trained: Path) -> None:
    line = vmf("evaluate", trained, "evaluate.querys=3").refused("did you mean queries?")
    assert line.startswith("command line: evaluate.querys=3: ")
    assert vmf("evaluate", trained, "nonsense").refused().startswith("command line: nonsense: ")


def test_an_override_without_meaning_for_the_task_is_refused(trained: Path) -> None:
    vmf("evaluate", trained, "solver.known=rotation").refused("solver.known: rotation has no meaning for")


def test_another_recording_of_the_same_rig_is_asked_about_as_a_whole(trained: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.mcap"
    said = vmf("simulate", QUICKSTART, "-o", other, "data.simulate.seed=9", "data.simulate.frames=25")
    assert said.code == 0
    run = vmf("evaluate", trained, "--data", other, "evaluate.gaps=[5, 20]", "--json", "--quiet").run
    table = errors(run)
    assert set(table["protocol"]) == {"held_out"}
    counted = summary(run).query("method == 'vmf' and component == 'angle'").set_index("case")
    asked = counted[["n", "n_refused", "n_diverged"]].sum(axis=1)
    assert asked.to_dict() == {"gap=5": 25 - 5, "gap=20": 25 - 20}
    assert str(other) in record(run)["inputs"]
    # The same file by a relative name from elsewhere is the same question.
    vmf("evaluate", trained, "--data", tmp_path / "none.mcap").refused(
        f"{tmp_path / 'none.mcap'}: no such file"
    )


def test_what_is_no_run_is_refused(tmp_path: Path, trained: Path) -> None:
    vmf("evaluate", tmp_path / "none").refused(str(tmp_path / "none"), "no run.json here")
    vmf("evaluate", tmp_path).refused(str(tmp_path), "no run.json here")
    vmf("evaluate", trained / "spec.yaml").refused("spec.yaml", "no run.json here")
    (tmp_path / "run.json").write_text("{broken")
    vmf("evaluate", tmp_path).refused(str(tmp_path / "run.json"), "not JSON")
    (tmp_path / "run.json").write_text("[]")
    vmf("evaluate", tmp_path).refused(str(tmp_path / "run.json"), "not the record of a run")


def arrays_of(run: Path) -> dict[str, Any]:
    with np.load(run / "model.npz") as archive:
        return dict(archive)


def with_arrays(run: Path, **changed: Any) -> Path:
    """Write the model again, some of its arrays changed and those set to None left out."""
    arrays = {k: v for k, v in {**arrays_of(run), **changed}.items() if v is not None}
    np.savez_compressed(run / "model.npz", allow_pickle=True, **arrays)
    return run


def with_bytes(run: Path, data: bytes) -> Path:
    (run / "model.npz").write_bytes(data)
    return run


def refused_model(run: Path, *parts: str) -> None:
    """`evaluate` and `info` refuse the model, and nothing is evaluated."""
    for command in ("evaluate", "info"):
        path = run if command == "evaluate" else run / "model.npz"
        vmf(command, path).refused(str(run / "model.npz"), *parts)
    assert not (run / "evaluations").exists()


def test_a_missing_model_is_refused(run: Path) -> None:
    (run / "model.npz").unlink()
    vmf("evaluate", run).refused(f"{run / 'model.npz'}: no such file", "vmf train")


def test_a_truncated_model_is_refused(run: Path) -> None:
    data = (run / "model.npz").read_bytes()
    for size in (0, 3, 100, len(data) // 2, len(data) - 1):
        refused_model(with_bytes(run, data[:size]), "not a readable model.npz")


@pytest.mark.parametrize(
    "data",
    [b"hello", pickle.dumps({"vmf.format": 1}), b"\x93NUMPY"],
    ids=["text", "pickle", "header"],
)
def test_a_model_that_is_something_else_is_refused(run: Path, data: bytes) -> None:
    refused_model(with_bytes(run, data), "not a readable model.npz")


def test_a_single_array_is_no_model(run: Path) -> None:
    buffer = io.BytesIO()
    np.save(buffer, np.arange(3))
    refused_model(with_bytes(run, buffer.getvalue()), "model.npz")


def test_a_pickled_object_is_never_loaded(run: Path) -> None:
    class Trap:
        def __reduce__(self) -> tuple[Any, ...]:
            return Path.touch, (run / "sprung",)

    refused_model(
        with_arrays(run, **{"tracks.pixels": np.array([Trap(), 1], dtype=object)}), "Python objects"
    )
    assert not (run / "sprung").exists()


@pytest.mark.parametrize("version", [0, 1, 3, -1, 2.0, "2", [2]])
def test_an_unknown_version_is_refused(run: Path, version: object) -> None:
    refused_model(with_arrays(run, **{"vmf.format": np.array(version)}), "format version", "2 is accepted")


def test_an_archive_of_other_arrays_is_refused(run: Path) -> None:
    refused_model(with_arrays(run, **{"vmf.format": None}), "not one written by `vmf train`")
    with zipfile.ZipFile(run / "model.npz", "w") as archive:
        archive.writestr("a.txt", "hello")
    refused_model(run, "not")


def test_a_model_with_another_spec_is_refused(run: Path) -> None:
    refused_model(
        with_arrays(run, **{"vmf.spec": np.array("task: cooking\ndata: {simulate: {}}")}), "cooking"
    )


@pytest.mark.parametrize(
    "name",
    [
        "tracks.times_ns",
        "tracks.E_S_from_W",
        "tracks.target",
        "tracks.pixels",
        "tracks.ids",
        "approximator.R",
        "noise_px",
    ],
)
def test_a_model_with_an_array_missing_is_refused(run: Path, name: str) -> None:
    refused_model(with_arrays(run, **{name: None}), "arrays do not fit", name.split(".")[-1])


SHAPES = {
    "approximator.R": ((14, 15), "float64"),
    "approximator.z": ((15, 23), "float64"),
    "tracks.times_ns": ((FRAMES - 1,), "int64"),
    "tracks.E_S_from_W": ((FRAMES, 3, 4), "float64"),
    "tracks.frame": ((119,), "int64"),
    "tracks.target": ((120, 1), "int64"),
    "tracks.pixels": ((120, 3), "float64"),
    "tracks.image_size": ((3,), "int64"),
}


def test_a_model_with_a_list_for_a_number_is_refused(run: Path) -> None:
    refused_model(with_arrays(run, noise_px=np.zeros(2)), "arrays do not fit")


@pytest.mark.parametrize("name", SHAPES)
def test_a_model_with_a_wrong_shape_is_refused(run: Path, name: str) -> None:
    shape, kind = SHAPES[name]
    assert arrays_of(run)[name].shape != shape
    refused_model(with_arrays(run, **{name: np.zeros(shape, kind)}), "arrays do not fit")


def test_a_model_with_one_bit_flipped_is_refused_or_the_same(run: Path) -> None:
    data = (run / "model.npz").read_bytes()
    random = np.random.default_rng(0)
    sound = vmf("info", run / "model.npz").out
    for _ in range(100):
        where, bit = int(random.integers(len(data))), int(random.integers(8))
        changed = data[:where] + bytes([data[where] ^ 1 << bit]) + data[where + 1 :]
        said = vmf("info", with_bytes(run, changed) / "model.npz")
        if said.code == 0:
            assert said.out == sound
        else:
            said.refused(str(run / "model.npz"))


def recorded_spec(folder: Path, *overrides: str) -> Path:
    """A recording of a robot that translates, and the spec that learns from it."""
    vmf("simulate", QUICKSTART, "-o", folder / "a.mcap", "data.simulate.frames=20", *overrides)
    spec = folder / "recorded.yaml"
    spec.write_text(
        "task: translation\n"
        "data: {recording: {path: a.mcap, pose: {topic: /robot/pose}, tracks: {topic: /stereo/tracks}}}\n"
        "learner: {kind: transport}\nevaluate: {curve_points: 3, bootstrap: 20}\n"
    )
    return spec


def test_a_recorded_run_is_asked_about_the_block_it_held_out(tmp_path: Path) -> None:
    run = train(recorded_spec(tmp_path), tmp_path, "evaluate.gaps=[2]", "evaluate.train_fraction=0.5")
    again = vmf("evaluate", run, "--json", "--quiet").run
    of_training = errors(run).query("protocol == 'held_out'").reset_index(drop=True)
    assert len(of_training) == (10 - 2) * 2 * 5
    assert errors(again).equals(of_training)


def test_a_run_that_held_nothing_out_says_so(tmp_path: Path) -> None:
    run = train(recorded_spec(tmp_path), tmp_path, "evaluate.protocol=[trained_code]")
    vmf("evaluate", run).refused("evaluate.protocol")


def test_results_go_where_out_says(trained: Path, tmp_path: Path) -> None:
    run = vmf("evaluate", trained, "--out", tmp_path, "--json", "--quiet").run
    assert run.parent.parent == tmp_path
    assert record(run)["command"] == "evaluate"
    assert (run / "summary.csv").exists()
