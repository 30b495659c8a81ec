// The turnable scene: both gels in colours, the held part like glass, the fixed part cut open, the gripper's path.

import {
  Box3,
  BufferAttribute,
  BufferGeometry,
  Color,
  DoubleSide,
  EdgesGeometry,
  Line,
  LineBasicMaterial,
  LineSegments,
  Matrix4,
  Mesh,
  MeshStandardMaterial,
  Plane,
  Sphere,
  SRGBColorSpace,
  Vector3,
} from "three";

import { scale } from "./colours.js";
import { geometryOf, INK, View } from "./view.js";

export class Stage extends View {
  /** Throws where the browser has no WebGL. */
  constructor(canvas, episode) {
    super(canvas);
    this.episode = episode;
    this.renderer.localClippingEnabled = true;
    this.palettes = { displacement: linearScale("displacement"), pressure: linearScale("pressure") };
    this.gels = [0, 1].map(() => this.#gel());
    this.held = this.#held();
    this.fixed = this.#fixed();
    this.path = this.#path();
    this.#lookFromTheTasksSide();
    this.pose = new Float32Array(12);
    this.moved = new Float32Array(3 * episode.nodes);
    this.pressed = new Float32Array(episode.sensing);
  }

  /** Shows a time, gels coloured by `displacement` or `pressure` from 0 to the largest value. */
  show(time, quantity, largest) {
    const place = this.episode.around(time);
    this.gels.forEach((gel, side) => this.#moveGel(gel, place, side, quantity, largest));
    applyPose(this.held, this.episode.heldPose(place, this.pose));
    this.path.done.geometry.setDrawRange(0, place.next + 1);
    this.draw();
  }

  cutOpen(isOpen) {
    this.fixed.material.clippingPlanes = isOpen ? this.fixed.planes : [];
    this.fixed.lines.clippingPlanes = isOpen ? this.fixed.planes : [];
    this.draw();
  }

  #gel() {
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(new Float32Array(3 * this.episode.nodes), 3));
    geometry.setAttribute("color", new BufferAttribute(new Float32Array(3 * this.episode.nodes), 3));
    geometry.setIndex(new BufferAttribute(this.episode.arrays.gel_triangles.values, 1));
    const mesh = new Mesh(geometry, new MeshStandardMaterial({ vertexColors: true, roughness: 0.85, flatShading: true }));
    mesh.frustumCulled = false;
    this.scene.add(mesh);
    return mesh;
  }

  #held() {
    const { held_vertices_mm: vertices, held_triangles: triangles } = this.episode.arrays;
    const material = new MeshStandardMaterial({ color: 0x7d93a8, transparent: true, opacity: 0.55, flatShading: true });
    const mesh = new Mesh(geometryOf(vertices, triangles), material);
    mesh.add(new LineSegments(new EdgesGeometry(mesh.geometry), new LineBasicMaterial({ color: INK })));
    mesh.matrixAutoUpdate = false;
    mesh.renderOrder = 1;
    this.scene.add(mesh);
    return mesh;
  }

  #fixed() {
    const { fixed_vertices_mm: vertices, fixed_triangles: triangles } = this.episode.arrays;
    const material = new MeshStandardMaterial({ color: 0xb9bfc6, roughness: 0.9, side: DoubleSide, flatShading: true });
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

  #moveGel(gel, place, side, quantity, largest) {
    const { nodes, arrays } = this.episode;
    this.episode.displacements(place, side, this.moved);
    const positions = gel.geometry.attributes.position.array;
    const rest = arrays.gel_nodes_mm.values;
    const [a, b, c, d, e, f, g, h, i, x, y, z] = this.episode.sensorPose(place, side, this.pose);
    for (let index = 0; index < 3 * nodes; index += 3) {
      const u = rest[index] + this.moved[index];
      const v = rest[index + 1] + this.moved[index + 1];
      const w = rest[index + 2] + this.moved[index + 2];
      positions[index] = a * u + b * v + c * w + x;
      positions[index + 1] = d * u + e * v + f * w + y;
      positions[index + 2] = g * u + h * v + i * w + z;
    }
    gel.geometry.attributes.position.needsUpdate = true;
    this.#colourGel(gel, place, side, quantity, largest);
  }

  #colourGel(gel, place, side, quantity, largest) {
    const colours = gel.geometry.attributes.color.array;
    const paint = (node, value) => {
      const level = Math.round(255 * Math.min(1, Math.max(0, value / largest)));
      colours.set(this.palettes[quantity][level], 3 * node);
    };
    if (quantity === "pressure") {
      for (let node = 0; node < this.episode.nodes; node += 1) paint(node, 0);
      const sensing = this.episode.arrays.sensing_nodes.values;
      this.episode.pressures(place, side, this.pressed).forEach((value, index) => paint(sensing[index], value));
    } else {
      for (let node = 0; node < this.episode.nodes; node += 1) {
        paint(node, Math.hypot(this.moved[3 * node], this.moved[3 * node + 1], this.moved[3 * node + 2]));
      }
    }
    gel.geometry.attributes.color.needsUpdate = true;
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

function matrixOf([a, b, c, d, e, f, g, h, i, x, y, z]) {
  return new Matrix4(a, b, c, x, d, e, f, y, g, h, i, z, 0, 0, 0, 1);
}

function eachPoint(values, use) {
  for (let at = 0; at < values.length; at += 3) use(new Vector3(values[at], values[at + 1], values[at + 2]));
}

function applyPose(mesh, pose) {
  mesh.matrix.copy(matrixOf(pose));
  mesh.matrixWorldNeedsUpdate = true;
}

function linearScale(name) {
  return scale(name).map(([red, green, blue]) =>
    new Color().setRGB(red / 255, green / 255, blue / 255, SRGBColorSpace).toArray(),
  );
}
