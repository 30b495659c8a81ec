// Two sections through held and fixed part, drawn to scale: level, as seen from above, and upright, as the scene is cut open.

import { drawNumber } from "./labels.js";

const MARGIN_MM = 4;
const JUST_INSIDE_MM = 0.05; // of a face, which a plane through it would not cut
const BAR_MM = 10;
const FAR_MM = 500; // beyond every drawing
const FILLS = { fixed: "#8d99a4", held: "#c99a52" };

export class Sections {
  constructor(episode, { above, upright }) {
    this.episode = episode;
    this.title = above.nextSibling.textContent;
    const { fixed_vertices_mm: fixed, held_vertices_mm: held } = episode.arrays;
    this.fixed = fixed.values;
    this.held = new Float32Array(held.values.length);
    this.top = greatest(this.fixed, 2);
    const { normal, offset_mm } = episode.header.cut ?? { normal: [1, 0, 0], offset_mm: 0 };
    const offset = this.#crossing(normal, offset_mm);
    const across = [-normal[1], normal[0], 0];
    this.views = [
      { canvas: above, axes: [[1, 0, 0], [0, 1, 0]], planes: () => this.#levels(), other: () => [normal, offset] },
      { canvas: upright, axes: [across, [0, 0, 1]], planes: () => [[normal, offset], [normal, offset]], other: () => this.#levels()[0] },
    ];
    for (const view of this.views) view.window = this.#windowOf(view);
  }

  show(place, step) {
    this.#placeHeld(place);
    for (const view of this.views) this.#draw(view);
    const where = this.episode.header.positions?.[step];
    if (where) this.views[0].canvas.nextSibling.textContent = `${this.title}: ${where}`;
  }

  /** Where the upright plane stands along its normal: as the scene is cut open, or in the held part where that misses both. */
  #crossing(normal, offset) {
    const reach = (vertices) => {
      const along = Array.from({ length: vertices.length / 3 }, (_, at) => normal.reduce((sum, part, axis) => sum + part * vertices[3 * at + axis], 0));
      return [Math.min(...along), Math.max(...along)];
    };
    const [low, high] = reach(this.fixed);
    if (low < offset && offset < high) return offset;
    this.#placeHeld({ before: 0, next: 0, fraction: 0 });
    return reach(this.held).reduce((sum, end) => sum + 0.5 * end, 0);
  }

  #placeHeld(place) {
    const pose = this.episode.heldPose(place, new Float32Array(12));
    const own = this.episode.heldVertices(place);
    for (let at = 0; at < own.length; at += 3) {
      for (let row = 0; row < 3; row += 1) {
        this.held[at + row] = pose[9 + row] + [0, 1, 2].reduce((sum, column) => sum + pose[3 * row + column] * own[at + column], 0);
      }
    }
  }

  /** Level planes for fixed and held part: at the fixed part's top, or as near to it as the held part comes. */
  #levels() {
    const low = least(this.held, 2) + JUST_INSIDE_MM;
    const level = Math.max(low, Math.min(this.top, greatest(this.held, 2)) - JUST_INSIDE_MM);
    return [[[0, 0, 1], Math.min(level, this.top - JUST_INSIDE_MM)], [[0, 0, 1], level]];
  }

  #outlines({ axes, planes }) {
    const [fixedPlane, heldPlane] = planes();
    const { fixed_triangles: fixed, held_triangles: held } = this.episode.arrays;
    return {
      fixed: cut(this.fixed, fixed.values, ...fixedPlane, axes),
      held: cut(this.held, held.values, ...heldPlane, axes),
    };
  }

  /** Outline of the held part just above the highest of its measured corners: all of its lower end, also where it is tilted. */
  #lowerEnd(axes) {
    const corners = Array.from(this.episode.arrays.measured_vertices?.values ?? [], (vertex) => this.held[3 * vertex + 2]);
    const level = Math.max(...corners) + JUST_INSIDE_MM;
    return level > this.#levels()[1][1] && level < greatest(this.held, 2) ? cut(this.held, this.episode.arrays.held_triangles.values, [0, 0, 1], level, axes) : [];
  }

  /** What the drawing shows: all places of the held part, and the fixed part as far as that reaches. */
  #windowOf(view) {
    const ends = [0, this.episode.times.length - 1].flatMap((moment) => {
      this.#placeHeld({ before: moment, next: moment, fraction: 0 });
      const { fixed, held } = this.#outlines(view);
      return (held.length ? held : fixed).flat();
    });
    if (view.axes[1][2] === 1) ends.push([ends[0][0], 0], [ends[0][0], this.top + 2 * BAR_MM]);
    const [us, vs] = [0, 1].map((axis) => ends.map((point) => point[axis]));
    const lowest = [Math.min(...us), Math.min(...vs)].map((value) => value - MARGIN_MM);
    const highest = [Math.max(...us), Math.max(...vs)].map((value) => value + MARGIN_MM);
    if (view.axes[1][2] === 1) highest[1] = Math.min(highest[1], this.top + 2 * BAR_MM);
    return { lowest, highest };
  }

  #draw(view) {
    const { canvas, window: shown } = view;
    const ratio = Math.min(2, window.devicePixelRatio);
    const [width, height] = [320, 240];
    Object.assign(canvas, { width: width * ratio, height: height * ratio });
    const context = canvas.getContext("2d");
    context.scale(ratio, ratio);
    const size = [0, 1].map((axis) => shown.highest[axis] - shown.lowest[axis]);
    const scale = Math.min(width / size[0], height / size[1]);
    const middle = [0, 1].map((axis) => 0.5 * (shown.lowest[axis] + shown.highest[axis]));
    const toPixels = ([u, v]) => [0.5 * width + scale * (u - middle[0]), 0.5 * height - scale * (v - middle[1])];
    const inPixels = (loops) => loops.map((loop) => loop.map(toPixels));
    for (const [name, loops] of Object.entries(this.#outlines(view))) fill(context, inPixels(loops), FILLS[name]);
    const { color } = getComputedStyle(canvas);
    if (view === this.views[0]) outline(context, inPixels(this.#lowerEnd(view.axes)), color);
    this.#drawOtherCut(context, view, toPixels, color);
    for (const [at, vertex] of (this.episode.arrays.measured_vertices?.values ?? []).entries()) {
      const place = this.held.subarray(3 * vertex, 3 * vertex + 3);
      drawNumber(context, at, ...toPixels(view.axes.map((axis) => place.reduce((sum, value, part) => sum + axis[part] * value, 0))), 6.5);
    }
    scaleBar(context, scale * BAR_MM, `${BAR_MM} mm`, color);
  }

  /** A dashed line where the other section is. */
  #drawOtherCut(context, { axes, other }, toPixels, colour) {
    const [normal, offset] = other();
    const inside = axes.map((axis) => axis.reduce((sum, value, part) => sum + value * normal[part], 0));
    const ends = [-1, 1].map((end) => toPixels([inside[0] * offset - end * FAR_MM * inside[1], inside[1] * offset + end * FAR_MM * inside[0]]));
    context.beginPath();
    context.setLineDash([5, 4]);
    ends.forEach((end) => context.lineTo(...end));
    context.globalAlpha = 0.6;
    context.strokeStyle = colour;
    context.stroke();
    context.globalAlpha = 1;
    context.setLineDash([]);
  }
}

/** Draws a bar of a length [pixel] with its meaning in the lower left corner of a picture of 320 x 240. */
export function scaleBar(context, length, text, colour) {
  context.fillStyle = colour;
  context.fillRect(8, 228, length, 2);
  context.font = "11px system-ui, sans-serif";
  context.fillText(text, 8, 223);
}

function outline(context, loops, colour) {
  follow(context, loops);
  context.setLineDash([3, 3]);
  context.strokeStyle = colour;
  context.stroke();
  context.setLineDash([]);
}

function follow(context, loops) {
  context.beginPath();
  for (const loop of loops) {
    loop.forEach(([x, y], at) => (at ? context.lineTo(x, y) : context.moveTo(x, y)));
    context.closePath();
  }
}

function fill(context, loops, colour) {
  follow(context, loops);
  context.fillStyle = colour;
  context.globalAlpha = 0.75;
  context.fill("evenodd");
  context.globalAlpha = 1;
  context.strokeStyle = colour;
  context.stroke();
}

/** Loops of points in which a plane cuts a closed surface, in the coordinates of two axes. */
function cut(vertices, triangles, normal, offset, axes) {
  const dot = (axis, at) => axis[0] * vertices[at] + axis[1] * vertices[at + 1] + axis[2] * vertices[at + 2];
  const next = new Map(); // from the edge at which a loop enters a triangle to where it leaves
  for (let at = 0; at < triangles.length; at += 3) {
    const corners = [0, 1, 2].map((corner) => 3 * triangles[at + corner]);
    const heights = corners.map((corner) => dot(normal, corner) - offset);
    let [enters, leaves] = [];
    corners.forEach((from, side) => {
      const to = corners[(side + 1) % 3];
      const [a, b] = [heights[side], heights[(side + 1) % 3]];
      if (a < 0 === b < 0) return;
      const part = a / (a - b);
      const found = { edge: `${Math.min(from, to)}-${Math.max(from, to)}`, point: axes.map((axis) => (1 - part) * dot(axis, from) + part * dot(axis, to)) };
      if (a < 0) enters = found;
      else leaves = found;
    });
    if (enters) next.set(enters.edge, leaves);
  }
  const loops = [];
  while (next.size) {
    const loop = [];
    for (let [edge] = next.keys(), found; (found = next.get(edge)); edge = found.edge) {
      next.delete(edge);
      loop.push(found.point);
    }
    loops.push(loop);
  }
  return loops;
}

function least(values, axis) {
  return values.reduce((found, value, at) => (at % 3 === axis ? Math.min(found, value) : found), Infinity);
}

function greatest(values, axis) {
  return values.reduce((found, value, at) => (at % 3 === axis ? Math.max(found, value) : found), -Infinity);
}
