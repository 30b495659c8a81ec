// How sharp a moving scene is drawn: as sharp as the machine can in time, and in full once it stands still.

const FRAMES = 6; // after so many it is decided again
const FIRST = 0.5;
const SLOW_MS = 19; // a screen of 60 Hz takes 16.7 ms
const WANTED_MS = 14;
const LEAST = 0.375; // three quarters of the page's own pixels: fewer frames are seen than fewer pixels sooner forgiven
const FASTEST_FALL = 0.5;
const RISE = 1.25;
const NO_GAIN = 0.92; // fewer pixels that leave a frame longer than this part of its time are no help
const PATIENCE = 5; // decisions of enough time before a rise; twice as many after each that was too much
const LONGEST_PATIENCE = 80; // about 8 s at 60 Hz
const STUCK = 40; // decisions for which nothing is tried where fewer pixels were no help

/** Which part of the full width and height a scene in motion is drawn with. */
export class Resolution {
  constructor() {
    this.part = FIRST;
    this.patience = PATIENCE;
    this.hasRisen = false;
    this.rest();
  }

  /** The scene stood still, so intervals before and after have nothing to do with each other. */
  rest() {
    if (this.lastFall) this.part = this.lastFall.part; // nothing has shown yet that fewer pixels are a help
    this.intervals = [];
    this.inTime = 0;
    this.stuck = 0;
    this.lastFall = undefined;
  }

  /** Takes the time between two frames [ms]; answers whether `part` has changed. */
  took(interval) {
    this.intervals.push(interval);
    if (this.intervals.length < FRAMES) return false;
    const typical = this.intervals.sort((one, other) => one - other)[FRAMES / 2];
    this.intervals = [];
    const before = this.part;
    if (this.stuck) this.stuck -= 1;
    else if (typical > SLOW_MS) this.#fall(typical);
    else this.#rise();
    return this.part !== before;
  }

  #fall(typical) {
    this.inTime = 0;
    if (this.hasRisen) this.patience = Math.min(LONGEST_PATIENCE, 2 * this.patience);
    this.hasRisen = false;
    if (this.lastFall && typical > NO_GAIN * this.lastFall.typical) {
      this.part = this.lastFall.part; // a slow screen or another program takes the time
      this.stuck = STUCK;
      this.lastFall = undefined;
      return;
    }
    this.lastFall = { part: this.part, typical };
    this.part = Math.max(LEAST, this.part * Math.max(FASTEST_FALL, Math.sqrt(WANTED_MS / typical)));
  }

  #rise() {
    this.lastFall = undefined;
    this.inTime += 1;
    if (this.part === 1 || this.inTime < this.patience) return;
    this.inTime = 0;
    this.hasRisen = true;
    this.part = Math.min(1, this.part * RISE);
  }
}
