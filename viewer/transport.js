// The controls that all players of a page share: time, speed, colours, and the keyboard.

import { element } from "./elements.js";

const THUMB_PX = 16; // of the slider, which its middle cannot leave
const PLACES = 1000; // of the slider that playing moves it to; finer ones nobody sees
const EDITED = "input, select, textarea, button, summary, a, canvas";

export class Transport {
  /** `form` holds the controls; `show(time, options)` draws. */
  constructor(form, length, show) {
    this.form = form;
    this.output = form.querySelector("output");
    this.length = length;
    this.draw = show;
    this.time = 0;
    this.isPlaying = false;
    this.lastFrame = undefined;
    const { time, play, back, forward } = form.elements;
    time.max = length;
    time.addEventListener("input", () => this.moveTo(Number(time.value)));
    play.addEventListener("click", () => this.toggle());
    back.addEventListener("click", () => this.moveTo(Math.ceil(this.time - 1e-6) - 1));
    forward.addEventListener("click", () => this.moveTo(Math.floor(this.time + 1e-6) + 1));
    for (const name of ["quantity", "view", "cut", "xray", "forces", "names", "pictures"]) form.elements[name].addEventListener("change", () => this.#show());
    form.querySelectorAll("details.menu").forEach(operate);
    form.addEventListener("submit", (event) => event.preventDefault());
    document.addEventListener("keydown", (event) => this.#byKey(event));
    form.hidden = false;
    this.#show();
  }

  moveTo(time) {
    this.time = Math.min(this.length, Math.max(0, time));
    this.#show();
  }

  /** Marks an env step on the time line as a moment of a kind. */
  mark(step, kind) {
    const mark = element("span", { class: `moment ${kind}`, "aria-hidden": "true" });
    mark.style.left = `calc(${0.5 * THUMB_PX}px + (100% - ${THUMB_PX}px) * ${step / this.length})`;
    this.form.elements.time.parentElement.append(mark);
  }

  toggle() {
    this.isPlaying = !this.isPlaying;
    if (this.isPlaying && this.time >= this.length) this.time = 0;
    this.form.elements.play.textContent = this.isPlaying ? "Pause" : "Play";
    this.lastFrame = undefined;
    if (this.isPlaying) requestAnimationFrame((now) => this.#frame(now));
    else this.#show();
  }

  #frame(now) {
    if (!this.isPlaying) return;
    const passed = this.lastFrame === undefined ? 0 : (now - this.lastFrame) / 1000;
    this.lastFrame = now;
    this.moveTo(this.time + passed * this.speed);
    if (this.time >= this.length) this.toggle();
    else requestAnimationFrame((next) => this.#frame(next));
  }

  #byKey(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target.closest(EDITED)) return;
    const moves = {
      " ": () => this.toggle(),
      ArrowLeft: () => this.form.elements.back.click(),
      ArrowRight: () => this.form.elements.forward.click(),
      Home: () => this.moveTo(0),
      End: () => this.moveTo(this.length),
    };
    if (event.key in moves) {
      event.preventDefault();
      moves[event.key]();
    }
  }

  /** Env steps in a second. */
  get speed() {
    return Number(this.form.elements.speed.value);
  }

  /** Draws another time than the one that it is. */
  drawAt(time) {
    const { quantity, view, cut, xray, forces, names, pictures } = this.form.elements;
    const layers = { isCutOpen: cut.checked, isXray: xray.checked, hasForces: forces.checked, hasNames: names.checked, hasPictures: pictures.checked };
    this.draw(time, { quantity: quantity.value, view: view.value, ...layers });
  }

  #show() {
    const { time } = this.form.elements;
    if (!this.isPlaying || Math.abs(this.time - time.value) * PLACES >= this.length) time.value = this.time;
    const text = `${this.time.toFixed(1)} of ${this.length}`;
    if (text !== this.output.textContent) {
      this.output.textContent = text;
      time.setAttribute("aria-valuetext", `env step ${text}`);
    }
    this.drawAt(this.time);
  }
}

const ROOM = 16; // [px] above a menu

/** Opens a menu upwards beside the scene where it has room, and closes it by Escape and by a press elsewhere. */
function operate(menu) {
  menu.addEventListener("toggle", () => {
    const [top, height] = [menu.getBoundingClientRect().top, menu.lastElementChild.offsetHeight];
    menu.classList.toggle("up", menu.open && top > height + ROOM);
  });
  document.addEventListener("pointerdown", ({ target }) => (menu.open &&= menu.contains(target)));
  menu.addEventListener("keydown", ({ key }) => {
    if (key !== "Escape") return;
    menu.open = false;
    menu.querySelector("summary").focus();
  });
  menu.addEventListener("focusout", ({ relatedTarget }) => relatedTarget && (menu.open &&= menu.contains(relatedTarget)));
}
