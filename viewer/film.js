// Records the scenes of a page as a film, picture by picture: as sharp and as even on a slow machine as on a fast one.

import { BufferTarget, CanvasSource, getFirstEncodableVideoCodec, Output, WebMOutputFormat } from "mediabunny";

const PER_S = 30;
const LAST_S = 0.5; // for which the end is shown
const CAPTION_PX = 44;
const KEY_EVERY_S = 2;
const BITS_PER_PIXEL = 0.12;
const CODECS = ["vp9", "vp8"];

export class Film {
  /** `menu` holds the controls; `players` are filmed as `transport` has them drawn. */
  constructor(menu, players, transport) {
    this.menu = menu;
    this.players = players;
    this.transport = transport;
    this.status = menu.querySelector("[role=status]");
    this.progress = menu.querySelector("progress");
    this.button = menu.querySelector("button");
    this.cancelled = undefined; // aborts the recording in progress
    this.button.addEventListener("click", () => (this.cancelled ? this.cancelled.abort() : this.#record()));
  }

  async #record() {
    this.cancelled = new AbortController();
    this.button.textContent = "Cancel";
    this.status.textContent = "";
    this.progress.hidden = false;
    const filmed = this.players.map(({ stage }) => stage);
    if (this.transport.isPlaying) this.transport.toggle();
    try {
      filmed.forEach((stage) => stage.holdStill(true));
      const film = await this.#film(filmed, this.cancelled.signal);
      this.#save(film);
    } catch (error) {
      this.status.textContent = this.cancelled.signal.aborted ? "Cancelled." : `There is no film: ${error.message}`;
    }
    filmed.forEach((stage) => stage.holdStill(false));
    this.transport.moveTo(this.transport.time);
    this.cancelled = undefined;
    this.button.textContent = "Record a film";
    this.progress.hidden = true;
  }

  /** Resolves to the file and its length [s]. */
  async #film(stages, signal) {
    const { length } = this.transport;
    const speed = this.transport.speed;
    const pictures = Math.round((length / speed + LAST_S) * PER_S);
    const canvas = this.#canvas(stages);
    const source = await sourceOf(canvas);
    const output = new Output({ format: new WebMOutputFormat(), target: new BufferTarget() });
    output.addVideoTrack(source, { frameRate: PER_S });
    await output.start();
    try {
      for (let at = 0; at < pictures; at += 1) {
        const time = Math.min(length, (at * speed) / PER_S);
        this.transport.drawAt(time);
        this.#compose(canvas, stages, time);
        await source.add(at / PER_S, 1 / PER_S); // waits while the encoder has enough
        this.progress.value = at / pictures;
        await new Promise((resolve) => setTimeout(resolve));
        signal.throwIfAborted();
      }
      await output.finalize();
    } catch (error) {
      await output.cancel();
      throw error;
    }
    return { seconds: pictures / PER_S, file: new Blob([output.target.buffer], { type: "video/webm" }) };
  }

  /** Scenes one beside another, as wide to their heights as the page shows them, over a line of words. */
  #canvas(stages) {
    const width = Number(this.menu.querySelector("select").value) / stages.length;
    const heights = stages.map(({ canvas: { parentElement: room } }) => even((width * room.clientHeight) / room.clientWidth));
    const canvas = document.createElement("canvas");
    Object.assign(canvas, { width: width * stages.length, height: Math.max(...heights) + CAPTION_PX });
    return canvas;
  }

  #compose(canvas, stages, time) {
    const context = canvas.getContext("2d");
    const [width, height] = [canvas.width / stages.length, canvas.height - CAPTION_PX];
    const room = getComputedStyle(stages[0].canvas.parentElement);
    context.fillStyle = room.backgroundColor;
    context.fillRect(0, 0, canvas.width, canvas.height);
    context.fillStyle = room.color;
    context.font = `20px ${room.fontFamily}`;
    context.textBaseline = "middle";
    const moment = `env step ${time.toFixed(1)} of ${this.transport.length}`;
    const end = canvas.width - 16 - context.measureText(moment).width;
    const line = height + 0.5 * CAPTION_PX;
    stages.forEach((stage, at) => {
      context.drawImage(stage.picture(width, height), at * width, 0, width, height);
      const left = at * width + 16;
      const right = at === stages.length - 1 ? end : (at + 1) * width;
      context.fillText(this.players[at].section.dataset.heading, left, line, right - left - 16);
    });
    context.fillText(moment, end, line);
  }

  #save({ file, seconds }) {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(file);
    link.download = `${this.players.map(({ section }) => fileName(section.dataset.heading)).join("_beside_")}.webm`;
    link.textContent = link.download;
    this.status.replaceChildren(link, `, ${seconds.toFixed(1)} s, ${(file.size / 1e6).toFixed(1)} MB`);
    link.click();
  }
}

async function sourceOf(canvas) {
  if (typeof VideoEncoder === "undefined") throw new Error("this browser does not encode films, or does so at addresses with https only.");
  const { width, height } = canvas;
  const settings = { width, height, bitrate: Math.round(BITS_PER_PIXEL * width * height * PER_S) };
  const codec = await getFirstEncodableVideoCodec(CODECS, settings);
  if (!codec) throw new Error("this browser encodes neither VP9 nor VP8.");
  return new CanvasSource(canvas, { codec, bitrate: settings.bitrate, keyFrameInterval: KEY_EVERY_S, latencyMode: "quality" });
}

function even(length) {
  return 2 * Math.round(0.5 * length);
}

/** A heading as the name of a file. */
function fileName(heading) {
  return heading
    .replaceAll("−", "-")
    .replaceAll("°", "deg")
    .replaceAll(/[^\p{L}\p{N}.+-]+/gu, "_");
}
