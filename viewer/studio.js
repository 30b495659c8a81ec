// What surrounds a scene: light, a table with a grid of 10 mm and shadows, in the page's colour scheme.

import {
  CircleGeometry,
  Color,
  DirectionalLight,
  Mesh,
  MeshStandardMaterial,
  NeutralToneMapping,
  PCFShadowMap,
  PMREMGenerator,
  Vector2,
} from "three";
import { RoomEnvironment } from "three/addons/environments/RoomEnvironment.js";

const DARK = window.matchMedia("(prefers-color-scheme: dark)");
const MOODS = {
  light: { table: 0xb4bbc1, line: 0x7d868e, environment: 0.6, key: 2.0, rim: 0.3, shadow: 0.5 },
  dark: { table: 0x2b3238, line: 0x59646d, environment: 0.5, key: 1.7, rim: 0.8, shadow: 0.45 },
};
const GRID_MM = 10;
const SHADOW_PIXELS = 1024;
const ENVIRONMENT_PIXELS = 128; // of a face: it is seen in rough metal only
// The grid, and a table that fades into the page.
const TABLE_COLOUR = `
#include <color_fragment>
vec2 fromLine = abs(fract((onTable + tableMotion) / ${GRID_MM}.0 - 0.5) - 0.5) * ${GRID_MM}.0;
vec2 lineWidth = fwidth(onTable);
float isLine = 1.0 - min(min(fromLine.x / lineWidth.x, fromLine.y / lineWidth.y), 1.0);
diffuseColor.rgb = mix(diffuseColor.rgb, lineColour, 0.6 * isLine);
diffuseColor.a *= 1.0 - smoothstep(0.35, 1.0, length(onTable) / tableRadius);
`;

export class Studio {
  /** Lights a scene around a sphere; `floor` is the height of the table [mm]. `draw` is called when the scheme changes. */
  constructor({ renderer, scene }, around, floor, draw) {
    this.scene = scene;
    renderer.toneMapping = NeutralToneMapping;
    renderer.shadowMap.enabled = true;
    renderer.shadowMap.type = PCFShadowMap;
    const generator = new PMREMGenerator(renderer);
    scene.environment = generator.fromScene(new RoomEnvironment(), 0.04, 0.1, 100, { size: ENVIRONMENT_PIXELS }).texture;
    scene.environmentRotation.x = Math.PI / 2; // its ceiling is along y, ours along z
    generator.dispose();
    this.key = keyLight(around);
    this.rim = new DirectionalLight(0xdfe9ff); // from behind, so that dark edges stand out from a dark page
    this.rim.position.copy(around.center).add({ x: -around.radius, y: around.radius, z: 0.15 * around.radius });
    this.rim.target = this.key.target;
    this.table = table(around, floor);
    scene.add(this.key, this.key.target, this.rim, this.table);
    this.motion = this.table.material.userData.motion;
    this.#setMood();
    DARK.addEventListener("change", () => {
      this.#setMood();
      draw();
    });
  }

  /** Slides the table away under a scene that rides on a part which has moved [mm]. */
  ride(motion) {
    this.motion.set(motion[0], motion[1]);
  }

  #setMood() {
    const mood = DARK.matches ? MOODS.dark : MOODS.light;
    this.scene.environmentIntensity = mood.environment;
    this.key.intensity = mood.key;
    this.key.shadow.intensity = mood.shadow;
    this.rim.intensity = mood.rim;
    this.table.material.color.set(mood.table);
    this.table.material.userData.line.set(mood.line);
  }
}

function keyLight(around) {
  const light = new DirectionalLight(0xfff4e6);
  const reach = 1.2 * around.radius;
  light.position.copy(around.center).add({ x: -0.9 * reach, y: -0.7 * reach, z: 2.2 * reach });
  light.target.position.copy(around.center);
  light.castShadow = true;
  light.shadow.mapSize.set(SHADOW_PIXELS, SHADOW_PIXELS);
  light.shadow.radius = 5;
  light.shadow.bias = -0.0005;
  light.shadow.normalBias = 0.05;
  Object.assign(light.shadow.camera, { left: -reach, right: reach, top: reach, bottom: -reach, near: 1, far: 6 * reach });
  return light;
}

function table(around, floor) {
  const radius = 3 * around.radius;
  const material = new MeshStandardMaterial({ transparent: true, roughness: 0.9, metalness: 0 });
  Object.assign(material.userData, { line: new Color(), motion: new Vector2() });
  material.onBeforeCompile = (shader) => {
    Object.assign(shader.uniforms, {
      lineColour: { value: material.userData.line },
      tableMotion: { value: material.userData.motion },
      tableRadius: { value: radius },
    });
    shader.vertexShader = shader.vertexShader
      .replace("#include <common>", "#include <common>\nvarying vec2 onTable;")
      .replace("#include <begin_vertex>", "#include <begin_vertex>\nonTable = position.xy;");
    shader.fragmentShader = shader.fragmentShader
      .replace("#include <common>", "#include <common>\nvarying vec2 onTable;\nuniform vec3 lineColour;\nuniform vec2 tableMotion;\nuniform float tableRadius;")
      .replace("#include <color_fragment>", TABLE_COLOUR);
  };
  const mesh = new Mesh(new CircleGeometry(radius, 64), material);
  mesh.position.set(around.center.x, around.center.y, floor - 0.05);
  mesh.receiveShadow = true;
  mesh.renderOrder = -1;
  return mesh;
}
