// The camera's colour and depth pictures after an env step.

import { scale } from "./colours.js";

const UNKNOWN = [255, 255, 255];

export class Cameras {
  constructor({ header, arrays }, { colour, depth }) {
    this.header = header;
    this.arrays = arrays;
    this.canvases = { colour, depth };
    [this.looks, this.rows, this.columns] = arrays.colours.shape;
    const palette = arrays.palette.values;
    this.colours = pixels(Array.from({ length: arrays.palette.shape[0] }, (_, at) => palette.subarray(3 * at, 3 * at + 3)));
    this.depths = pixels([UNKNOWN, ...scale("depth")]);
    for (const canvas of [colour, depth]) Object.assign(canvas, { width: this.columns, height: this.rows });
  }

  show(step) {
    const look = Math.min(step, this.looks - 1);
    this.#draw(this.canvases.colour, this.arrays.colours.values, this.colours, look);
    this.#draw(this.canvases.depth, this.arrays.depths.values, this.depths, look);
  }

  #draw(canvas, values, colours, look) {
    const context = canvas.getContext("2d");
    const picture = context.createImageData(this.columns, this.rows);
    const drawn = new Uint32Array(picture.data.buffer);
    const first = look * drawn.length;
    for (let pixel = 0; pixel < drawn.length; pixel += 1) drawn[pixel] = colours[values[first + pixel]];
    context.putImageData(picture, 0, 0);
  }
}

/** Opaque colours as the pixels of a canvas keep them. */
function pixels(colours) {
  return new Uint32Array(new Uint8ClampedArray(colours.flatMap((colour) => [...colour, 255])).buffer);
}
