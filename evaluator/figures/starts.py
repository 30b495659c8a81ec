"""Figures of a team's sensor at starts of an episode list, and of what it feels there."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import cached_property
from statistics import median
from typing import TYPE_CHECKING, Any, Final, cast

import numpy as np
from numpy.typing import NDArray

from ..episodes.episode import Environment, make_environment, run_episode
from ..episodes.records import EpisodeOutcome
from ..estimator import EstimatorSession
from ..regression import Coefficients
from ..tracks import Episode, Task
from .figures import (
    ENV_STEPS,
    FiguresPart,
    GraspFigures,
    Row,
    SensitivityMap,
    StartFigures,
    Symmetric,
    TouchFigures,
    Variation,
    rounded,
)

if TYPE_CHECKING:
    from vitac.envs.scene.grasped_scene import GraspedScene
    from vitac.envs.tactile.design import SensorDesign
    from vitac.envs.tactile.response import Response


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


# Places of the map.
_SPACING_MM = 2.0
_HALF_X_MM, _HALF_Y_MM = 12.0, 10.0
# Standard deviation of the pressure around the middle of a pin or an edge.
_SPREAD_MM = 1.0
# A place senses where this part of a pin's pressure falls on sensing faces.
_LEAST_SHARE = 0.5
# Two pictures are distinguished with 95 % certainty where their markers differ by 2 x 1.645 standard deviations.
_SEPARATION = 3.29
_NOISE_PX = 0.5
_STEP_MM = 0.25


def touch_figures(design: "SensorDesign", *, youngs_modulus_pa: float, poisson_ratio: float) -> TouchFigures:
    """Return how the markers respond to a pin and to an edge that press with 1 N on the undeformed gel.

    Args:
        design: of the sensor.
        youngs_modulus_pa: of the gel [Pa].
        poisson_ratio: of the gel.
    """
    from vitac.envs.tactile.response import compute_response

    response = compute_response(design, youngs_modulus_pa=youngs_modulus_pa, poisson_ratio=poisson_ratio)
    x_mm, y_mm = _line(_HALF_X_MM), _line(_HALF_Y_MM)
    places = np.array([(x, y) for y in y_mm for x in x_mm])
    senses = _senses(response, places)
    normal, shear = np.full(len(places), np.nan), np.full(len(places), np.nan)
    normal[senses], shear[senses] = _sensitivity(response, places[senses])
    shape = len(y_mm), len(x_mm)
    return TouchFigures(
        sensitivity=SensitivityMap(
            x_mm=tuple(x_mm),
            y_mm=tuple(y_mm),
            normal_px_n=tuple(map(_row, normal.reshape(shape).tolist())),
            shear_px_n=tuple(map(_row, shear.reshape(shape).tolist())),
        ),
        normal_px_n=_median_at_places(normal[senses]),
        shear_px_n=_median_at_places(shear[senses]),
        pin_mm=_median_at_places(_pin_shifts_mm(response, places[senses])),
        edge_mm=(_median(_edge_shifts_mm(response, x_mm, 0)), _median(_edge_shifts_mm(response, y_mm, 1))),
    )


def mesh_error(
    design: "SensorDesign", finer: "SensorDesign", *, youngs_modulus_pa: float, poisson_ratio: float
) -> float | None:
    """Return how far the markers' motion under pins is from that on a finer mesh of the same gel (RMS, of its own).

    None where no place senses. Pins press with 1 N along the base's normal at the places of the map.

    Args:
        design: of the sensor.
        finer: the same sensor with more nodes.
        youngs_modulus_pa: of the gel [Pa]; the answer is the same for all.
        poisson_ratio: of the gel.
    """
    from vitac.envs.tactile.response import compute_response

    own, reference = (
        compute_response(each, youngs_modulus_pa=youngs_modulus_pa, poisson_ratio=poisson_ratio)
        for each in (design, finer)
    )
    places = np.array([(x, y) for y in _line(_HALF_Y_MM) for x in _line(_HALF_X_MM)])
    places = places[_senses(own, places) & _senses(reference, places)]
    if not len(places):
        return None
    moved, expected = (response.motion_px_n(_pin(response, places))[:, 2] for response in (own, reference))
    return rounded(float(np.sqrt(((moved - expected) ** 2).sum() / (expected**2).sum())))


def _line(half_mm: float) -> list[float]:
    return [float(value) for value in np.arange(-half_mm, half_mm + 0.5 * _SPACING_MM, _SPACING_MM)]


def _row(values: list[float]) -> Row:
    return tuple(None if np.isnan(value) else rounded(value) for value in values)


def _median(values: Iterable[float]) -> float:
    return rounded(median(float(value) for value in values))


def _median_at_places(values: FloatArray) -> float | None:
    """Return the median; None where no place senses, as on ridges with narrow tops."""
    return _median(values) if values.size else None


def _pin(response: "Response", places: FloatArray) -> FloatArray:
    """Return the pressure of pins at places, shape [q, p]."""
    apart = response.points_mm[:, None, :] - places[None]
    return np.asarray(np.exp(-(apart * apart).sum(axis=2) / (2.0 * _SPREAD_MM * _SPREAD_MM)))


def _edge(response: "Response", at_mm: FloatArray, axis: int) -> FloatArray:
    """Return the pressure of straight edges across an axis, as long as the gel, shape [q, p]."""
    apart = response.points_mm[:, axis, None] - at_mm
    return np.asarray(np.exp(-apart * apart / (2.0 * _SPREAD_MM * _SPREAD_MM)))


def _senses(response: "Response", places: FloatArray) -> NDArray[np.bool_]:
    whole = 2.0 * np.pi * _SPREAD_MM * _SPREAD_MM
    share = (_pin(response, places) * response.areas_mm2[:, None]).sum(axis=0) / whole
    return np.asarray(share >= _LEAST_SHARE)


def _sensitivity(response: "Response", places: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the motion of all markers together, the root of the sum of squares [px/N], normal and along the base."""
    squared = (response.motion_px_n(_pin(response, places)) ** 2).sum(axis=0)
    return np.sqrt(squared[2]), np.sqrt(0.5 * (squared[0] + squared[1]))


def _pin_shifts_mm(response: "Response", places: FloatArray) -> FloatArray:
    """Return the smallest shift of a pin that can be detected, in the direction in which this is hardest."""
    slopes = []
    for axis in range(2):
        step = np.zeros(2)
        step[axis] = _STEP_MM
        ahead, behind = (response.motion_px_n(_pin(response, places + way * step))[:, 2] for way in (1.0, -1.0))
        slopes.append((ahead - behind) / (2.0 * _STEP_MM))
    along_x, along_y = slopes
    xx, xy, yy = ((a * b).sum(axis=0) for a, b in ((along_x, along_x), (along_x, along_y), (along_y, along_y)))
    weakest = 0.5 * (xx + yy) - np.sqrt(0.25 * (xx - yy) ** 2 + xy * xy)
    return _shifts_mm(weakest)


def _edge_shifts_mm(response: "Response", at_mm: list[float], axis: int) -> FloatArray:
    """Return the smallest shift of an edge across itself that can be detected."""
    # The outermost edges would leave the gel.
    inner = np.array(at_mm[1:-1])
    ahead, behind = (response.motion_px_n(_edge(response, inner + way * _STEP_MM, axis))[:, 2] for way in (1.0, -1.0))
    slope = (ahead - behind) / (2.0 * _STEP_MM)
    return _shifts_mm((slope * slope).sum(axis=0))


def _shifts_mm(squared_slopes: FloatArray) -> FloatArray:
    return np.asarray(_SEPARATION * _NOISE_PX / np.sqrt(np.maximum(squared_slopes, 1e-12)))
