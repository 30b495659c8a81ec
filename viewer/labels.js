// Numbers in the scene, coloured as their lines in the plots.

import { CanvasTexture, Sprite, SpriteMaterial, SRGBColorSpace } from "three";

import { LINES } from "./colours.js";
import { element } from "./elements.js";

const HEIGHT = 0.016; // of the picture, at a field of view of 53 degrees
const PIXELS = 64;

/** The number after `at`, seen through everything, at a place of the part that it is added to [mm]. */
export function label(at, place) {
  const canvas = element("canvas", { width: PIXELS, height: PIXELS });
  drawNumber(canvas.getContext("2d"), at, 0.5 * PIXELS, 0.5 * PIXELS, 0.46 * PIXELS);
  const map = new CanvasTexture(canvas);
  map.colorSpace = SRGBColorSpace;
  const sprite = new Sprite(new SpriteMaterial({ map, depthTest: false, sizeAttenuation: false, toneMapped: false }));
  sprite.scale.setScalar(HEIGHT);
  sprite.position.fromArray(place);
  sprite.renderOrder = 4;
  return sprite;
}

/** Draws the number after `at` in a disc on a canvas. */
export function drawNumber(context, at, x, y, radius) {
  context.fillStyle = LINES[at % LINES.length];
  context.beginPath();
  context.arc(x, y, radius, 0, 2 * Math.PI);
  context.fill();
  context.fillStyle = "#ffffff";
  context.font = `600 ${1.5 * radius}px system-ui, sans-serif`;
  context.textAlign = "center";
  context.textBaseline = "middle";
  context.fillText(`${at + 1}`, x, y);
  context.textAlign = "start";
  context.textBaseline = "alphabetic";
}
