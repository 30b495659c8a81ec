// An episode as it was unpacked: when each moment was, and the state between two of them. Time counts env steps.

const POSE = 12;

export class Episode {
  constructor({ header, arrays }) {
    this.header = header;
    this.arrays = arrays;
    this.times = momentTimes(arrays.moment_env_steps.values);
    this.lastStep = arrays.action_values.shape[0];
    this.nodes = arrays.gel_nodes_mm.shape[0];
    this.sensing = arrays.sensing_nodes.shape[0];
  }

  /** Number of the env step that has ended last at a time; 0 is the reset. */
  stepAt(time) {
    return Math.max(0, Math.min(this.lastStep, Math.floor(time + 1e-6)));
  }

  /** The moments around a time, and how far it is from the first to the second. */
  around(time) {
    const times = this.times;
    let next = times.findIndex((at) => at > time);
    if (next <= 0) next = next === 0 ? 1 : times.length - 1;
    const before = Math.max(0, next - 1);
    const length = times[next] - times[before];
    const fraction = length > 0 ? Math.min(1, Math.max(0, (time - times[before]) / length)) : 0;
    return { before, next, fraction };
  }

  /** Pose of a sensor: nine numbers of the rotation by rows, then the place [mm]. */
  sensorPose(place, side, target) {
    return mixed(this.arrays.sensor_poses.values, POSE, place, 2, side, target);
  }

  /** The held part's map from its own frame, as a pose. */
  heldPose(place, target) {
    return mixed(this.arrays.held_poses.values, POSE, place, 1, 0, target);
  }

  /** The held part's vertices in its own frame [mm]: those of a soft one move in it. */
  heldVertices({ before, next, fraction }) {
    const { held_vertices_mm: rest, held_displacements: moved } = this.arrays;
    if (!moved) return rest.values;
    const { values } = moved;
    const [unit, count] = [this.header.displacement_unit_mm, rest.values.length];
    return rest.values.map((value, at) => value + unit * ((1 - fraction) * values[before * count + at] + fraction * values[next * count + at]));
  }

  /** How far the fixed part has moved [mm]; null where it stands still. */
  fixedShift(place, target) {
    const { fixed_shifts_mm: shifts } = this.arrays;
    return shifts ? mixed(shifts.values, 3, place, 1, 0, target) : null;
  }

  /** Upper ends of the colour scales over the whole episode. */
  largest() {
    const displacements = this.arrays.displacements.values;
    let square = 0;
    for (let index = 0; index < displacements.length; index += 3) {
      square = Math.max(square, displacements[index] ** 2 + displacements[index + 1] ** 2 + displacements[index + 2] ** 2);
    }
    const pressure = this.arrays.pressures.values.reduce((most, value) => Math.max(most, value), 0);
    return {
      displacement: Math.sqrt(square) * this.header.displacement_unit_mm || 1,
      pressure: pressure * this.header.pressure_unit_kpa || 1,
    };
  }
}

/** Moments of one env step are equally far apart and the last one is its end. */
export function momentTimes(steps) {
  const counts = new Map();
  for (const step of steps) counts.set(step, (counts.get(step) ?? 0) + 1);
  const seen = new Map();
  return Array.from(steps, (step) => {
    if (step === 0) return 0;
    seen.set(step, (seen.get(step) ?? 0) + 1);
    return step - 1 + seen.get(step) / counts.get(step);
  });
}

/** Values of one of several parts, between two moments. */
function mixed(values, size, { before, next, fraction }, parts, part, target) {
  const first = (before * parts + part) * size;
  const second = (next * parts + part) * size;
  for (let index = 0; index < size; index += 1) {
    target[index] = (1 - fraction) * values[first + index] + fraction * values[second + index];
  }
  return target;
}
