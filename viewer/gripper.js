// The gripper in the scene: behind each gel the housing of its sensor and a finger, and the palm that joins both fingers.
// The policy and the physics know none of it; sizes are those of a GelSight Mini, rounded.

import { BoxGeometry, Group, Mesh, MeshStandardMaterial, Quaternion, Vector3 } from "three";
import { RoundedBoxGeometry } from "three/addons/geometries/RoundedBoxGeometry.js";

const HOUSING_MM = [31, 26, 13];
const RIM_MM = 1.5; // of the frame around the back face
const FINGER_MM = [26, 15, 7]; // shortened, so that the parts are large in the picture
const PALM_MM = [12, 34];
const SHELL = { color: 0x515a63, roughness: 0.6, metalness: 0.1 };
const METAL = { color: 0x9aa3ab, roughness: 0.4, metalness: 0.6 };

/** Housing and finger in the frame of a gel, whose back face looks along its negative z axis; `along` is 1 or -1: the end of
 * the x axis at which the palm is. */
export function sensorBody(gelNodes, along) {
  const body = new Group();
  const back = Math.min(...gelNodes.filter((_, at) => at % 3 === 2));
  const [length, width, depth] = HOUSING_MM;
  const housing = part(new RoundedBoxGeometry(length, width, depth, 3, 3), SHELL);
  housing.position.z = back - 0.5 * depth - RIM_MM;
  const frame = part(new BoxGeometry(length - 3, width - 3, RIM_MM), METAL);
  frame.position.z = back - 0.5 * RIM_MM;
  const finger = part(new RoundedBoxGeometry(...FINGER_MM, 2, 2), METAL);
  finger.position.set(along * (0.5 * (length + FINGER_MM[0]) - 6), 0, back - RIM_MM - 0.6 * depth);
  body.add(housing, frame, finger);
  body.matrixAutoUpdate = false;
  return body;
}

export class Palm {
  constructor(along) {
    this.along = along;
    this.mesh = part(new RoundedBoxGeometry(1, 1, 1, 2, 0.05), SHELL);
  }

  /** Puts the palm at the ends of both fingers, whose sensors have these poses as matrices. */
  show(left, right) {
    const [first, second] = [left, right].map((matrix) => new Vector3().setFromMatrixPosition(matrix));
    const middle = first.clone().add(second).multiplyScalar(0.5);
    const x = new Vector3().setFromMatrixColumn(left, 0);
    this.mesh.position.copy(middle).addScaledVector(x, this.along * (0.5 * HOUSING_MM[0] + FINGER_MM[0] - 2));
    this.mesh.quaternion.copy(new Quaternion().setFromRotationMatrix(left));
    this.mesh.scale.set(PALM_MM[0], PALM_MM[1], first.distanceTo(second) + 2 * HOUSING_MM[2]);
  }
}

/** The corners of a box that a matrix places. */
export function cornersOf({ min, max }, matrix) {
  return [min.x, max.x].flatMap((x) => [min.y, max.y].flatMap((y) => [min.z, max.z].map((z) => new Vector3(x, y, z).applyMatrix4(matrix))));
}

function part(geometry, look) {
  const mesh = new Mesh(geometry, new MeshStandardMaterial(look));
  mesh.castShadow = true;
  mesh.receiveShadow = true;
  return mesh;
}
