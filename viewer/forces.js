// Contact forces on the held part as arrows whose tips are where they act: of both gels, and of the fixed part where it touches.

import { ConeGeometry, CylinderGeometry, Group, Mesh, MeshBasicMaterial, Vector3 } from "three";

const COLOURS = { gel: "#8a63ff", fixed: "#f76707" }; // as in player.css
export const GELS = 2; // the first arrows of a moment
const LONGEST_MM = 22;
const SHORTEST_MM = 0.6; // a shorter arrow is only its head, and is left out
const THICK_MM = 0.35;
const HEAD_MM = [1.1, 3]; // radius and length
const NICE_N = [1, 2, 5, 10, 20, 50, 100, 200, 500];
const ALONG = new Vector3(0, 1, 0); // of the geometries

export class Forces {
  /** `most` is the force of the longest arrow [N], the same in all scenes of a page. */
  constructor(scene, { arrays }, most) {
    this.places = arrays.arrow_places_mm;
    this.forces = arrays.arrow_forces_n;
    this.perMoment = this.places?.shape[1] ?? 0;
    this.mmPerN = LONGEST_MM / Math.max(1, most);
    const shaft = new CylinderGeometry(THICK_MM, THICK_MM, 1, 12).translate(0, -0.5, 0);
    const head = new ConeGeometry(...HEAD_MM, 16).translate(0, -0.5 * HEAD_MM[1], 0);
    this.arrows = Array.from({ length: this.perMoment }, (_, at) => arrow(shaft, head, at < GELS ? COLOURS.gel : COLOURS.fixed));
    this.group = new Group();
    this.group.add(...this.arrows);
    scene.add(this.group);
  }

  /** A round force and how long its arrow is, for a legend; nothing where the file has no forces. */
  get scale() {
    if (!this.perMoment) return null;
    const force = NICE_N.findLast((round) => round * this.mmPerN <= 0.5 * LONGEST_MM) ?? NICE_N[0];
    return { force, length: force * this.mmPerN };
  }

  /** Shows the moment that is nearer, since places come and go between two. */
  show({ before, next, fraction }) {
    const moment = fraction < 0.5 ? before : next;
    this.arrows.forEach((found, at) => {
      const first = 3 * (this.perMoment * moment + at);
      const force = new Vector3().fromArray(this.forces.values, first);
      const length = force.length() * this.mmPerN;
      found.visible = length >= SHORTEST_MM;
      found.position.fromArray(this.places.values, first);
      found.quaternion.setFromUnitVectors(ALONG, force.normalize());
      found.userData.shaft.scale.y = Math.max(0.01, length - HEAD_MM[1]);
      found.userData.shaft.visible = length > HEAD_MM[1];
      found.userData.head.scale.setScalar(Math.min(1, length / HEAD_MM[1]));
    });
  }

  /** Makes arrows thin that point at the eye or away from it. */
  face(eye) {
    for (const found of this.arrows) {
      const along = ALONG.clone().applyQuaternion(found.quaternion);
      const slant = found.position.clone().sub(eye).normalize().cross(along).length(); // the sine of the angle between
      const thickness = Math.max(END_ON, Math.min(1, 2 * slant));
      found.scale.set(thickness, 1, thickness);
    }
  }
}

/** How thick an arrow is that is seen from its end, where it would be a blob that hides what it points at. */
const END_ON = 0.3;

/** An arrow along y whose tip is at its origin; seen through everything, as contacts lie inside. */
function arrow(shaft, head, color) {
  const material = new MeshBasicMaterial({ color, depthTest: false, transparent: true, toneMapped: false });
  const parts = { shaft: new Mesh(shaft, material), head: new Mesh(head, material) };
  parts.shaft.position.y = -HEAD_MM[1];
  for (const part of Object.values(parts)) part.renderOrder = 3;
  const made = new Group().add(parts.shaft, parts.head);
  made.userData = parts;
  return made;
}

/** The largest force that is shown in an episode [N]. */
export function largestForce({ arrays: { arrow_forces_n: forces } }) {
  let most = 0;
  for (let at = 0; at < (forces?.values.length ?? 0); at += 3) most = Math.max(most, Math.hypot(...forces.values.subarray(at, at + 3)));
  return most;
}
