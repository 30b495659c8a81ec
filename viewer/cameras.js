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
    this.colours = Array.from({ length: arrays.palette.shape[0] }, (_, at) => palette.subarray(3 * at, 3 * at + 3));
    this.depths = [UNKNOWN, ...scale("depth")];
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
    const size = this.rows * this.columns;
    for (let pixel = 0; pixel < size; pixel += 1) {
      const [red, green, blue] = colours[values[look * size + pixel]];
      picture.data.set([red, green, blue, 255], 4 * pixel);
    }
    context.putImageData(picture, 0, 0);
  }
}
