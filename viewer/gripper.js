// The gripper in the scene: behind each gel the housing of its sensor and a finger, and the palm that joins both fingers.
// The policy and the physics know none of it; sizes are those of a GelSight Mini, rounded, with a finger that is shortened, so that
// the parts are large in the picture.

import { BoxGeometry, Group, Mesh, MeshStandardMaterial, Quaternion, Vector3 } from "three";
import { RoundedBoxGeometry } from "three/addons/geometries/RoundedBoxGeometry.js";

import LOOK from "../envs/playback_files/stage.json";

const SHELL = { color: LOOK.shell, roughness: 0.6, metalness: 0.1 };
const METAL = { color: LOOK.metal, roughness: 0.4, metalness: 0.6 };

/** Housing and finger in the frame of a gel, whose back face looks along its negative z axis; `along` is 1 or -1: the end of
 * the x axis at which the palm is. */
export function sensorBody(gelNodes, along) {
  const body = new Group();
  const back = Math.min(...gelNodes.filter((_, at) => at % 3 === 2));
  const [length, width, depth] = LOOK.housing_mm;
  const [rim, inset] = [LOOK.rim_mm, 2 * LOOK.rim_inset_mm];
  const housing = part(new RoundedBoxGeometry(length, width, depth, 3, 3), SHELL);
  housing.position.z = back - 0.5 * depth - rim;
  const frame = part(new BoxGeometry(length - inset, width - inset, rim), METAL);
  frame.position.z = back - 0.5 * rim;
  const finger = part(new RoundedBoxGeometry(...LOOK.finger_mm, 2, 2), METAL);
  finger.position.set(along * (0.5 * (length + LOOK.finger_mm[0]) - LOOK.finger_overlap_mm), 0, back - rim - LOOK.finger_depth * depth);
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
    this.mesh.position.copy(middle).addScaledVector(x, this.along * (0.5 * LOOK.housing_mm[0] + LOOK.finger_mm[0] - LOOK.palm_overlap_mm));
    this.mesh.quaternion.copy(new Quaternion().setFromRotationMatrix(left));
    this.mesh.scale.set(...LOOK.palm_mm, first.distanceTo(second) + 2 * LOOK.housing_mm[2]);
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
