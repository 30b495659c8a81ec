"""What no scene can be made of is refused with the body or setting and its value."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from block_meshes import box_gel, box_surface
from small_scenes import IDENTITY, driven_positions_m
from vitac.envs.fem.model.mesh import GelBody, PronyBranch, RigidBody
from vitac.envs.fem.model.settings import ContactSettings, SolverSettings
from vitac.envs.fem.scene.layout import SceneError
from vitac.envs.fem.scene.scene import Scene

GEL = GelBody(mesh=box_gel((0.01, 0.01, 0.01), (1, 1, 1)), rotation=IDENTITY, translation_m=np.zeros(3))
SLOW = PronyBranch(modulus_ratio=0.5, relaxation_time_s=2.0)
BODY = RigidBody(mesh=box_surface((0.01, 0.01, 0.01)), rotation=IDENTITY, translation_m=np.array([0.0, 0.0, 1.0]))


def scene(gel: GelBody = GEL, body: RigidBody = BODY, time_step_s: float = 0.1, **settings: Any) -> Scene:
    return Scene(gels=[gel], bodies=[body], time_step_s=time_step_s, **settings)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"gel": replace(GEL, youngs_modulus_pa=-1.0)}, "youngs_modulus_pa of gel 0 is -1.0"),
        ({"gel": replace(GEL, poisson_ratio=0.5)}, "poisson_ratio of gel 0 is 0.5"),
        ({"gel": replace(GEL, poisson_ratio=0.49)}, "of linear tetrahedra, which lock: at 0.49 a ball presses 1.7"),
        ({"gel": replace(GEL, viscosity=(SLOW,))}, "gel 0 has viscosity, but .* is of tetrahedra"),
        (
            {"gel": replace(GEL, viscosity=(replace(SLOW, relaxation_time_s=0.0),))},
            "relaxation_time_s of the visc",
        ),
        (
            {"gel": replace(GEL, viscosity=(replace(SLOW, modulus_ratio=-0.1),))},
            "modulus_ratio of the viscosity",
        ),
        ({"gel": replace(GEL, friction=-1.0)}, "friction of gel 0"),
        ({"body": replace(BODY, translation_m=np.array([0, np.nan, 0]), fixed=True)}, "translation_m of body 0"),
        ({"body": replace(BODY, rotation=-IDENTITY)}, "rotation of body 0"),
        ({"body": replace(BODY, rotation=2 * IDENTITY)}, "rotation of body 0"),
        ({"body": replace(BODY, density_kg_m3=0.0)}, "density_kg_m3 of body 0"),
        ({"time_step_s": 0.0}, "time_step_s of the scene is 0.0"),
        ({"contact": ContactSettings(d_hat_m=-1e-4)}, "d_hat_m of the contact"),
        ({"contact": ContactSettings(ccd_gap_fraction=1.5)}, "ccd_gap_fraction is 1.5"),
        ({"solver": SolverSettings(phase_iterations=0)}, "phase_iterations of the solver is 0"),
        ({"solver": SolverSettings(first_division_level=9)}, "first_division_level is 9"),
        ({"solver": SolverSettings(saddle_escapes=-1)}, "saddle_escapes is -1"),
    ],
)
def test_what_makes_no_scene_is_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        scene(**changes)


def test_a_target_that_is_no_number_is_named() -> None:
    targets = driven_positions_m(GEL)
    targets[2, 1] = np.inf
    with pytest.raises(SceneError, match=f"target of node {GEL.mesh.driven_nodes[2]} of gel 0"):
        scene().step(driven_targets_m=[targets])
