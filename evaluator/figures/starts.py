"""What is measured of a sensor at single starts: information of the markers, and the score under variations."""

from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final, cast

import numpy as np
from numpy.typing import NDArray

from ..episodes.episode import Environment, make_environment, run_episode
from ..episodes.records import EpisodeOutcome
from ..estimator.calibration import EstimatorSession
from ..estimator.regression import Coefficients
from ..tracks import Episode, Task
from .figures import ENV_STEPS, FiguresPart, GraspFigures, StartFigures, Symmetric, Variation, rounded
from .touch import mesh_error, touch_figures

if TYPE_CHECKING:
    from vitac.envs.scene.grasped_scene import GraspedScene
    from vitac.envs.tactile.design import SensorDesign

CONTINUUM_NODES: Final = 8.0
"""Nodes of the mesh that stands for a gel's continuum, of those of its own."""
START: Final = {"shape": "cuboid", "offset_mm_deg": (0.0, 0.0, 0.0), "rng_seed": (0, 0)}
"""In its hole the peg hangs freely."""


def grasp_figures(env: Any) -> GraspFigures:
    """Return indentation and force of the grasp, which are the same at every start.

    Args:
        env: of the peg task, with the sensor; it is reset here.
    """
    env.reset(options=START)
    scene: GraspedScene = env.scene
    return GraspFigures(
        indentation_mm=rounded(max(_indentation_mm(scene, index) for index in range(2))),
        force_n=rounded(0.5 * sum(_force_n(scene, index) for index in range(2))),
        smallest_det_f=rounded(smallest_det_f(scene)),
    )


def smallest_det_f(scene: "GraspedScene") -> float:
    """Return the smallest det F, the ratio of a tetrahedron's volume to that at rest, of both gels."""
    from vitac.envs.fem.model.mesh import signed_volumes_m3

    gel = scene.gel
    return min(
        float((signed_volumes_m3(scene.gel_nodes_m(index)[gel.tetrahedra]) / gel.volumes_m3).min())
        for index in range(2)
    )


def _indentation_mm(scene: "GraspedScene", index: int) -> float:
    """Return how far the sensing face is pressed in where it is pressed in most [mm]."""
    gel, pose = scene.gel, scene.sensor_pose(index)
    moved = (scene.gel_nodes_m(index) - pose.centre_m)[gel.sensing_nodes]
    heights_m = (moved * pose.rotation[:, 2]).sum(axis=1)
    return 1e3 * float((gel.rest_position_m[gel.sensing_nodes, 2] - heights_m).max())


def _force_n(scene: "GraspedScene", index: int) -> float:
    """Return the force with which a finger presses its gel towards the peg [N].

    In equilibrium it is what the tetrahedra's stress puts on the driven nodes: the sum of V sigma grad N_a, with volume
    V and gradients in the deformed gel (J. Bonet and R. D. Wood, Nonlinear Continuum Mechanics (2008), equation 9.15).
    """
    from vitac.envs.drawing.scene_view import cauchy_stress_pa, deformation_gradients

    gel, physics, pose = scene.gel, scene.physics, scene.sensor_pose(index)
    nodes_m = scene.gel_nodes_m(index)
    stress_pa = cauchy_stress_pa(
        deformation_gradients(gel.rest_position_m, nodes_m, gel.tetrahedra),
        youngs_modulus_pa=physics.youngs_modulus_pa,
        poisson_ratio=physics.poisson_ratio,
    )
    corners = nodes_m[gel.tetrahedra]
    e1, e2, e3 = (corners[:, k] - corners[:, 0] for k in (1, 2, 3))
    # 6 V grad N_a of corners 1 to 3; those of all four sum to zero.
    inner = np.stack([np.cross(e2, e3), np.cross(e3, e1), np.cross(e1, e2)], axis=1)
    gradients = np.concatenate([-inner.sum(axis=1, keepdims=True), inner], axis=1) / 6.0
    forces_n = np.einsum("tij,taj->tai", stress_pa, gradients)
    total = forces_n[gel.driven[gel.tetrahedra]].sum(axis=0)
    return float((total * pose.rotation[:, 2]).sum())


MAX_STARTS: Final = 90
"""Starts at which figures are taken: those of the public list."""
# Half the differences in the offset by which the pictures' derivatives are taken [mm, mm, deg].
_STEPS = (0.1, 0.1, 0.2)
_FINER, _FINEST = 1.5, 2.0

FloatArray = NDArray[np.float64]


def measured_episodes(task: Task) -> frozenset[int]:
    """Return the numbers of the episodes at whose starts figures are taken: each start once.

    Of the repeats of a start another one is taken each time, so that all shards have about as many to measure.
    """
    repeats: dict[tuple[str, tuple[float, ...]], list[int]] = {}
    for episode in task.episodes:
        repeats.setdefault((episode.shape, episode.offset), []).append(episode.number)
    chosen = list(repeats.values())[:MAX_STARTS]
    return frozenset(numbers[index % len(numbers)] for index, numbers in enumerate(chosen))


class Measurement:
    """Measures one sensor in the environments of one process.

    Args:
        task: of the standard estimator or of its blind run.
        design: of the sensor.
        coefficients: of the standard estimator for it.
    """

    def __init__(self, task: Task, design: "SensorDesign", coefficients: Coefficients) -> None:
        self._task, self._design = task, design
        self._session = EstimatorSession(coefficients, task.definition.action_scale, is_blind=False)
        self._environments: dict[Variation, Environment] = {}

    def whole(self) -> FiguresPart:
        """Return what is measured of the sensor as a whole."""
        return measure_whole(self._design, self._environment(Variation.NONE))

    def start(self, episode: Episode) -> StartFigures:
        """Return what is measured at the start of an episode."""
        information, least = self._information(episode)
        successes, cpu_s = {}, 0.0
        for variation in Variation:
            env = self._environment(variation)
            record = run_episode(env=env, task=self._task, episode=episode, open_session=lambda: self._session)
            successes[variation] = record.outcome is EpisodeOutcome.SUCCESS
            if variation is Variation.NONE:
                cpu_s = record.timings.physics_s + record.timings.markers_s
        return StartFigures(
            episode=episode.number,
            information=information,
            smallest_det_f=rounded(least),
            successes=successes,
            cpu_s=rounded(cpu_s),
        )

    def _information(self, episode: Episode) -> tuple[tuple[Symmetric, ...] | None, float]:
        """Return the Fisher information of the first pictures at a start, and the smallest det F on the way.

        The gripper goes straight down. With the derivatives D of the markers' pixels by the offset, a noise of s and a
        share l of markers that are lost, the information is (1 - l) D^T D / s^2, summed over the pictures.
        """
        least, slopes = np.inf, []
        for axis, step in enumerate(_STEPS):
            ends = []
            for way in (1.0, -1.0):
                offset = list(episode.offset)
                offset[axis] += way * step
                pixels, smallest = self._pictures(episode, tuple(offset))
                if pixels is None:
                    return None, min(least, smallest)
                least = min(least, smallest)
                ends.append(pixels)
            slopes.append((ends[0] - ends[1]) / (2.0 * step))
        markers = self._settings.markers
        share = (1.0 - markers.loss_probability) / (markers.noise_px * markers.noise_px)
        products = share * np.einsum("akp,bkp->kab", np.array(slopes), np.array(slopes))
        upper = np.cumsum(products, axis=0)[:, (0, 0, 0, 1, 1, 2), (0, 1, 2, 1, 2, 2)]
        return tuple(cast(Symmetric, tuple(map(rounded, row))) for row in upper.tolist()), least

    def _pictures(self, episode: Episode, offset: tuple[float, ...]) -> tuple[FloatArray | None, float]:
        """Return the markers' pixels in the first pictures, shape [k, p] or None if one was not reached, and det F."""
        env: Any = self._noiseless
        observation, info = env.reset(options={**episode.options, episode.offset_option: offset})
        seen, least = [], np.inf
        for env_step in range(ENV_STEPS):
            if env_step:
                observation, _, _, _, info = env.step(np.zeros(len(self._task.actions), dtype=np.float32))
            least = min(least, smallest_det_f(env.scene))
            if info["end_reason"] == EpisodeOutcome.NOT_CONVERGED:
                return None, least
            seen.append(observation["marker_flow"][:, 1, : len(self._design.markers_mm)].astype(np.float64).reshape(-1))
        return np.array(seen), least

    def _environment(self, variation: Variation) -> Environment:
        if variation not in self._environments:
            sensor = self._design
            if variation in (Variation.FINER, Variation.FINEST):
                sensor = refined_design(sensor, _FINER if variation is Variation.FINER else _FINEST)
            overrides = {} if variation is Variation.NONE else _overrides(variation, self._settings)
            self._environments[variation] = make_environment(self._task, sensor=sensor, settings=overrides)
        return self._environments[variation]

    @cached_property
    def _noiseless(self) -> Environment:
        markers = replace(self._settings.markers, noise_px=0.0, loss_probability=0.0)
        return make_environment(self._task, sensor=self._design, settings={"markers": markers})

    @cached_property
    def _settings(self) -> Any:
        return cast(Any, self._environment(Variation.NONE)).settings


def measure_whole(design: "SensorDesign", env: Environment) -> FiguresPart:
    """Return what takes no episodes, measured of a sensor in an environment that has it."""
    physics = cast(Any, env).settings.physics
    touch = touch_figures(design, youngs_modulus_pa=physics.youngs_modulus_pa, poisson_ratio=physics.poisson_ratio)
    return FiguresPart(starts=(), touch=touch, grasp=grasp_figures(env))


def continuum_error(design: "SensorDesign") -> float | None:
    """Return how far the markers' motion under pins is from that of the gel's continuum; see `mesh_error`.

    It takes 1.5 s of CPU time for 294 nodes, and 8 s for as many nodes and markers as a sensor may have.
    """
    from vitac.envs.scene.grasped_scene import PhysicsSettings

    physics = PhysicsSettings()
    return mesh_error(
        design,
        refined_design(design, CONTINUUM_NODES),
        youngs_modulus_pa=physics.youngs_modulus_pa,
        poisson_ratio=physics.poisson_ratio,
    )


def refined_design(design: "SensorDesign", times: float) -> "SensorDesign":
    """Return the same sensor with a mesh of this multiple of the nodes.

    Args:
        design: of the sensor.
        times: above 1.
    """
    from vitac.envs.sensor_design.tetrahedra import Tetrahedra, make_gel, refined

    nodes_mm = 1e3 * design.gel.rest_position_m
    nodes_mm[:, 2] -= nodes_mm[:, 2].min()
    mesh = refined(Tetrahedra(nodes_mm=nodes_mm, corners=design.gel.tetrahedra), int(times * len(nodes_mm)))
    gel, sensing = make_gel(mesh, name=design.gel.name)
    return replace(design, gel=gel, sensing_triangles=sensing)


def _overrides(variation: Variation, settings: Any) -> Mapping[str, object]:
    """Return the settings that a variation changes."""
    physics, markers = settings.physics, settings.markers
    match variation:
        case Variation.FRICTION_LOW | Variation.FRICTION_HIGH:
            factor = 0.7 if variation is Variation.FRICTION_LOW else 1.3
            return {
                "physics": replace(physics, gel_friction=factor * physics.gel_friction),
                "peg_friction": factor * settings.peg_friction,
                "hole_friction": factor * settings.hole_friction,
            }
        case Variation.SOFTER | Variation.STIFFER:
            factor = 0.8 if variation is Variation.SOFTER else 1.2
            return {"physics": replace(physics, youngs_modulus_pa=factor * physics.youngs_modulus_pa)}
        case Variation.NOISE:
            return {"markers": replace(markers, noise_px=1.0)}
        case Variation.LOSS:
            return {"markers": replace(markers, loss_probability=0.05)}
        case _:
            return {}
