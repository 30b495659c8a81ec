// Actions, reward, surface motion and deciding heights over the env steps, and a table of the same numbers.

import { drawn, element } from "./elements.js";

const WIDTH = 300;
const HEIGHT = 130;
const COLOURS = 6;
const LETTERS = 50; // of a title and its lines that fit beside each other
const BOX = { left: 40, right: 292, top: 22, bottom: 106 };

export class Plots {
  /** `moments` are env steps that are marked; `all` are the episodes of a page, whose plots have the same axes. */
  constructor(parent, episode, moments, all) {
    this.length = Math.max(...all.map(({ lastStep }) => lastStep));
    this.others = all.flatMap(allSeries);
    this.marked = new Set(moments);
    this.cursors = [];
    this.shown = undefined;
    for (const series of allSeries(episode)) parent.append(this.#plot(series));
    parent.append(table(episode));
  }

  /** Moves to where a plot is pressed, or along it. */
  follow(moveTo) {
    for (const { ownerSVGElement: plot } of this.cursors) {
      const move = ({ clientX, buttons }) => {
        if (!buttons) return;
        const { left, width } = plot.getBoundingClientRect();
        const part = ((clientX - left) * (WIDTH / width) - BOX.left) / (BOX.right - BOX.left);
        moveTo(part * this.length);
      };
      plot.addEventListener("pointerdown", move);
      plot.addEventListener("pointermove", move);
    }
  }

  show(time) {
    const x = Math.round(this.#x(Math.min(time, this.length)));
    if (x === this.shown) return;
    this.shown = x;
    for (const cursor of this.cursors) {
      cursor.setAttribute("x1", x);
      cursor.setAttribute("x2", x);
    }
  }

  #x(step) {
    return BOX.left + (BOX.right - BOX.left) * (step / Math.max(1, this.length));
  }

  #plot({ title, lines, first, times, goal, isLimit }) {
    const kind = (at) => `line-${at % COLOURS}${at < COLOURS ? "" : " again"}`;
    const beside = this.others.filter((series) => series.title === title);
    const values = beside.flatMap((series) => series.lines.flatMap((line) => line.values)).concat([0], goal === undefined ? [] : [goal]);
    const [low, high] = [Math.min(...values), Math.max(...values)];
    const reach = high - low || 1;
    const y = (value) => BOX.bottom - (BOX.bottom - BOX.top) * ((value - low) / reach);
    const cursor = drawn("line", { class: "cursor", x1: BOX.left, x2: BOX.left, y1: BOX.top, y2: BOX.bottom });
    this.cursors.push(cursor);
    const label = (x, at, text, anchor) => drawn("text", { x, y: at, "text-anchor": anchor }, text);
    const key = lines.length > 1 ? lines.map((line, at) => drawn("tspan", { class: kind(at), dx: 8 }, line.name)) : [];
    const svg = drawn(
      "svg",
      { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "img", "aria-label": `${title} over the env steps` },
      drawn("text", { class: "plot-title", x: 2, y: 12, ...narrowed(title, lines) }, title, ...key),
      drawn("line", { class: "axis", x1: BOX.left, x2: BOX.right, y1: y(0), y2: y(0) }),
      label(BOX.left - 4, y(high) + 4, short(high), "end"),
      label(BOX.left - 4, y(low) + 4, short(low), "end"),
      label(BOX.left, HEIGHT - 8, "0", "middle"),
      label(BOX.right, HEIGHT - 8, `${this.length}`, "end"),
      label(0.5 * (BOX.left + BOX.right), HEIGHT - 8, "env step", "middle"),
    );
    if (goal !== undefined) svg.append(drawn("line", { class: isLimit ? "limit" : "goal", x1: BOX.left, x2: BOX.right, y1: y(goal), y2: y(goal) }));
    for (const step of this.marked) svg.append(drawn("line", { class: "moment", x1: this.#x(step), x2: this.#x(step), y1: BOX.top, y2: BOX.bottom }));
    lines.forEach((line, at) => {
      const points = line.values.map((value, index) => `${this.#x(times?.[index] ?? first + index).toFixed(1)},${y(value).toFixed(1)}`);
      svg.append(drawn("polyline", { class: kind(at), points: points.join(" ") }));
      if (points.length === 1) {
        const [cx, cy] = points[0].split(",");
        svg.append(drawn("circle", { class: kind(at), cx, cy, r: 2.5 }));
      }
    });
    svg.append(cursor);
    return element("div", { class: "plot" }, svg);
  }
}

/** What keeps a title with the names of its lines within the plot, where both would be wider. */
function narrowed(title, lines) {
  const letters = lines.length > 1 ? lines.reduce((sum, { name }) => sum + name.length + 2, title.length) : title.length;
  return letters > LETTERS ? { textLength: WIDTH - 4, lengthAdjust: "spacingAndGlyphs" } : {};
}

/** What is plotted; `first` is the env step of a line's first value, or `times` has one for each. */
function allSeries({ header, arrays, times }) {
  const series = [
    { title: "Action", first: 1, lines: columns(arrays.action_values, header.actions.map((action) => action.name)) },
    { title: "Reward", first: 1, lines: [{ name: "reward", values: Array.from(arrays.rewards.values) }] },
    { title: "Surface motion [mm]", first: 0, lines: columns(arrays.surface_motions_mm, ["left", "right"]), goal: header.surface_limit_mm, isLimit: true },
  ];
  if (arrays.forces_n) {
    const lines = columns(arrays.forces_n, [header.held_name, "left gel", "right gel"]);
    const goal = header.force_limit_n ?? undefined;
    series.push({ title: "Contact force [N]", times, lines, goal, isLimit: true });
  }
  if (arrays.heights_mm) {
    const lines = columns(arrays.heights_mm, numbered(arrays.heights_mm));
    series.push({ title: capital(header.heights_title), first: 0, lines, goal: header.heights_goal_mm });
  }
  return series.concat(observedSeries({ header, arrays }));
}

/** Curves of what the task lets a policy observe beside markers. */
function observedSeries({ header, arrays }) {
  return (header.curves ?? []).map(({ title, names }, at) => ({ title, first: 0, lines: columns(arrays[`curves_${at}`], names) }));
}

function numbered({ shape }) {
  return Array.from({ length: shape[1] }, (_, at) => `${at + 1}`); // as in the scene
}

function columns({ values, shape }, names) {
  return names.map((name, column) => ({
    name,
    values: Array.from({ length: shape[0] }, (_, row) => values[row * shape[1] + column]),
  }));
}

function table({ header, arrays, lastStep }) {
  const heading = ["Env step", ...header.actions.map((action) => action.name), "Reward", "Left [mm]", "Right [mm]"];
  const forces = arrays.forces_n && largestForces(arrays);
  if (forces) heading.push("Largest force [N]");
  const heights = arrays.heights_mm ? columns(arrays.heights_mm, numbered(arrays.heights_mm)) : [];
  const [above] = capital(header.heights_title ?? " ").split(" [");
  heading.push(...heights.map(({ name }) => `${above} ${name} [mm]`));
  const observed = observedSeries({ header, arrays }).flatMap(({ title, lines }) => {
    const [what, unit] = title.split(" [");
    return lines.map((line) => ({ ...line, title: `${what}${lines.length > 1 ? `, ${line.name}` : ""} [${unit}` }));
  });
  heading.push(...observed.map(({ title }) => title));
  const actions = columns(arrays.action_values, header.actions.map((action) => action.name));
  const motions = columns(arrays.surface_motions_mm, ["left", "right"]);
  const rows = Array.from({ length: lastStep }, (_, at) =>
    element(
      "tr",
      {},
      element("th", { scope: "row" }, `${at + 1}`),
      ...actions.map((action) => element("td", {}, short(action.values[at]))),
      element("td", {}, short(arrays.rewards.values[at])),
      ...motions.map((motion) => element("td", {}, short(motion.values[at + 1]))),
      ...(forces ? [element("td", {}, short(forces[at + 1]))] : []),
      ...[...heights, ...observed].map((line) => element("td", {}, short(line.values[at + 1]))),
    ),
  );
  const head = element("thead", {}, element("tr", {}, ...heading.map((text) => element("th", { scope: "col" }, text))));
  return element(
    "details",
    { class: "values" },
    element("summary", {}, "Values of every env step"),
    element(
      "div",
      { class: "scroll", tabindex: "0", role: "region", "aria-label": "Values of every env step" },
      element("table", {}, head, element("tbody", {}, ...rows)),
    ),
  );
}

/** The largest force on the held part in each env step, the reset first. */
function largestForces({ moment_env_steps: steps, forces_n: forces }) {
  const found = [];
  steps.values.forEach((step, moment) => {
    found[step] = Math.max(found[step] ?? 0, forces.values[forces.shape[1] * moment]);
  });
  return found;
}

function short(value) {
  return Number(value.toPrecision(3)).toString().replace("-", "−");
}

function capital(text) {
  return text[0].toUpperCase() + text.slice(1);
}
