// The player of the episode pages: one or two episodes, played by the same controls. It also shows sensors' gels. See docs/architecture.md.

import { followUntilMade } from "./asking.js";
import { Cameras } from "./cameras.js";
import { drawScale } from "./colours.js";
import { fetchFile } from "./container.js";
import { element } from "./elements.js";
import { Episode } from "./episode.js";
import { Film } from "./film.js";
import { largestForce } from "./forces.js";
import { showGel } from "./gel.js";
import { Plots } from "./plots.js";
import { SPREAD_MM } from "./pressure.js";
import { Sections } from "./sections.js";
import { Flows, magnification } from "./sensors.js";
import { askedStep, Sharing } from "./sharing.js";
import { Stage } from "./stage.js";
import { Transport } from "./transport.js";

const LEGENDS = { displacement: ["Displacement", "mm"], pressure: ["Contact pressure", "kPa"] };

const FRAMES_OF_STILL = 4; // until a decoded still is on the screen of a page that is
const MAX_FRAMES = 120;

class Player {
  static async load(section) {
    const { playback, version } = section.dataset;
    const address = (file) => `${playback}/${file}?v=${version}`;
    const [scene, cameras] = await Promise.all([
      fetchFile(address("scene")),
      "cameras" in section.dataset ? fetchFile(address("cameras")) : null,
    ]);
    return { section, episode: new Episode(scene), cameras };
  }

  /** The same in all players of a page: `factor`, how many times longer than they are arrows of markers are drawn; `force`,
   * that of the longest arrow in a scene [N]; `all`, the episodes. */
  constructor({ section, episode, cameras }, { factor, force, all }) {
    this.section = section;
    this.episode = episode;
    this.stage = this.#stage(force);
    this.measured = document.querySelector(`[data-measured="${section.id}"]`) ?? section;
    this.panels = this.#place("panels");
    this.legend = this.stage && this.#legend();
    const canvases = ["left", "right"].map((side) => this.#panel(`${side} sensor, marker flow ×${factor}`, "flow"));
    this.flows = new Flows(episode, canvases, factor);
    this.sections = new Sections(episode, {
      above: this.#panel(`${episode.header.held_name} and ${episode.header.fixed_name} from above`, "flow"),
      upright: this.#panel(`${episode.header.held_name} and ${episode.header.fixed_name}, section`, "flow"),
    });
    this.plots = new Plots(this.#place("plots"), episode, this.#moments(), all);
    this.cameras = cameras && this.#cameras(cameras);
    this.shown = {};
  }

  /** `largest` are the upper ends of the colour scales, which all players of a page share. */
  show(time, { quantity, isCutOpen, isXray, hasForces, hasNames, hasPictures, view }, largest) {
    const step = this.episode.stepAt(time);
    const ended = Math.min(time, this.episode.lastStep);
    if (isCutOpen !== (this.shown.isCutOpen ?? false)) this.stage?.cutOpen(isCutOpen);
    if (isXray !== (this.shown.isXray ?? false)) this.stage?.xray(isXray);
    if (hasForces !== (this.shown.hasForces ?? true)) this.stage?.showForces(hasForces);
    if (hasNames !== (this.shown.hasNames ?? true)) this.stage?.showNames(hasNames);
    if (view !== (this.shown.view ?? "task")) this.stage?.lookFrom(view);
    this.stage?.show(ended, quantity, largest[quantity]);
    this.sections.show(this.episode.around(ended), step);
    this.plots.show(time);
    if (step !== this.shown.step || hasPictures !== this.shown.hasPictures) this.flows.show(step, hasPictures);
    if (step !== this.shown.step) this.cameras?.show(step);
    if (this.legend && quantity !== this.shown.quantity) this.#showLegend(quantity, largest);
    this.shown = { step, quantity, isCutOpen, isXray, hasForces, hasNames, hasPictures, view };
  }

  /** Shows the held part of another episode in this scene, too, if it is the same part. */
  addGhost(other) {
    const [own, others] = [this.episode, other].map(({ arrays }) => arrays.held_vertices_mm.values);
    if (own.length !== others.length || own.some((value, at) => value !== others[at])) return;
    this.stage?.addGhost(other);
    this.measured.querySelector(".legend").append(element("span", {}, "Blue: the held part of the other episode"));
  }

  /** Where something is drawn; a page that shows only the scene has no place for it. */
  #place(name) {
    return this.measured.querySelector(`.${name}`) ?? element("div");
  }

  /** Env steps that are marked. */
  #moments() {
    return [...this.measured.querySelectorAll("[data-env-step]")].map(({ dataset }) => Number(dataset.envStep));
  }

  /** The scene, or the still picture where the browser has no WebGL. */
  #stage(force) {
    const canvas = this.section.querySelector("canvas.scene");
    try {
      canvas.hidden = false;
      const stage = new Stage(canvas, this.episode, force);
      // After the first drawing, which was asked for before: the still stays until there is a scene.
      requestAnimationFrame(() => this.section.querySelector(".still")?.classList.add("printed"));
      return stage;
    } catch {
      canvas.hidden = true;
      say(this.section, "This browser shows no WebGL, so the scene is a still picture.");
      return null;
    }
  }

  #panel(title, kind) {
    const canvas = element("canvas", { class: kind, role: "img", "aria-label": title });
    this.panels.append(element("figure", {}, canvas, element("figcaption", {}, title)));
    return canvas;
  }

  #cameras(file) {
    const { nearest_mm: nearest, farthest_mm: farthest } = file.header;
    const range = `${nearest.toFixed(0)} (dark) to ${farthest.toFixed(0)} mm, white where unknown`;
    return new Cameras(file, {
      colour: this.#panel("camera, colour", "picture"),
      depth: this.#panel(`camera, depth: ${range}`, "picture"),
    });
  }

  #legend() {
    const canvas = element("canvas", { class: "scale", "aria-hidden": "true" });
    const text = element("span");
    this.measured.querySelector(".legend").append(text, canvas, ...this.#legendOfForces());
    return { canvas, text };
  }

  #legendOfForces() {
    const scale = this.stage.forces.scale;
    if (!scale) return [];
    const { held_name: held, fixed_name: fixed } = this.episode.header;
    const arrow = (kind) => element("span", { class: `arrow ${kind}`, "aria-hidden": "true" }, "➜");
    const length = `(${scale.force} N: an arrow of ${scale.length.toPrecision(2)} mm)`;
    return [element("span", {}, `Force on the ${held}: `, arrow("fixed"), ` orange from the ${fixed}, `, arrow("gel"), ` violet from a gel ${length}`)];
  }

  #showLegend(quantity, largest) {
    const [name, unit] = LEGENDS[quantity];
    drawScale(this.legend.canvas, quantity);
    const { held_name: held, fixed_name: fixed } = this.episode.header;
    const spread = quantity === "pressure" ? ` and above; on ${held} and ${fixed}: forces of contacts, each spread over ${SPREAD_MM} mm around it` : "";
    this.legend.text.textContent = `${name}: 0 to ${Number(largest[quantity].toPrecision(2))} ${unit}${spread}`;
  }
}

async function start() {
  document.querySelectorAll("[data-shape]").forEach((section) => {
    showGel(section).catch((error) => say(section, `The gel cannot be shown in 3D: ${error.message}`));
  });
  const sections = [...document.querySelectorAll("[data-playback]")];
  for (const section of sections.filter(({ dataset }) => ["", "queued", "running"].includes(dataset.state))) {
    followUntilMade(section).catch(() => say(section, "The server cannot be reached. Reload this page to see how far the playback is."));
  }
  const made = sections.filter((section) => section.dataset.state === "done");
  const form = document.querySelector("form.transport");
  if (!made.length || !form) return;
  const [loaded] = await Promise.all([Promise.all(made.map(Player.load)), stillsAreShown()]);
  const factor = Math.min(...loaded.map(({ episode }) => magnification(episode)));
  const all = loaded.map(({ episode }) => episode);
  const force = Math.max(...all.map(largestForce));
  const players = loaded.map((found) => new Player(found, { factor, force, all }));
  const length = Math.max(...players.map((player) => player.episode.lastStep));
  const largest = {};
  for (const quantity of Object.keys(LEGENDS)) {
    largest[quantity] = Math.max(...players.map((player) => player.episode.largest()[quantity]));
  }
  if (players.length === 2) players[0].addGhost(players[1].episode);
  const transport = new Transport(form, length, (time, options) => players.forEach((player) => player.show(time, options, largest)));
  for (const moment of document.querySelectorAll("[data-env-step]")) {
    const step = Number(moment.dataset.envStep);
    moment.addEventListener("click", () => transport.moveTo(step));
    transport.mark(step, moment.querySelector(".moment").classList[1]);
  }
  players.forEach((player) => player.plots.follow((step) => transport.moveTo(step)));
  new Sharing(form.querySelector("[data-share]"), () => transport.time);
  transport.moveTo(askedStep() ?? length); // the end, which the still shows and the sentence is about
  reveal("player");
  const seen = players.filter((player) => player.stage);
  if (!seen.length) return;
  new Film(form.querySelector("[data-film]"), seen, transport);
  reveal("scene");
}

/** Resolves when the browser shows the stills: the first scene can keep it busy for seconds. */
async function stillsAreShown() {
  await Promise.all([...document.querySelectorAll(".stage .still")].map((still) => still.decode?.().catch(() => {})));
  const isPainted = () => performance.getEntriesByName("first-contentful-paint").length > 0;
  for (let frame = 0; frame < FRAMES_OF_STILL || (frame < MAX_FRAMES && !isPainted()); frame += 1) {
    await new Promise(requestAnimationFrame);
  }
}

/** Shows the controls and the help that do nothing without the player, or without its 3D scene. */
function reveal(part) {
  document.querySelectorAll(`[data-with="${part}"]`).forEach((found) => (found.hidden = false));
}

function say(section, text) {
  section.querySelector(".player-status").textContent = text;
}

start().catch((error) => {
  document.querySelectorAll("[data-playback]").forEach((section) => say(section, `The playback cannot be shown: ${error.message}`));
});
