// The marker flow of both sensors after an env step, as arrows in the coordinates of their pictures.

import { scaleBar } from "./sections.js";

const WIDTH_PX = 320;
const HEIGHT_PX = 240;
const MARKERS = 128;
const MAGNIFICATIONS = [20, 10, 5, 2, 1];
const LONGEST_PX = 45;
const HEAD_PX = 4;
const BAR_PX = 5;

/** How many times longer than they are arrows are drawn, so that the longest of the episode has room. */
export function magnification(episode) {
  const { flow_references: references, flow_positions: positions } = episode.arrays;
  let longest = 0;
  positions.values.forEach((value, index) => {
    longest = Math.max(longest, Math.abs(value - references.values[index]));
  });
  return MAGNIFICATIONS.find((factor) => factor * longest * episode.header.flow_unit_px <= LONGEST_PX) ?? 1;
}

/** Draws one sensor's arrows. */
export function drawFlow(canvas, episode, step, side, factor) {
  const ratio = Math.min(2, window.devicePixelRatio);
  canvas.width = WIDTH_PX * ratio;
  canvas.height = HEIGHT_PX * ratio;
  const context = canvas.getContext("2d");
  context.scale(ratio, ratio);
  context.strokeStyle = getComputedStyle(canvas).color;
  context.lineWidth = 1.4;
  const unit = episode.header.flow_unit_px;
  const first = 2 * MARKERS * (2 * step + side);
  context.beginPath();
  for (let at = first; at < first + 2 * MARKERS; at += 2) {
    const [u, v] = [0, 1].map((axis) => unit * episode.arrays.flow_references.values[at + axis]);
    const [du, dv] = [u, v].map((from, axis) => factor * (unit * episode.arrays.flow_positions.values[at + axis] - from));
    arrow(context, u, v, u + du, v + dv);
  }
  context.stroke();
  scaleBar(context, factor * BAR_PX, `${BAR_PX} px`, context.strokeStyle);
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
