// A turnable picture of a scene: camera, pointer and keys. What is in it is added by stage.js and gel.js, and lit by studio.js.

import { BufferAttribute, BufferGeometry, PerspectiveCamera, Scene, Vector3, WebGLRenderer } from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";

import LOOK from "../envs/playback_files/stage.json";
import { Resolution } from "./resolution.js";

const FIELD_OF_VIEW_DEG = 28;
const TURN_RAD = Math.PI / 36;
const FILLED = 0.9; // of the picture by what is looked at
const NARROWEST = 1.5; // width of a picture by its height, down to which all is in it
const LOWEST_RAD = 0.05;
const ZOOM = 1.1;
const FLIGHT_MS = 300;
const PIXELS_ACROSS = 2; // for each of the page's, which smooths edges as multisampling would, but can be lowered
const STILL_MS = 300; // without a change, until the scene is drawn in full resolution
export const INK = LOOK.ink;

export class View {
  /** Throws where the browser has no WebGL. */
  constructor(canvas) {
    this.canvas = canvas;
    const context = canvas.getContext("webgl2", { alpha: true, antialias: false });
    if (!context) throw new Error("no WebGL");
    this.renderer = new WebGLRenderer({ canvas, context });
    this.camera = new PerspectiveCamera(FIELD_OF_VIEW_DEG, 4 / 3, 1, 2000);
    this.camera.up.set(0, 0, 1);
    this.scene = new Scene();
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.listenToKeyEvents(canvas);
    this.controls.keys = {}; // ours turn instead of moving
    this.controls.addEventListener("change", () => this.draw());
    canvas.addEventListener("keydown", (event) => this.#turnByKey(event));
    this.resolution = new Resolution();
    this.drawnPart = 0;
    this.isHeld = false;
    this.frame = undefined; // that is asked for
    this.lastFrame = undefined;
    this.whenStill = undefined;
    new ResizeObserver(() => this.#fit()).observe(canvas.parentElement);
    canvas.addEventListener("webglcontextrestored", () => this.#fit()); // after a driver's restart the canvas is empty
  }

  /** Whether nothing is drawn but pictures that are asked for. */
  holdStill(isHeld) {
    this.isHeld = isHeld;
    if (!isHeld) this.#fit();
  }

  /** The canvas with a picture of a size for this moment: the next one comes into it, too. */
  picture(width, height) {
    this.renderer.setPixelRatio(PIXELS_ACROSS);
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.renderer.render(this.scene, this.camera);
    return this.canvas;
  }

  /** Draws before the browser shows its next frame, once for all that changes until then. */
  draw() {
    if (this.isHeld) return;
    this.frame ??= requestAnimationFrame((now) => this.#inMotion(now));
  }

  #inMotion(now) {
    this.frame = undefined;
    if (this.isHeld) return;
    if (this.lastFrame !== undefined) this.resolution.took(now - this.lastFrame);
    this.lastFrame = now;
    this.#render(this.resolution.part);
    clearTimeout(this.whenStill);
    this.whenStill = setTimeout(() => this.#still(), STILL_MS);
  }

  #still() {
    if (this.frame !== undefined || this.isHeld) return; // it moves on, but slowly
    this.lastFrame = undefined;
    this.resolution.rest();
    if (this.drawnPart !== 1) this.#render(1);
  }

  /** Draws now, with a part of the full width and height. */
  #render(part) {
    if (part !== this.drawnPart) {
      const { clientWidth: width, clientHeight: height } = this.canvas.parentElement;
      if (!width || !height) return; // nobody sees it yet
      this.renderer.setPixelRatio(part * PIXELS_ACROSS);
      this.renderer.setSize(width, height); // on whole pixels of the page: a browser that shrinks it unevenly breaks lines
      this.drawnPart = part;
    }
    this.renderer.render(this.scene, this.camera);
  }

  /** Looks at a sphere from an azimuth and an elevation [degree], with room for all of it. */
  lookAt(around, view) {
    this.#moveCamera(placeOf(around, view), around.center);
  }

  /** Moves the camera there in a short flight, or at once where the reader wants no motion. */
  flyTo(around, view) {
    const [from, to] = [this.camera.position.clone(), placeOf(around, view)];
    const [fromTarget, toTarget] = [this.controls.target.clone(), around.center];
    const started = performance.now();
    const length = window.matchMedia("(prefers-reduced-motion: reduce)").matches ? 0 : FLIGHT_MS;
    this.flight = started;
    const fly = (now) => {
      if (this.flight !== started) return; // another one has begun
      const part = length ? Math.min(1, Math.max(0, (now - started) / length)) : 1;
      const eased = part * part * (3 - 2 * part);
      this.#moveCamera(from.clone().lerp(to, eased), fromTarget.clone().lerp(toTarget, eased));
      if (part < 1) requestAnimationFrame(fly);
    };
    fly(started);
  }

  #moveCamera(position, target) {
    this.camera.position.copy(position);
    this.controls.target.copy(target);
    this.controls.update();
    this.draw();
  }

  #turnByKey(event) {
    const turns = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
    const zooms = { "+": 1 / ZOOM, "=": 1 / ZOOM, "-": ZOOM };
    const offset = this.camera.position.clone().sub(this.controls.target);
    if (event.key in turns) {
      const [around, up] = turns[event.key];
      const distance = offset.length();
      const azimuth = Math.atan2(offset.y, offset.x) + around * TURN_RAD;
      const highest = 0.5 * Math.PI - LOWEST_RAD;
      const elevation = Math.min(highest, Math.max(-highest, Math.asin(offset.z / distance) + up * TURN_RAD));
      offset.set(
        distance * Math.cos(elevation) * Math.cos(azimuth),
        distance * Math.cos(elevation) * Math.sin(azimuth),
        distance * Math.sin(elevation),
      );
    } else if (event.key in zooms) {
      offset.multiplyScalar(zooms[event.key]);
    } else {
      return;
    }
    event.preventDefault();
    event.stopPropagation();
    this.camera.position.copy(this.controls.target).add(offset);
    this.controls.update();
  }

  #fit() {
    const { clientWidth: width, clientHeight: height } = this.canvas.parentElement;
    if (!width || !height) return;
    if (this.isHeld) return;
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.drawnPart = 0;
    this.draw();
  }
}

const HALF_FIELD = (0.5 * FIELD_OF_VIEW_DEG * Math.PI) / 180;

/** Where the camera stands to see all of a sphere, or from a `distance`, from an azimuth and an elevation [degree]. */
function placeOf(around, view) {
  return around.center.clone().addScaledVector(directionOf(view), around.distance ?? (FILLED * around.radius) / Math.sin(HALF_FIELD));
}

/** What a camera looks at, and from how far, to see points from there (envs/playback_files/still.py does the same). */
export function framing(points, view) {
  const away = directionOf(view);
  const right = new Vector3(0, 0, 1).cross(away).normalize();
  const center = new Vector3();
  for (const axis of [right, away.clone().cross(right), away]) {
    const places = points.map((point) => point.dot(axis));
    center.addScaledVector(axis, 0.5 * (Math.min(...places) + Math.max(...places)));
  }
  const distances = points.map((point) => {
    const offset = point.clone().sub(center);
    const [depth, across] = [offset.dot(away), Math.abs(offset.dot(right))];
    const up = Math.sqrt(Math.max(0, offset.lengthSq() - depth ** 2 - across ** 2));
    return depth + Math.max(up, across / NARROWEST) / (FILLED * Math.tan(HALF_FIELD));
  });
  return { center, distance: Math.max(...distances) };
}

function directionOf(view) {
  const [azimuth, elevation] = view.map((angle) => (angle * Math.PI) / 180);
  return new Vector3(Math.cos(azimuth) * Math.cos(elevation), Math.sin(azimuth) * Math.cos(elevation), Math.sin(elevation));
}

export function geometryOf(vertices, triangles) {
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(vertices.values, 3));
  geometry.setIndex(new BufferAttribute(triangles.values, 1));
  return geometry;
}
