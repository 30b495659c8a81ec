// The turnable scene: both gels in colours, the held part like glass, the fixed part cut open, the gripper's path.

import {
  Box3,
  BufferAttribute,
  BufferGeometry,
  DoubleSide,
  EdgesGeometry,
  Line,
  LineBasicMaterial,
  LineSegments,
  Matrix4,
  Mesh,
  MeshLambertMaterial,
  Plane,
  Sphere,
  Vector3,
} from "three";

import { GelSurface } from "./gel_surface.js";
import { geometryOf, INK, View } from "./view.js";

// A part is drawn a little behind its edges, which lie in its faces and would be broken lines.
const BEHIND_EDGES = { flatShading: true, polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 1 };

export class Stage extends View {
  /** Throws where the browser has no WebGL. */
  constructor(canvas, episode) {
    super(canvas);
    this.episode = episode;
    this.renderer.localClippingEnabled = true;
    this.gels = [0, 1].map((side) => new GelSurface(episode, side));
    for (const gel of this.gels) this.scene.add(gel.mesh);
    this.held = this.#held();
    this.fixed = this.#fixed();
    this.path = this.#path();
    this.#lookFromTheTasksSide();
    this.pose = new Float32Array(12);
  }

  /** Shows a time, gels coloured by `displacement` or `pressure` from 0 to the largest value. */
  show(time, quantity, largest) {
    const place = this.episode.around(time);
    this.gels.forEach((gel, side) => {
      gel.show(place, quantity, largest);
      applyPose(gel.mesh, this.episode.sensorPose(place, side, this.pose));
    });
    applyPose(this.held, this.episode.heldPose(place, this.pose));
    this.path.done.geometry.setDrawRange(0, place.next + 1);
    this.draw();
  }

  cutOpen(isOpen) {
    this.fixed.material.clippingPlanes = isOpen ? this.fixed.planes : [];
    this.fixed.lines.clippingPlanes = isOpen ? this.fixed.planes : [];
    this.draw();
  }

  #held() {
    const { held_vertices_mm: vertices, held_triangles: triangles } = this.episode.arrays;
    const material = new MeshLambertMaterial({ ...BEHIND_EDGES, color: 0x7d93a8, transparent: true, opacity: 0.55 });
    const mesh = new Mesh(geometryOf(vertices, triangles), material);
    mesh.add(new LineSegments(new EdgesGeometry(mesh.geometry), new LineBasicMaterial({ color: INK })));
    mesh.matrixAutoUpdate = false;
    mesh.renderOrder = 1;
    this.scene.add(mesh);
    return mesh;
  }

  #fixed() {
    const { fixed_vertices_mm: vertices, fixed_triangles: triangles } = this.episode.arrays;
    const material = new MeshLambertMaterial({ ...BEHIND_EDGES, color: 0xb9bfc6, side: DoubleSide });
    const lines = new LineBasicMaterial({ color: INK });
    const mesh = new Mesh(geometryOf(vertices, triangles), material);
    mesh.add(new LineSegments(new EdgesGeometry(mesh.geometry), lines));
    this.scene.add(mesh);
    const cut = this.episode.header.cut;
    // What is on the positive side is taken away.
    const planes = cut ? [new Plane(new Vector3(...cut.normal).negate(), cut.offset_mm)] : [];
    material.clippingPlanes = planes;
    lines.clippingPlanes = planes;
    return { mesh, material, lines, planes };
  }

  /** The middle between both sensors over the episode, faint, and stronger as far as it is played. */
  #path() {
    const poses = this.episode.arrays.sensor_poses.values;
    const middles = new Float32Array(3 * this.episode.times.length);
    for (let moment = 0; moment < this.episode.times.length; moment += 1) {
      for (let axis = 0; axis < 3; axis += 1) {
        middles[3 * moment + axis] = 0.5 * (poses[24 * moment + 9 + axis] + poses[24 * moment + 21 + axis]);
      }
    }
    const line = (opacity) => {
      const geometry = new BufferGeometry();
      geometry.setAttribute("position", new BufferAttribute(middles, 3));
      const material = new LineBasicMaterial({ color: 0xc2255c, transparent: true, opacity, depthTest: false });
      const drawn = new Line(geometry, material);
      drawn.renderOrder = 2;
      this.scene.add(drawn);
      return drawn;
    };
    return { whole: line(0.3), done: line(1) };
  }

  /** From where `vitac show` looks, with room for all that moves and for what is left of the fixed part. */
  #lookFromTheTasksSide() {
    const box = new Box3();
    const { fixed_vertices_mm: fixed, held_vertices_mm: held } = this.episode.arrays;
    eachPoint(fixed.values, (point) => {
      if (this.fixed.planes.every((plane) => plane.distanceToPoint(point) >= 0)) box.expandByPoint(point);
    });
    for (const at of [0, this.episode.times.length - 1]) {
      const place = { before: at, next: at, fraction: 0 };
      const pose = matrixOf(this.episode.heldPose(place, new Float32Array(12)));
      eachPoint(held.values, (point) => box.expandByPoint(point.applyMatrix4(pose)));
    }
    const around = box.getBoundingSphere(new Sphere());
    this.lookAt(around, this.episode.header.view_deg);
  }
}

function matrixOf(pose, made = new Matrix4()) {
  const [a, b, c, d, e, f, g, h, i, x, y, z] = pose;
  return made.set(a, b, c, x, d, e, f, y, g, h, i, z, 0, 0, 0, 1);
}

function eachPoint(values, use) {
  for (let at = 0; at < values.length; at += 3) use(new Vector3(values[at], values[at + 1], values[at + 2]));
}

function applyPose(mesh, pose) {
  matrixOf(pose, mesh.matrix);
  mesh.matrixWorldNeedsUpdate = true;
}
