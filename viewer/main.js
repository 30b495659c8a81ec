// The player of the episode pages: one or two episodes, played by the same controls. It also shows sensors' gels. See docs/architecture.md.

import { followUntilMade } from "./asking.js";
import { Cameras } from "./cameras.js";
import { drawScale } from "./colours.js";
import { fetchFile } from "./container.js";
import { element } from "./elements.js";
import { Episode } from "./episode.js";
import { showGel } from "./gel.js";
import { Plots } from "./plots.js";
import { drawFlow, magnification } from "./sensors.js";
import { Stage } from "./stage.js";
import { Transport } from "./transport.js";

const LEGENDS = { displacement: ["Displacement", "mm"], pressure: ["Contact pressure", "kPa"] };

class Player {
  static async load(section) {
    const { playback, version } = section.dataset;
    const address = (file) => `${playback}/${file}?v=${version}`;
    const [scene, cameras] = await Promise.all([
      fetchFile(address("scene")),
      "cameras" in section.dataset ? fetchFile(address("cameras")) : null,
    ]);
    return new Player(section, new Episode(scene), cameras);
  }

  constructor(section, episode, cameras) {
    this.section = section;
    this.episode = episode;
    this.stage = this.#stage();
    this.factor = magnification(episode);
    this.panels = section.querySelector(".panels");
    this.legend = this.stage && this.#legend();
    this.flows = ["left", "right"].map((side) => this.#panel(`${side} sensor, marker flow ×${this.factor}`, "flow"));
    this.plots = new Plots(section.querySelector(".plots"), episode);
    this.cameras = cameras && this.#cameras(cameras);
    this.step = undefined;
    this.quantity = undefined;
    this.isCutOpen = true;
  }

  /** `largest` are the upper ends of the colour scales, which all players of a page share. */
  show(time, { quantity, isCutOpen }, largest) {
    const step = this.episode.stepAt(time);
    if (isCutOpen !== this.isCutOpen) this.stage?.cutOpen(isCutOpen);
    this.stage?.show(Math.min(time, this.episode.lastStep), quantity, largest[quantity]);
    this.plots.show(time);
    if (step !== this.step) {
      this.flows.forEach((canvas, side) => drawFlow(canvas, this.episode, step, side, this.factor));
      this.cameras?.show(step);
    }
    if (this.legend && quantity !== this.quantity) this.#showLegend(quantity, largest);
    Object.assign(this, { step, quantity, isCutOpen });
  }

  /** The scene, or the still picture where the browser has no WebGL. */
  #stage() {
    const canvas = this.section.querySelector("canvas.scene");
    try {
      canvas.hidden = false;
      const stage = new Stage(canvas, this.episode);
      this.section.querySelector(".still")?.remove();
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
    this.section.querySelector(".legend").append(text, canvas);
    return { canvas, text };
  }

  #showLegend(quantity, largest) {
    const [name, unit] = LEGENDS[quantity];
    drawScale(this.legend.canvas, quantity);
    this.legend.text.textContent = `${name}: 0 to ${Number(largest[quantity].toPrecision(2))} ${unit}`;
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
  const made = sections.filter((section) => section.dataset.state === "made");
  const form = document.querySelector("form.transport");
  if (!made.length || !form) return;
  const players = await Promise.all(made.map(Player.load));
  const length = Math.max(...players.map((player) => player.episode.lastStep));
  const largest = {};
  for (const quantity of Object.keys(LEGENDS)) {
    largest[quantity] = Math.max(...players.map((player) => player.episode.largest()[quantity]));
  }
  new Transport(form, length, (time, options) => players.forEach((player) => player.show(time, options, largest)));
  reveal("player");
  if (players.some((player) => player.stage)) reveal("scene");
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
