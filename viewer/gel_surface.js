// The surface of a gel in the scene. The graphics card bends and colours it; a moment of the episode is sent to it once.

import { BufferAttribute, BufferGeometry, DataTexture, Mesh, MeshStandardMaterial, NearestFilter, RGBAFormat, SRGBColorSpace } from "three";

import { LEVELS, scale } from "./colours.js";

const PARTS = 4; // displacement, three numbers, and contact pressure of a node, in the units of the file
const MEANINGS = `
attribute vec4 before;
attribute vec4 next;
uniform float fraction;
uniform vec2 units;
uniform float largest;
uniform bool showsPressure;
uniform sampler2D colourScale;
`;
const BEND = `
vec4 state = mix(before, next, fraction) * vec4(units.xxx, units.y);
vec3 transformed = position + state.xyz;
float value = showsPressure ? state.w : length(state.xyz);
int level = int(clamp(value / largest, 0.0, 1.0) * ${LEVELS - 1}.0 + 0.5);
vColor.rgb = texelFetch(colourScale, ivec2(level, 0), 0).rgb;
`;

export class GelSurface {
  /** The gel of the left sensor, side 0, or of the right one. */
  constructor(episode, side) {
    this.episode = episode;
    this.side = side;
    this.scales = { displacement: textureOf("displacement"), pressure: textureOf("pressure") };
    this.uniforms = {
      fraction: { value: 0 },
      units: { value: [episode.header.displacement_unit_mm, episode.header.pressure_unit_kpa] },
      largest: { value: 1 },
      showsPressure: { value: false },
      colourScale: { value: this.scales.displacement },
    };
    const material = new MeshStandardMaterial({ vertexColors: true, flatShading: true, roughness: 0.5 });
    material.onBeforeCompile = (shader) => {
      Object.assign(shader.uniforms, this.uniforms);
      shader.vertexShader = MEANINGS + shader.vertexShader.replace("#include <begin_vertex>", BEND);
    };
    this.geometry = new BufferGeometry();
    this.geometry.setAttribute("position", new BufferAttribute(episode.arrays.gel_nodes_mm.values, 3));
    this.geometry.setIndex(new BufferAttribute(episode.arrays.gel_triangles.values, 1));
    this.states = [0, 1].map(() => ({ moment: undefined, attribute: new BufferAttribute(new Float32Array(PARTS * episode.nodes), PARTS) }));
    this.mesh = new Mesh(this.geometry, material);
    this.mesh.frustumCulled = false;
    this.mesh.receiveShadow = true;
    this.mesh.matrixAutoUpdate = false;
  }

  /** Shows a place between two moments, coloured by `displacement` or `pressure` from 0 to the largest value. */
  show({ before, next, fraction }, quantity, largest) {
    if (this.states[1].moment === before) this.states.reverse();
    [before, next].forEach((moment, at) => this.#fill(this.states[at], moment));
    this.geometry.attributes.before = this.states[0].attribute;
    this.geometry.attributes.next = this.states[1].attribute;
    this.uniforms.fraction.value = fraction;
    this.uniforms.largest.value = largest;
    this.uniforms.showsPressure.value = quantity === "pressure";
    this.uniforms.colourScale.value = this.scales[quantity];
  }

  #fill(state, moment) {
    if (state.moment === moment) return;
    state.moment = moment;
    const { nodes, sensing, arrays } = this.episode;
    const values = state.attribute.array;
    const moved = arrays.displacements.values;
    const pressures = arrays.pressures.values;
    const firstNode = 3 * nodes * (2 * moment + this.side);
    for (let node = 0; node < nodes; node += 1) {
      for (let axis = 0; axis < 3; axis += 1) values[PARTS * node + axis] = moved[firstNode + 3 * node + axis];
    }
    const firstPressure = sensing * (2 * moment + this.side);
    for (let at = 0; at < sensing; at += 1) {
      values[PARTS * arrays.sensing_nodes.values[at] + 3] = pressures[firstPressure + at];
    }
    state.attribute.needsUpdate = true;
  }
}

/** The colours of a scale, in one row. */
export function textureOf(name) {
  const pixels = new Uint8Array(scale(name).flatMap((colour) => [...colour, 255]));
  const texture = new DataTexture(pixels, LEVELS, 1, RGBAFormat);
  texture.colorSpace = SRGBColorSpace;
  texture.magFilter = texture.minFilter = NearestFilter;
  texture.needsUpdate = true;
  return texture;
}
