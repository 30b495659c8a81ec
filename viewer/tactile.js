// The picture that a sensor's inner camera takes of its gel, as envs/vision/tactile_picture.py takes it: the deformed surface,
// or what it touches, shaded under three lights against the undeformed gel, with dots where the markers are.

const WIDTH = 320;
const HEIGHT = 240;
const PIXELS = WIDTH * HEIGHT;
const EYE_TO_BACK_MM = 18;
const NEAR_MM = 0.1;
const PIXEL_MM = 0.06; // depth that one pixel is wide, for slopes
const CHALLENGE_CAMERA = [340, 325, 160, 125]; // focal lengths and centre, both along u and v [pixel]
// Direction to each light, and the channel that it is seen in: red, green or blue.
const LIGHTS = [
  [[1, 0, 0.344], 1],
  [[0, -1, 0.344], 0],
  [[0, 1, 0.344], 2],
];
const LIGHT = 155;
const DIFFUSE = 0.6;
const SPECULAR = 0.1;
const DEPTH_RADIUS_PX = 8; // of blurs by a Gaussian of 2 px
const COLOUR_RADIUS_PX = 2;
const DOT = { radius: 3, edge: 1.7, reach: 5 };
// An untouched gel: red, green and blue at these rows and columns.
const ROWS = [10, 60, 120, 180, 230];
const COLUMNS = [10, 80, 160, 240, 310];
const BACKGROUND = [
  [[39, 74, 65], [64, 98, 84], [77, 112, 93], [61, 104, 83], [36, 92, 67]],
  [[48, 80, 85], [85, 112, 108], [109, 129, 122], [82, 118, 109], [44, 104, 87]],
  [[48, 84, 115], [91, 120, 157], [117, 137, 176], [90, 125, 158], [45, 111, 115]],
  [[28, 85, 107], [51, 117, 141], [66, 134, 158], [52, 122, 140], [30, 107, 104]],
  [[18, 76, 92], [24, 103, 120], [46, 119, 134], [43, 109, 117], [24, 96, 88]],
];

export class TactileCamera {
  /** `nodes` are those of the undeformed gel's surface in its frame [mm], `triangles` their indices. */
  constructor(nodes, triangles, camera = CHALLENGE_CAMERA) {
    this.nodes = nodes;
    this.camera = camera;
    const heights = nodes.filter((_, at) => at % 3 === 2);
    const [back, top] = [heights.reduce((a, b) => Math.min(a, b)), heights.reduce((a, b) => Math.max(a, b))];
    this.distance = EYE_TO_BACK_MM - back;
    this.beyond = this.distance + top; // where a gel does not reach the picture's edge
    // The back face stands between the camera and the sensing face.
    const isBack = (at) => [0, 1, 2].every((corner) => heights[triangles[at + corner]] < back + 1e-3);
    this.triangles = triangles.filter((_, at) => !isBack(at - (at % 3)));
    this.background = background();
    const atRest = shaded(this.#depths(new Float32Array(nodes.length), [], []));
    for (let at = 0; at < atRest.length; at += 1) atRest[at] = -atRest[at];
    this.minusRest = atRest;
  }

  /** Red, green, blue and 255 of every pixel. `moved` is how far each node is from its rest [mm]; `body` are the vertices of what
   * the gel touches in the gel's frame [mm]; `markers` their places, u and v in turn [pixel]. */
  picture(moved, body, bodyTriangles, markers) {
    const change = shaded(this.#depths(moved, body, bodyTriangles));
    for (let at = 0; at < change.length; at += 1) change[at] += this.minusRest[at];
    const shares = dots(markers);
    const drawn = new Uint8ClampedArray(4 * PIXELS).fill(255);
    for (let channel = 0; channel < 3; channel += 1) {
      const plane = blurred(change.subarray(channel * PIXELS, (channel + 1) * PIXELS), COLOUR_RADIUS_PX);
      for (let at = 0; at < PIXELS; at += 1) drawn[4 * at + channel] = Math.floor((this.background[3 * at + channel] + plane[at]) * shares[at]);
    }
    return drawn;
  }

  /** Depth of whatever is nearer to the camera [mm]. */
  #depths(moved, body, bodyTriangles) {
    const depths = new Float64Array(PIXELS);
    this.#draw(depths, this.nodes.map((value, at) => value + moved[at]), this.triangles);
    this.#draw(depths, body, bodyTriangles);
    return depths.map((inverse) => (inverse ? 1 / inverse : this.beyond));
  }

  /** Puts the largest inverse depths of triangles into a picture. Their corners are in the gel's frame, whose x and y the camera
   * sees turned round. */
  #draw(inverses, points, triangles) {
    const [focalU, focalV, centreU, centreV] = this.camera;
    const seen = (node) => {
      const z = points[3 * node + 2] + this.distance;
      return [centreU - (focalU * points[3 * node]) / z - 0.5, centreV - (focalV * points[3 * node + 1]) / z - 0.5, 1 / z, z];
    };
    for (let at = 0; at < triangles.length; at += 3) {
      const [a, b, c] = [0, 1, 2].map((corner) => seen(triangles[at + corner]));
      const area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
      if (!area || Math.min(a[3], b[3], c[3]) < NEAR_MM) continue;
      const reach = (axis, most) => [Math.max(0, Math.ceil(Math.min(a[axis], b[axis], c[axis]))), Math.min(most - 1, Math.floor(Math.max(a[axis], b[axis], c[axis])))];
      const [[left, right], [top, bottom]] = [reach(0, WIDTH), reach(1, HEIGHT)];
      for (let v = top; v <= bottom; v += 1) {
        for (let u = left; u <= right; u += 1) {
          const ofB = ((u - a[0]) * (c[1] - a[1]) - (v - a[1]) * (c[0] - a[0])) / area;
          const ofC = ((b[0] - a[0]) * (v - a[1]) - (b[1] - a[1]) * (u - a[0])) / area;
          if (ofB < 0 || ofC < 0 || ofB + ofC > 1) continue;
          const inverse = (1 - ofB - ofC) * a[2] + ofB * b[2] + ofC * c[2];
          if (inverse > inverses[v * WIDTH + u]) inverses[v * WIDTH + u] = inverse;
        }
      }
    }
  }
}

/** Colours of a surface by Phong's model, 0 to 255: all of red, then of green, then of blue. */
function shaded(depths) {
  const smooth = blurred(depths, DEPTH_RADIUS_PX);
  const colours = new Float64Array(3 * PIXELS);
  for (let v = 0; v < HEIGHT; v += 1) {
    const [above, below] = [Math.max(0, v - 1) * WIDTH, Math.min(HEIGHT - 1, v + 1) * WIDTH];
    for (let u = 0; u < WIDTH; u += 1) {
      const at = v * WIDTH + u;
      const slopeU = (smooth[v * WIDTH + Math.min(WIDTH - 1, u + 1)] - smooth[v * WIDTH + Math.max(0, u - 1)]) / (2 * PIXEL_MM);
      const slopeV = (smooth[below + u] - smooth[above + u]) / (2 * PIXEL_MM);
      const length = Math.sqrt(slopeU * slopeU + slopeV * slopeV + 1);
      for (const [[lightU, lightV, lightZ], channel] of LIGHTS) {
        const cosine = (slopeU * lightU + slopeV * lightV + lightZ) / length;
        const mirrored = Math.max(0, (2 * cosine) / length - lightZ);
        colours[channel * PIXELS + at] = Math.min(255, LIGHT * (DIFFUSE * Math.max(cosine, 0) + SPECULAR * mirrored ** 5));
      }
    }
  }
  return colours;
}

/** A plane under a Gaussian of 2 px, cut off at a radius; edges are continued. */
function blurred(plane, radius) {
  const weights = Array.from({ length: 2 * radius + 1 }, (_, at) => Math.exp(-((at - radius) ** 2) / 8));
  const total = weights.reduce((sum, weight) => sum + weight, 0);
  const pass = (values, step, count, others, across) => {
    const made = new Float64Array(PIXELS);
    for (let line = 0; line < others; line += 1) {
      for (let at = 0; at < count; at += 1) {
        let sum = 0;
        for (let k = -radius; k <= radius; k += 1) {
          sum += weights[k + radius] * values[line * across + Math.min(count - 1, Math.max(0, at + k)) * step];
        }
        made[line * across + at * step] = sum / total;
      }
    }
    return made;
  };
  return pass(pass(plane, WIDTH, HEIGHT, WIDTH, 1), 1, WIDTH, HEIGHT, WIDTH);
}

/** Share of the light that dots let through; the darker of two that overlap. */
function dots(markers) {
  const shares = new Float64Array(PIXELS).fill(1);
  for (let at = 0; at < markers.length; at += 2) {
    const [firstU, firstV] = [Math.floor(markers[at]), Math.floor(markers[at + 1])];
    for (let v = Math.max(0, firstV - DOT.reach); v <= Math.min(HEIGHT - 1, firstV + DOT.reach); v += 1) {
      for (let u = Math.max(0, firstU - DOT.reach); u <= Math.min(WIDTH - 1, firstU + DOT.reach); u += 1) {
        const away = Math.hypot(u + 0.5 - markers[at], v + 0.5 - markers[at + 1]);
        const share = Math.min(1, Math.max(0, (away - DOT.radius) / DOT.edge + 0.5));
        shares[v * WIDTH + u] = Math.min(shares[v * WIDTH + u], share);
      }
    }
  }
  return shares;
}

/** An untouched gel between its known places, red, green and blue of each pixel in turn. */
function background() {
  const made = new Float64Array(3 * PIXELS);
  for (let v = 0; v < HEIGHT; v += 1) {
    const [row, down] = between(ROWS, v);
    for (let u = 0; u < WIDTH; u += 1) {
      const [column, along] = between(COLUMNS, u);
      for (let channel = 0; channel < 3; channel += 1) {
        const value = (above) => (1 - along) * BACKGROUND[above][column][channel] + along * BACKGROUND[above][column + 1][channel];
        made[3 * (v * WIDTH + u) + channel] = (1 - down) * value(row) + down * value(row + 1);
      }
    }
  }
  return made;
}

function between(places, at) {
  const inside = Math.min(places.at(-1), Math.max(places[0], at));
  const first = Math.min(places.length - 2, places.findLastIndex((place) => place <= inside));
  return [first, (inside - places[first]) / (places[first + 1] - places[first])];
}
