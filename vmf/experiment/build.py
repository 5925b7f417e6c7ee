"""From a spec to the objects that do its work."""

from __future__ import annotations

from functools import partial

import numpy as np

from vmf.approximate import Approximator, Tiling, make_approximator
from vmf.data.simulate import left_camera_position, rig, rig_axes, simulated_rig
from vmf.errors import InputError
from vmf.learn import CompressedPipeline, Learner, SequentialPipeline, StructuredLearner, TransportLearner
from vmf.reconstruct import RigModel
from vmf.solve import SolverOptions
from vmf.spec import CmacApproximator, RigCalibration, Solver, Spec
from vmf.tasks import Task, make_task


def build_task(spec: Spec) -> Task:
    """Return the spec's task space."""
    return make_task(spec.task, spec.lift)


def build_learner(spec: Spec) -> Learner:
    """Return an untrained learner as the spec describes it."""
    task, approximator = build_task(spec), spec.approximator
    make = partial(_new_approximator, spec)
    gauge = getattr(approximator, "gauge", "unit_depth")
    learner = spec.learner
    if learner.kind == "structured":
        return StructuredLearner(task, learner.distortion == "radial")
    if learner.kind == "transport":
        return TransportLearner(
            task, make, learner.estimator, learner.loss, gauge, own_codes=learner.visited == "own"
        )
    tiling, min_support = None, 0.0
    if isinstance(approximator, CmacApproximator):
        tiling = Tiling(
            approximator.overlays, approximator.tile_px, approximator.displacement, approximator.table_size
        )
        min_support = approximator.min_support
    common = partial(
        CompressedPipeline if learner.engine == "compressed" else SequentialPipeline,
        task,
        tiling,
        make,
        estimator=learner.estimator,
        readout=learner.readout,
        gauge=gauge,
        min_support=min_support,
        length=learner.length,
    )
    if learner.engine == "compressed":
        return common()
    step = approximator.step if isinstance(approximator, CmacApproximator) else 1.0
    return common(step=step, exact_matrices=learner.matrices == "exact")


def _new_approximator(spec: Spec) -> Approximator:
    options = spec.approximator.model_dump(exclude={"kind", "gauge"})
    return make_approximator(spec.approximator.kind, **options)


def solver_options(spec: Spec, learner: Learner) -> SolverOptions:
    """Return the spec's solver options, with the noise that the learner has found."""
    solver, noise = spec.solver, learner.noise
    # A tile's parameters belong to its centres' codes as they were observed: their noise is no matter.
    best = "geometric" if spec.learner.kind == "pipeline" else "ml"
    return SolverOptions(
        cost=best if solver.cost == "auto" else solver.cost,
        cameras=solver.cameras,
        start=solver.start,
        known_rotation=solver.known == "rotation",
        max_iterations=solver.max_iterations,
        noise_px=None if noise is None else noise.scale_px,
    )


def idle_solver_settings(spec: Spec) -> tuple[str, ...]:
    """Return which settings of the solver decide nothing, in words."""
    solver, own = spec.solver, Solver()
    most_likely = spec.learner.kind == "structured" and solver.cost in ("auto", "ml")
    if most_likely and (solver.start, solver.max_iterations) != (own.start, own.max_iterations):
        return ("solver.start and solver.max_iterations have no effect with solver.cost: ml",)
    return ()


def check_solver(spec: Spec) -> None:
    """Raise `InputError` where the solver is to take as given what the task has none or nothing else of."""
    if spec.solver.known == "rotation" and spec.task != "six_dof":
        raise InputError(f"solver.known: rotation has no meaning for {spec.task}, none is accepted")


def wants_exact(spec: Spec) -> bool:
    """Whether the learner is to be told what only a simulation knows: its pixels without noise."""
    return spec.learner.kind == "pipeline" and spec.learner.matrices == "exact"


def rig_model(spec: Spec) -> RigModel | None:
    """Return the calibrated rig that the rivals may use, None where a recording comes without one."""
    if spec.data.simulate is not None:
        task, model = build_task(spec), simulated_rig(spec.data.simulate)
        K, _ = rig(model)
        return RigModel(K, K, rig_axes(task), left_camera_position(model, task), model.baseline_m)
    assert spec.data.recording is not None
    calibration = spec.data.recording.calibration
    return None if calibration is None else _published_rig(calibration)


def _published_rig(calibration: RigCalibration) -> RigModel:
    def K(which: str) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
        c = getattr(calibration, which) or calibration.left
        return np.array([[c.fx_px, 0.0, c.cx_px], [0.0, c.fy_px, c.cy_px], [0.0, 0.0, 1.0]])

    return RigModel(
        K("left"),
        K("right"),
        np.array(calibration.L_R_S),
        np.array(calibration.S_p_L_m),
        calibration.baseline_m,
    )
