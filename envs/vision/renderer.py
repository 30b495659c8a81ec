"""The colour camera's picture by SAPIEN. Only here SAPIEN is imported, and only when a picture is asked for."""

from enum import StrEnum
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from vitac.errors import VitacError

from ..extras import install_command
from ..observable import Observable
from .camera import Sight
from .observables import HasSight
from .optics import COLOUR_INTRINSICS, HEIGHT_PX, WIDTH_PX
from .rasterizer import NEAR_M, Label

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


class RenderMode(StrEnum):
    """How SAPIEN renders a picture."""

    RAST = "rast"
    """Rasterised with its default shader."""
    RT = "rt"
    """Ray-traced, 4 samples per pixel without a denoiser."""


_FAR_M = 10.0
_SAMPLES_PER_PIXEL = 4
_WHITE = 255
# Colour of each class and the light.
_COLOURS = {
    Label.BASE: (0.0, 0.0, 1.0, 1.0),
    Label.PEG: (1.0, 0.0, 0.0, 1.0),
    Label.LEFT_GEL: (0.3, 1.0, 1.0, 1.0),
    Label.RIGHT_GEL: (0.3, 1.0, 1.0, 1.0),
    Label.TABLE: (0.6, 0.55, 0.5, 1.0),
    Label.WALL: (0.85, 0.85, 0.85, 1.0),
}
_LIGHT_DIRECTION = (0.0, -1.0, -1.0)
_WHITE_LIGHT = (1.0, 1.0, 1.0)


class RendererMissing(VitacError):
    """SAPIEN or a driver that it can render with is not installed; the message says what to install."""


class Renderer:
    """Renders sights in one mode; the first picture takes seconds, for tables that SAPIEN makes once in a process.

    Raises:
        RendererMissing: there is no SAPIEN, or no driver for it.
    """

    def __init__(self, mode: RenderMode) -> None:
        self._mode = mode
        self._sapien = _sapien()
        try:
            self._sapien.render.RenderMaterial()
        except RuntimeError as error:
            raise RendererMissing(
                f"SAPIEN finds no Vulkan driver ({error}). Install NVIDIA's driver, or Mesa 24.3 or newer for "
                "rendering on the CPU: `apt-get install mesa-vulkan-drivers` on Debian 13 and Ubuntu 24.04, "
                "`apt-get install -t bookworm-backports mesa-vulkan-drivers` on Debian 12."
            ) from error
        self._scene = self._lit_scene()

    def picture(self, sight: Sight) -> NDArray[np.uint8]:
        """Return the colour camera's picture on a white background, shape [480, 640, 3], red, green, blue."""
        if self._mode is RenderMode.RT:
            self._sapien.render.set_ray_tracing_samples_per_pixel(_SAMPLES_PER_PIXEL)
            self._sapien.render.set_ray_tracing_denoiser("none")
        camera = self._camera()
        entities = [
            self._rig(camera, sight),
            *(self._body(sight, label) for label in _COLOURS if label in sight.labels),
        ]
        for entity in entities:
            self._scene.add_entity(entity)
        self._scene.update_render()
        camera.take_picture()
        colours = np.clip(camera.get_picture("Color")[..., :3] * 255.0 + 0.5, 0, 255).astype(np.uint8)
        nothing = camera.get_picture("Segmentation")[..., 1] == 0
        colours[nothing] = _WHITE
        for entity in entities:
            self._scene.remove_entity(entity)
        return np.asarray(colours)

    def _lit_scene(self) -> Any:
        scene = self._sapien.Scene([self._sapien.render.RenderSystem()])
        scene.set_ambient_light(_WHITE_LIGHT)
        scene.add_directional_light(_LIGHT_DIRECTION, _WHITE_LIGHT, shadow=True)
        return scene

    def _body(self, sight: Sight, label: Label) -> Any:
        """Return the entity of one class: each triangle has corners and a normal of its own, for hard edges."""
        render = self._sapien.render
        corners, normals = sight.list_triangles(label)
        numbers = np.arange(3 * len(corners), dtype=np.uint32).reshape(-1, 3)
        material = render.RenderMaterial(base_color=_COLOURS[label], specular=0.8, roughness=0.5, metallic=0.1)
        shape = render.RenderShapeTriangleMesh(
            corners.reshape(-1, 3).astype(np.float32),
            numbers,
            np.repeat(normals, 3, axis=0).astype(np.float32),
            np.zeros((3 * len(corners), 2), np.float32),
            material,
        )
        component = render.RenderBodyComponent()
        component.attach(shape)
        entity = self._sapien.Entity()
        entity.add_component(component)
        return entity

    def _camera(self) -> Any:
        shader = "rt" if self._mode is RenderMode.RT else "default"
        shaders = Path(self._sapien.__file__).parent / "vulkan_shader"
        camera = self._sapien.render.RenderCameraComponent(WIDTH_PX, HEIGHT_PX, str(shaders / shader))
        optics = COLOUR_INTRINSICS
        camera.set_perspective_parameters(
            NEAR_M, _FAR_M, optics.focal_u_px, optics.focal_v_px, optics.centre_u_px, optics.centre_v_px, 0.0
        )
        return camera

    def _rig(self, camera: Any, sight: Sight) -> Any:
        """Return the entity that carries the camera; SAPIEN's looks along x with y to the left and z up."""
        right, down, forward = sight.pose.world_from_camera.T
        world_from_camera = np.eye(4)
        world_from_camera[:3, :3] = np.column_stack([forward, -right, -down])
        world_from_camera[:3, 3] = sight.pose.position_m
        entity = self._sapien.Entity()
        entity.add_component(camera)
        entity.set_pose(self._sapien.Pose(world_from_camera))
        return entity


@cache
def make_renderer(mode: RenderMode) -> Renderer:
    """Return the renderer of a mode, made at the first call in a process.

    Raises:
        RendererMissing: there is no SAPIEN, or no driver for it.
    """
    return Renderer(mode)


def _sapien() -> Any:
    try:
        import sapien
    except ImportError as error:
        raise RendererMissing(
            f"The modes rast and rt need SAPIEN, which cannot be imported ({error}). Install it with: "
            f"{install_command('vision')}"
        ) from error
    return sapien


def rendered_picture(mode: RenderMode) -> Observable[HasSight]:
    """Return the observable of the rig's colour camera as SAPIEN renders it, `rgb_rast` or `rgb_rt`.

    For training and transfer: given to an environment's `observables`, listed by no task. Its bits change with CPU and
    driver. The renderer is made at the first reading.
    """

    def read(scene: HasSight, _: "np.random.Generator") -> "NDArray[np.uint8]":

        return make_renderer(mode).picture(scene.sight())

    return Observable(
        name=f"rgb_{mode}",
        shape=(HEIGHT_PX, WIDTH_PX, 3),
        dtype="uint8",
        unit="1",
        meaning="Red, green, blue of the same view as `rgb_picture`, with shadows and highlights, on white.",
        read=read,
    )
