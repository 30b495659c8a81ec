// Colour scales: from light to strong for quantities, and the usual one of depth pictures.

import LOOK from "../envs/playback_files/stage.json";

const SCALES = {
  displacement: LOOK.displacement,
  pressure: ["#fff6c9", "#fdd56f", "#fb9d43", "#ec4d2c", "#a80f26"],
  depth: ["#440154", "#3b528b", "#21918c", "#5ec962", "#fde725"],
};
export const LEVELS = 256;
export const LINES = ["#2f7fc1", "#c9640a", "#23895f", "#b0489c", "#8a6d1f", "#5b6ee1"]; // of plots, as in player.css

/** 256 colours from the lower to the upper end of a scale, red, green and blue of 0 to 255. */
export function scale(name) {
  const stops = SCALES[name].map((text) => [1, 3, 5].map((at) => parseInt(text.slice(at, at + 2), 16)));
  return Array.from({ length: LEVELS }, (_, level) => {
    const place = (level / (LEVELS - 1)) * (stops.length - 1);
    const index = Math.min(Math.floor(place), stops.length - 2);
    return stops[index].map((low, part) => Math.round(low + (place - index) * (stops[index + 1][part] - low)));
  });
}

/** Draws a scale from left to right. */
export function drawScale(canvas, name) {
  canvas.width = LEVELS;
  canvas.height = 1;
  const context = canvas.getContext("2d");
  const picture = context.createImageData(LEVELS, 1);
  scale(name).forEach((colour, level) => picture.data.set([...colour, 255], 4 * level));
  context.putImageData(picture, 0, 0);
}
