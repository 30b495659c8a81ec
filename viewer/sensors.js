// What both sensors see after an env step: the marker flow as arrows, over the pictures of their cameras.

import { element } from "./elements.js";
import { scaleBar } from "./sections.js";
import { TactileCamera } from "./tactile.js";

const WIDTH_PX = 320;
const HEIGHT_PX = 240;
const MARKERS = 128;
const MAGNIFICATIONS = [20, 10, 5, 2, 1];
const LONGEST_PX = 45;
const HEAD_PX = 4;
const NOWHERE_PX = -500; // what is left of it fills up a file
const BAR_PX = 5;
const RING = { radius: 6, colour: "#ffb000" }; // around where a lost marker is

/** How many times longer than they are arrows are drawn, so that the longest of the episode has room. */
export function magnification(episode) {
  const { flow_references: references, flow_positions: positions } = episode.arrays;
  let longest = 0;
  positions.values.forEach((value, index) => {
    longest = Math.max(longest, Math.abs(value - references.values[index]));
  });
  return MAGNIFICATIONS.find((factor) => factor * longest * episode.header.flow_unit_px <= LONGEST_PX) ?? 1;
}

/** Both sensors on canvases of their own. */
export class Flows {
  constructor(episode, canvases, factor) {
    this.episode = episode;
    this.canvases = canvases;
    this.factor = factor;
    this.pictures = new Map(); // by env step and side, as they take longer than a frame
  }

  /** Shows an env step; `hasPictures`: over what the cameras see, which comes a moment later where it is new. */
  show(step, hasPictures) {
    this.shown = hasPictures ? step : undefined;
    this.canvases.forEach((canvas, side) => {
      const name = `${step} ${side}`;
      drawFlow(canvas, this.episode, step, side, this.factor, hasPictures && this.pictures.get(name));
      if (hasPictures && !this.pictures.has(name)) setTimeout(() => this.#take(step, side, name));
    });
  }

  #take(step, side, name) {
    if (this.shown !== step) return;
    const { arrays, header } = this.episode;
    this.camera ??= new TactileCamera(arrays.gel_nodes_mm.values, arrays.gel_triangles.values, header.sensor_camera);
    const moved = displacements(this.episode, step, side);
    const markers = places(this.episode, arrays.flow_positions, step, side);
    const pixels = this.camera.picture(moved, heldInGel(this.episode, step, side), arrays.held_triangles.values, markers);
    const picture = element("canvas", { width: WIDTH_PX, height: HEIGHT_PX });
    picture.getContext("2d").putImageData(new ImageData(pixels, WIDTH_PX, HEIGHT_PX), 0, 0);
    this.pictures.set(name, picture);
    drawFlow(this.canvases[side], this.episode, step, side, this.factor, picture);
  }
}

/** Draws one sensor's arrows, over the picture of its camera if there is one. */
function drawFlow(canvas, episode, step, side, factor, picture) {
  const ratio = Math.min(2, window.devicePixelRatio);
  canvas.width = WIDTH_PX * ratio;
  canvas.height = HEIGHT_PX * ratio;
  const context = canvas.getContext("2d");
  context.scale(ratio, ratio);
  if (picture) context.drawImage(picture, 0, 0);
  const [from, to] = [episode.arrays.flow_references, episode.arrays.flow_positions].map((flow) => places(episode, flow, step, side));
  context.beginPath();
  for (let at = 0; at < from.length; at += 2) {
    const [u, v] = [from[at], from[at + 1]];
    arrow(context, u, v, u + factor * (to[at] - u), v + factor * (to[at + 1] - v));
  }
  if (picture) stroke(context, "rgb(0 0 0 / 0.55)", 3.4);
  const colour = picture ? "#ffffff" : getComputedStyle(canvas).color;
  stroke(context, colour, 1.4);
  const lost = lostMarkers(episode, step, side);
  context.beginPath();
  for (const [u, v] of lost) {
    context.moveTo(u + RING.radius, v);
    context.arc(u, v, RING.radius, 0, 2 * Math.PI);
  }
  stroke(context, "rgb(0 0 0 / 0.55)", 3.4);
  stroke(context, RING.colour, 1.8);
  scaleBar(context, factor * BAR_PX, `${BAR_PX} px`, colour);
}

function stroke(context, colour, width) {
  Object.assign(context, { strokeStyle: colour, lineWidth: width });
  context.stroke();
}

/** Markers of one sensor in the picture after an env step, u and v in turn [pixel]. */
function places(episode, { values }, step, side) {
  const first = 2 * MARKERS * (2 * step + side);
  return Float32Array.from(values.subarray(first, first + 2 * MARKERS), (value) => episode.header.flow_unit_px * value);
}

/** Where markers are that the observation after an env step has lost, u and v of each [pixel]; none in older playbacks. */
function lostMarkers({ arrays: { lost_markers: lost }, header }, step, side) {
  const most = lost?.shape[2] ?? 0;
  return Array.from({ length: most }, (_, at) => [0, 1].map((axis) => lost.values[2 * (most * (2 * step + side) + at) + axis] * header.flow_unit_px)).filter(
    ([u]) => u > NOWHERE_PX,
  );
}

/** How far the nodes of a gel are from their rest after an env step [mm]. */
function displacements(episode, step, side) {
  const { arrays, header, nodes } = episode;
  const first = 3 * nodes * (2 * lastMoment(episode, step) + side);
  return Float32Array.from(arrays.displacements.values.subarray(first, first + 3 * nodes), (value) => header.displacement_unit_mm * value);
}

/** Vertices of the held part in the frame of a gel after an env step [mm]. */
function heldInGel(episode, step, side) {
  const moment = lastMoment(episode, step);
  const place = { before: moment, next: moment, fraction: 0 };
  const [gel, held] = [episode.sensorPose(place, side, []), episode.heldPose(place, [])];
  const own = episode.heldVertices(place);
  const found = new Float32Array(own.length);
  for (let at = 0; at < own.length; at += 3) {
    const away = [0, 1, 2].map((row) => held[9 + row] - gel[9 + row] + [0, 1, 2].reduce((sum, axis) => sum + held[3 * row + axis] * own[at + axis], 0));
    for (let axis = 0; axis < 3; axis += 1) found[at + axis] = away.reduce((sum, value, row) => sum + gel[3 * row + axis] * value, 0);
  }
  return found;
}

function lastMoment({ times }, step) {
  return times.findLastIndex((time) => time <= step + 1e-6);
}

function arrow(context, fromU, fromV, toU, toV) {
  const angle = Math.atan2(toV - fromV, toU - fromU);
  const head = Math.min(HEAD_PX, Math.hypot(toU - fromU, toV - fromV));
  context.moveTo(fromU, fromV);
  context.lineTo(toU, toV);
  for (const turn of [2.6, -2.6]) {
    context.moveTo(toU, toV);
    context.lineTo(toU + head * Math.cos(angle + turn), toV + head * Math.sin(angle + turn));
  }
}
