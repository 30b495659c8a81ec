// Contact pressure on the held and the fixed part: each contact's force spread over a disc, in the colours of the gels.

import { GELS } from "./forces.js";
import { textureOf } from "./gel_surface.js";
import { LEVELS } from "./colours.js";

export const SPREAD_MM = 2; // radius; contacts so near to one another are one arrow (envs/playback_files/scene.py)
const KPA = 1000; // of 1 N/mm²
const FAINT = 0.08; // part of the scale below which a colour fades into that of the part

export class PartPressure {
  constructor({ arrays }) {
    this.places = arrays.arrow_places_mm?.values;
    this.forces = arrays.arrow_forces_n?.values;
    this.perMoment = arrays.arrow_places_mm?.shape[1] ?? GELS;
    this.count = this.perMoment - GELS;
    this.uniforms = {
      contacts: { value: new Float32Array(4 * Math.max(1, this.count)) }, // place [mm] and pressure in the middle [kPa]
      largest: { value: 1 },
      showsPressure: { value: false },
      colourScale: { value: textureOf("pressure") },
    };
  }

  /** Colours what has this material. */
  colour(material) {
    if (this.count < 1) return;
    material.onBeforeCompile = (shader) => {
      Object.assign(shader.uniforms, this.uniforms);
      shader.vertexShader = `varying vec3 onPart;\n${shader.vertexShader}`.replace(
        "#include <begin_vertex>",
        "#include <begin_vertex>\nonPart = (modelMatrix * vec4(transformed, 1.0)).xyz;",
      );
      shader.fragmentShader = `${MEANINGS(this.count)}${shader.fragmentShader}`.replace("#include <color_fragment>", COLOUR(this.count));
    };
  }

  /** Shows the moment that is nearer, as the arrows do. The pressure falls from the middle of a disc to 0 at its edge. */
  show({ before, next, fraction }, quantity, largest) {
    this.uniforms.showsPressure.value = quantity === "pressure";
    this.uniforms.largest.value = largest;
    const first = this.perMoment * (fraction < 0.5 ? before : next) + GELS;
    for (let at = 0; at < this.count; at += 1) {
      const from = 3 * (first + at);
      const force = Math.hypot(...this.forces.subarray(from, from + 3));
      this.uniforms.contacts.value.set([...this.places.subarray(from, from + 3), (KPA * 2 * force) / (Math.PI * SPREAD_MM ** 2)], 4 * at);
    }
  }
}

const MEANINGS = (count) => `
varying vec3 onPart;
uniform vec4 contacts[${count}];
uniform float largest;
uniform bool showsPressure;
uniform sampler2D colourScale;
`;
const COLOUR = (count) => `
#include <color_fragment>
if (showsPressure) {
  float pressure = 0.0;
  for (int at = 0; at < ${count}; at += 1) {
    vec3 away = onPart - contacts[at].xyz;
    pressure += contacts[at].w * max(0.0, 1.0 - dot(away, away) / ${(SPREAD_MM ** 2).toFixed(1)});
  }
  float part = clamp(pressure / largest, 0.0, 1.0);
  vec3 colour = texelFetch(colourScale, ivec2(int(part * ${LEVELS - 1}.0 + 0.5), 0), 0).rgb;
  diffuseColor.rgb = mix(diffuseColor.rgb, colour, smoothstep(0.0, ${FAINT}, part));
}
`;
