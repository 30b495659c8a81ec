"""SAPIEN's pictures: what is handed to it, on a stand-in, and the real one where it and a driver are installed."""

import subprocess
import sys
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from fake_scene import FakeScene
from vitac.envs.tasks.fusion_insertion.env import FusionInsertionEnv
from vitac.envs.vision.camera import Sight
from vitac.envs.vision.rasterizer import Label
from vitac.envs.vision.renderer import Renderer, RendererMissing, RenderMode, make_renderer, rendered_picture

START = {"start": (2.0, -4.0, 6.0, 5.0, 1), "rng_seed": (0, 1)}


class FakeCamera:
    """Sees grey bodies in the left half of the picture, nothing in the right one; a highlight brighter than white."""

    def __init__(self, width: int, height: int, shaders: str) -> None:
        self.size, self.shaders = (height, width), shaders
        self.perspective: tuple[float, ...] = ()

    def set_perspective_parameters(self, *values: float) -> None:
        self.perspective = values

    def take_picture(self) -> None:
        self.taken = True

    def get_picture(self, name: str) -> np.ndarray:
        assert self.taken
        picture = np.zeros((*self.size, 4), np.float32 if name == "Color" else np.int32)
        picture[:, :320] = 0.5 if name == "Color" else (0, 7, 0, 0)
        if name == "Color":
            picture[0, 0, :3] = (1.5, 0.0, 0.2)
        return picture


class FakeSapien(SimpleNamespace):
    """What our renderer needs of SAPIEN; keeps what it was given."""

    def __init__(self, driver: bool = True) -> None:
        self.driver = driver
        self.entities: list[Any] = []
        self.bodies: list[Any] = []
        self.cameras: list[FakeCamera] = []
        self.samples: int | None = None
        self.lights: list[tuple[Any, ...]] = []
        shape = SimpleNamespace
        super().__init__(
            __file__="/packages/sapien/__init__.py",
            Scene=lambda systems: self,
            Entity=lambda: SimpleNamespace(components=[], add_component=lambda part: None, set_pose=self._pose),
            Pose=lambda matrix: matrix,
            render=SimpleNamespace(
                RenderSystem=object,
                RenderMaterial=self._material,
                RenderShapeTriangleMesh=lambda *parts: shape(parts=parts),
                RenderBodyComponent=lambda: SimpleNamespace(attach=self.bodies.append),
                RenderCameraComponent=self._camera,
                set_ray_tracing_samples_per_pixel=lambda count: setattr(self, "samples", count),
                set_ray_tracing_denoiser=lambda name: None,
            ),
        )

    def set_ambient_light(self, colour: Any) -> None:
        self.lights.append(colour)

    def add_directional_light(self, direction: Any, colour: Any, shadow: bool) -> None:
        self.lights.append((direction, colour, shadow))

    def add_entity(self, entity: Any) -> None:
        self.entities.append(entity)

    def remove_entity(self, entity: Any) -> None:
        self.entities.remove(entity)

    def update_render(self) -> None:
        assert len(self.entities) == 5  # the camera, peg, base and two gels

    def _pose(self, matrix: np.ndarray) -> None:
        self.camera_pose = matrix

    def _material(self, **values: Any) -> Any:
        if not self.driver:
            raise RuntimeError("failed to find a rendering device")
        return SimpleNamespace(**values)

    def _camera(self, *values: Any) -> FakeCamera:
        camera = FakeCamera(*values)
        self.cameras.append(camera)
        return camera


@pytest.fixture
def sight(fake_scenes: list[FakeScene]) -> Sight:
    env = FusionInsertionEnv(depth_mode="gt", observation_keys=())
    env.reset(options=START)
    return env.task_scene.sight()


def renderer(
    monkeypatch: pytest.MonkeyPatch, sapien: FakeSapien | None, mode: RenderMode = RenderMode.RAST
) -> Renderer:
    monkeypatch.setitem(sys.modules, "sapien", sapien)
    return Renderer(mode)


def test_without_sapien_the_error_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(RendererMissing, match=r"need SAPIEN, .* Install it with: .*-m pip install 'sapien>=3"):
        renderer(monkeypatch, None)


def test_without_a_driver_the_error_says_what_to_install_on_each_system(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(RendererMissing) as failed:
        renderer(monkeypatch, FakeSapien(driver=False))
    told = str(failed.value)
    assert "no Vulkan driver (failed to find a rendering device)" in told
    for hint in ("NVIDIA's driver", "Mesa 24.3 or newer", "Ubuntu 24.04", "-t bookworm-backports mesa-vulkan-drivers"):
        assert hint in told


def test_nothing_of_sapien_is_loaded_before_a_picture_is_asked_for() -> None:
    code = (
        "import sys; sys.modules['sapien'] = None\n"
        "import vitac.envs.vision.renderer as r, vitac.envs.vision.renderer as m\n"
        "import vitac.envs.vision.renderer as o\n"
        "[o.rendered_picture(mode) for mode in m.RenderMode]; print('light')"
    )
    done = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "light\n"


@pytest.mark.parametrize(("mode", "folder", "samples"), [("rast", "default", None), ("rt", "rt", 4)])
def test_the_mode_selects_the_shaders(
    monkeypatch: pytest.MonkeyPatch, sight: Sight, mode: str, folder: str, samples: int | None
) -> None:
    sapien = FakeSapien()
    renderer(monkeypatch, sapien, RenderMode(mode)).picture(sight)
    assert sapien.cameras[0].shaders == f"/packages/sapien/vulkan_shader/{folder}"
    assert sapien.samples == samples


def test_the_camera_stands_where_ours_does_with_the_same_optics(monkeypatch: pytest.MonkeyPatch, sight: Sight) -> None:
    sapien = FakeSapien()
    renderer(monkeypatch, sapien).picture(sight)
    assert sapien.cameras[0].perspective == (0.1, 10.0, 604.3075, 604.3075, 317.2341, 233.7944, 0.0)
    rotation, ours = sapien.camera_pose[:3, :3], sight.pose.world_from_camera
    # SAPIEN's axes are forward, left, up; ours right, down, forward.
    assert np.array_equal(rotation @ [1, 0, 0], ours @ [0, 0, 1])
    assert np.array_equal(rotation @ [0, 1, 0], ours @ [-1, 0, 0])
    assert np.array_equal(rotation @ [0, 0, 1], ours @ [0, -1, 0])
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    assert np.array_equal(sapien.camera_pose[:3, 3], sight.pose.position_m)


def test_every_body_is_drawn_as_it_is_with_hard_edges_and_its_colour(
    monkeypatch: pytest.MonkeyPatch, sight: Sight
) -> None:
    sapien = FakeSapien()
    renderer(monkeypatch, sapien).picture(sight)
    assert [shape.parts[4].base_color[:3] for shape in sapien.bodies] == [
        (0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.3, 1.0, 1.0), (0.3, 1.0, 1.0),
    ]  # fmt: skip
    for label, shape in zip((Label.BASE, Label.PEG, Label.LEFT_GEL, Label.RIGHT_GEL), sapien.bodies, strict=True):
        corners, normals = sight.list_triangles(label)
        vertices, triangles, vertex_normals, uvs, _ = shape.parts
        assert len(triangles) == len(corners) > 10
        np.testing.assert_allclose(vertices[triangles], corners, atol=1e-7)
        for corner in range(3):
            np.testing.assert_allclose(vertex_normals[triangles[:, corner]], normals, atol=1e-7)
        assert uvs.shape == (len(vertices), 2)


def test_the_background_is_white_and_highlights_do_not_wrap(monkeypatch: pytest.MonkeyPatch, sight: Sight) -> None:
    picture = renderer(monkeypatch, FakeSapien()).picture(sight)
    assert picture.shape == (480, 640, 3)
    assert picture.dtype == np.uint8
    assert (picture[:, 320:] == 255).all()
    assert picture[5, 5].tolist() == [128, 128, 128]
    assert picture[0, 0].tolist() == [255, 0, 51]


def test_nothing_stays_in_the_scene_for_the_next_picture(monkeypatch: pytest.MonkeyPatch, sight: Sight) -> None:
    sapien = FakeSapien()
    render = renderer(monkeypatch, sapien).picture
    assert np.array_equal(render(sight), render(sight))
    assert (sapien.entities, len(sapien.cameras), len(sapien.lights)) == ([], 2, 2)


def test_an_environment_observes_the_picture_without_any_task_listing_it(
    monkeypatch: pytest.MonkeyPatch, fake_scenes: list[FakeScene]
) -> None:
    monkeypatch.setitem(sys.modules, "sapien", FakeSapien())
    make_renderer.cache_clear()
    env = FusionInsertionEnv(observables=(rendered_picture(RenderMode.RAST),), observation_keys=())
    observation, _ = env.reset(options=START)
    make_renderer.cache_clear()
    assert observation in env.observation_space
    assert list(observation) == ["rgb_rast"]
    assert not {"rgb_rast", "rgb_rt"} & {entry.name for entry in env.task.observables}


@pytest.mark.parametrize("mode", RenderMode)
def test_sapien_shows_the_bodies_where_our_camera_does(sight: Sight, mode: RenderMode) -> None:
    try:
        picture = Renderer(mode).picture(sight)
    except RendererMissing as missing:
        pytest.skip(str(missing))
    ours, theirs = (np.any(colours != 255, axis=2) for colours in (sight.colours, picture))
    assert (ours != theirs).sum() < 0.03 * ours.sum()
    peg, base = ((sight.segmentation == label) & theirs for label in (Label.PEG, Label.BASE))
    assert picture[peg].mean(axis=0)[0] > 150 > picture[peg].mean(axis=0)[2]
    assert picture[base].mean(axis=0)[2] > 150 > picture[base].mean(axis=0)[0]
