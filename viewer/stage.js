// The turnable scene of an episode: the gripper with both gels in colours, the held part, the fixed part cut open, the path.

import {
  BackSide,
  Box3,
  CatmullRomCurve3,
  EdgesGeometry,
  LineBasicMaterial,
  LineSegments,
  Matrix4,
  Mesh,
  MeshBasicMaterial,
  MeshStandardMaterial,
  Plane,
  Sphere,
  TubeGeometry,
  Vector3,
} from "three";

import LOOK from "../envs/playback_files/stage.json";
import { Forces } from "./forces.js";
import { GelSurface } from "./gel_surface.js";
import { cornersOf, Palm, sensorBody } from "./gripper.js";
import { label } from "./labels.js";
import { PartPressure } from "./pressure.js";
import { Studio } from "./studio.js";
import { framing, geometryOf, INK, View } from "./view.js";

// A part is drawn a little behind its edges, which lie in its faces and would be broken lines.
const BEHIND_EDGES = { flatShading: true, polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 1 };
const BEFORE_EDGES = { polygonOffset: true, polygonOffsetFactor: -1, polygonOffsetUnits: -4 }; // which a section hides
const HELD = { color: LOOK.held, roughness: 0.42, metalness: 0.35 };
const FIXED = { color: LOOK.fixed, roughness: 0.38, metalness: 0.7 };
const SHARP_DEG = 20; // from which on an edge is drawn
const GHOST = { color: 0x4f8fd6, transparent: true, opacity: 0.35, depthWrite: false };
const XRAY_OPACITY = 0.22;
const PATH = { color: 0xc2255c, radiusMm: 0.35, points: 8 };
const ROOM_AROUND_CONTACT = 0.45; // of the sphere around all

export class Stage extends View {
  /** `force` is that of the longest arrow [N]. Throws where the browser has no WebGL. */
  constructor(canvas, episode, force) {
    super(canvas);
    this.episode = episode;
    this.renderer.localClippingEnabled = true;
    this.pose = new Float32Array(12);
    this.isXray = this.looksAtGel = this.isCutOpen = this.isSection = false;
    this.gels = [0, 1].map((side) => new GelSurface(episode, side));
    const along = this.#palmSide();
    this.bodies = this.gels.map(() => sensorBody(episode.arrays.gel_nodes_mm.values, along));
    this.palm = new Palm(along);
    this.palm.mesh.geometry.computeBoundingBox();
    const { cut } = episode.header; // what is on the positive side of the plane is taken away
    this.planes = cut ? [new Plane(new Vector3(...cut.normal).negate(), cut.offset_mm)] : [];
    this.held = this.#held();
    this.forces = new Forces(this.scene, episode, force);
    this.fixed = this.#fixed();
    this.pressure = new PartPressure(episode);
    for (const { outside } of [this.held, this.fixed]) this.pressure.colour(outside);
    this.path = this.#path();
    const parts = this.#pointsOfParts();
    this.around = sphereAround(parts);
    const all = [...parts, ...this.#pointsOfGripper()];
    this.whole = framing(all, episode.header.view_deg);
    this.scene.add(...this.gels.map((gel) => gel.mesh), ...this.bodies, this.palm.mesh);
    this.studio = new Studio(this, sphereAround(all), new Box3().setFromObject(this.fixed.mesh).min.z, () => this.draw());
    this.lookAt(this.whole, episode.header.view_deg);
  }

  /** Shows a time, gels coloured by `displacement` or `pressure` from 0 to the largest value. */
  show(time, quantity, largest) {
    const place = this.episode.around(time);
    this.gels.forEach((gel, side) => {
      gel.show(place, quantity, largest);
      applyPose(gel.mesh, this.episode.sensorPose(place, side, this.pose));
      applyPose(this.bodies[side], this.pose);
    });
    this.palm.show(...this.gels.map((gel) => gel.mesh.matrix));
    placeHeld(this.held, this.episode, place, this.pose);
    this.#placeNames(this.episode.heldVertices(place));
    const shift = this.episode.fixedShift(place, this.pose);
    if (shift) this.studio.ride(shift);
    this.forces.show(place);
    this.pressure.show(place, quantity, largest);
    if (this.ghost) this.#showGhost(time);
    this.path?.geometry.setDrawRange(0, this.path.perMoment * (place.before + place.fraction));
    this.draw();
  }

  /** Draws, with arrows that point at the eye small. */
  draw() {
    this.forces?.face(this.camera.position);
    super.draw();
  }

  showForces(areShown) {
    this.forces.group.visible = areShown;
    this.draw();
  }

  showNames(areShown) {
    for (const name of this.names) name.visible = areShown;
    this.draw();
  }

  cutOpen(isOpen) {
    this.isCutOpen = isOpen;
    this.#cut();
    this.draw();
  }

  /** The fixed part is cut where that is asked for, and both parts in the section. */
  #cut() {
    this.fixed.cut(this.isCutOpen || this.isSection ? this.planes : []);
    this.held.cut(this.isSection ? this.planes : []);
  }

  /** Shows the held part like glass, so that what is behind and below it is seen. */
  xray(isOn) {
    this.isXray = isOn;
    this.#showGlass();
    this.draw();
  }

  /** The held part is like glass also where a gel is looked at from its other side. */
  #showGlass() {
    const { mesh, outside, cap } = this.held;
    const isOn = this.isXray || this.looksAtGel;
    Object.assign(outside, { transparent: isOn, opacity: isOn ? XRAY_OPACITY : 1, depthWrite: !isOn, needsUpdate: true });
    mesh.castShadow = cap.visible = !isOn;
  }

  /** Looks from a named place: `task`, `above`, `section`, `left` or `right`. */
  lookFrom(name) {
    const [side, other] = name === "left" ? [0, 1] : name === "right" ? [1, 0] : [];
    const isAbove = name === "above"; // where the gripper would hide the parts
    this.gels.forEach((gel, at) => {
      gel.mesh.visible = at !== other;
      this.bodies[at].visible = at !== other && !isAbove;
    });
    this.palm.mesh.visible = side === undefined && !isAbove;
    this.isSection = name === "section";
    this.#cut();
    this.looksAtGel = side !== undefined;
    this.#showGlass();
    this.flyTo(...this.#view(name, side));
  }

  /** Shows the held part of another episode with the same parts as a ghost. */
  addGhost(episode) {
    const held = this.#held(GHOST);
    held.mesh.castShadow = held.cap.visible = false;
    this.ghost = { episode, held };
  }

  #showGhost(time) {
    const { episode, held } = this.ghost;
    placeHeld(held, episode, episode.around(Math.min(time, episode.lastStep)), this.pose);
  }

  #view(name, side) {
    const [azimuth] = this.episode.header.view_deg;
    if (name === "above") return [this.around, [-90, 89]];
    if (name === "section") {
      const { x, y } = this.planes[0]?.normal ?? { x: -1, y: 0 };
      return [this.#contact(), [(Math.atan2(-y, -x) * 180) / Math.PI, 4]];
    }
    if (side === undefined) return [this.whole, this.episode.header.view_deg];
    const gel = this.gels[side].mesh.matrix;
    const away = new Vector3().setFromMatrixColumn(gel, 2);
    const sphere = new Sphere(new Vector3().setFromMatrixPosition(gel), 22);
    return [sphere, [(Math.atan2(away.y, away.x) * 180) / Math.PI || azimuth, (Math.asin(away.z) * 180) / Math.PI + 3]];
  }

  /** Where held and fixed part meet at the end of the episode. */
  #contact() {
    const held = this.#boxOfHeld(this.episode.times.length - 1);
    const common = held.clone().intersect(new Box3().setFromObject(this.fixed.mesh));
    return new Sphere((common.isEmpty() ? held : common).getCenter(new Vector3()), ROOM_AROUND_CONTACT * this.around.radius);
  }

  /** The end of the gels' x axis at which the palm is: away from the fixed part. */
  #palmSide() {
    const gel = matrixOf(this.episode.sensorPose({ before: 0, next: 0, fraction: 0 }, 0, this.pose));
    const fixed = new Box3().setFromArray(this.episode.arrays.fixed_vertices_mm.values).getCenter(new Vector3());
    const towards = fixed.sub(new Vector3().setFromMatrixPosition(gel));
    return towards.dot(new Vector3().setFromMatrixColumn(gel, 0)) > 0 ? -1 : 1;
  }

  #held(look = HELD) {
    const { held_vertices_mm: vertices, held_triangles: triangles } = this.episode.arrays;
    const own = { values: vertices.values.slice() }; // a soft part's move
    const held = solid(geometryOf(own, triangles), look, LOOK.held_section);
    Object.assign(held.mesh, { matrixAutoUpdate: false, renderOrder: 1 });
    if (look === HELD) this.names = this.#names(vertices.values);
    if (look === HELD && this.names.length) held.mesh.add(...this.names); // three complains where nothing is added
    this.scene.add(held.mesh);
    return held;
  }

  #fixed() {
    const { fixed_vertices_mm: vertices, fixed_triangles: triangles } = this.episode.arrays;
    const fixed = solid(geometryOf(vertices, triangles), FIXED, LOOK.fixed_section);
    this.scene.add(fixed.mesh);
    return fixed;
  }

  /** The middle between both sensors, as far as the episode is played; nothing where it never moves. */
  #path() {
    const poses = this.episode.arrays.sensor_poses.values;
    const middles = Array.from(this.episode.times, (_, moment) =>
      new Vector3(...[0, 1, 2].map((axis) => 0.5 * (poses[24 * moment + 9 + axis] + poses[24 * moment + 21 + axis]))),
    );
    if (middles.every((point) => point.distanceTo(middles[0]) < PATH.radiusMm)) return null;
    const pieces = 4 * (middles.length - 1);
    const geometry = new TubeGeometry(new CatmullRomCurve3(middles, false, "centripetal"), pieces, PATH.radiusMm, PATH.points);
    const mesh = new Mesh(geometry, new MeshBasicMaterial({ color: PATH.color, depthTest: false, transparent: true, opacity: 0.85 }));
    mesh.renderOrder = 2;
    this.scene.add(mesh);
    return { geometry, perMoment: geometry.index.count / (middles.length - 1) };
  }

  #boxOfHeld(moment) {
    return new Box3().setFromPoints(this.#pointsOfHeld(moment));
  }

  #pointsOfHeld(moment) {
    const place = { before: moment, next: moment, fraction: 0 };
    const matrix = matrixOf(this.episode.heldPose(place, this.pose));
    return pointsOf(this.episode.heldVertices(place)).map((point) => point.applyMatrix4(matrix));
  }

  /** The fixed part, and the held part at both ends. */
  #pointsOfParts() {
    return [...pointsOf(this.episode.arrays.fixed_vertices_mm.values), ...this.#ends().flatMap((moment) => this.#pointsOfHeld(moment))];
  }

  /** The gripper at both ends; its parts must not be in the scene yet. */
  #pointsOfGripper() {
    return this.#ends().flatMap((moment) => {
      const place = { before: moment, next: moment, fraction: 0 };
      const gels = [0, 1].map((side) => matrixOf(this.episode.sensorPose(place, side, this.pose)));
      this.palm.show(...gels);
      this.palm.mesh.updateMatrix();
      const palm = cornersOf(this.palm.mesh.geometry.boundingBox, this.palm.mesh.matrix);
      return [...palm, ...this.bodies.flatMap((body, side) => cornersOf(new Box3().setFromObject(body), gels[side]))];
    });
  }

  #ends() {
    return [0, this.episode.times.length - 1];
  }

  /** Numbers at the points of the held part by which success is judged. */
  #names(own) {
    return this.#measured().map((vertex, at) => label(at, own.subarray(3 * vertex, 3 * vertex + 3)));
  }

  /** Puts the numbers where the points are in the part's own frame. */
  #placeNames(own) {
    this.#measured().forEach((vertex, at) => this.names[at].position.fromArray(own, 3 * vertex));
  }

  #measured() {
    return Array.from(this.episode.arrays.measured_vertices?.values ?? []);
  }
}

function sphereAround(points) {
  return new Box3().setFromPoints(points).getBoundingSphere(new Sphere());
}

/** A part with its edges. Where planes cut it, its faces are seen from inside: those are drawn as the section's surface. */
function solid(geometry, look, section) {
  const outside = new MeshStandardMaterial({ ...BEHIND_EDGES, ...look });
  const inside = new MeshBasicMaterial({ ...BEFORE_EDGES, color: section, side: BackSide });
  const lines = new LineBasicMaterial({ color: INK, transparent: true, opacity: 0.55 });
  const mesh = new Mesh(geometry, outside);
  const cap = new Mesh(geometry, inside);
  const edges = new LineSegments(new EdgesGeometry(geometry, SHARP_DEG), lines);
  mesh.add(cap, edges);
  Object.assign(mesh, { castShadow: true, receiveShadow: true });
  return { mesh, outside, cap, edges, cut: (planes) => [outside, inside, lines].forEach((material) => (material.clippingPlanes = planes)) };
}

/** Places a held part, and deforms it where it is soft. */
function placeHeld({ mesh, edges }, episode, place, pose) {
  applyPose(mesh, episode.heldPose(place, pose));
  if (!episode.arrays.held_displacements) return;
  const positions = mesh.geometry.getAttribute("position");
  positions.copyArray(episode.heldVertices(place));
  positions.needsUpdate = true;
  edges.geometry.dispose();
  edges.geometry = new EdgesGeometry(mesh.geometry, SHARP_DEG);
}

function matrixOf(pose, made = new Matrix4()) {
  const [a, b, c, d, e, f, g, h, i, x, y, z] = pose;
  return made.set(a, b, c, x, d, e, f, y, g, h, i, z, 0, 0, 0, 1);
}

function pointsOf(values) {
  return Array.from({ length: values.length / 3 }, (_, at) => new Vector3().fromArray(values, 3 * at));
}

function applyPose(object, pose) {
  matrixOf(pose, object.matrix);
  object.matrixWorldNeedsUpdate = true;
}
