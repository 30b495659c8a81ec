// Plays the video of a trial: motion JPEG whose frames have a comment with their number, time and force.
const section = document.getElementById("trial");
const [film, plot] = section.querySelectorAll("canvas");
const [button, slider, said] = ["[data-play]", "[data-frame]", "[data-said]"].map((each) => section.querySelector(each));
const frames = [];
let at = 0;
let timer = null;

/** Frames of the file: each is start of image, a comment with its length, and as many bytes of JPEG as that says. */
function read(bytes) {
  const view = new DataView(bytes);
  const decoder = new TextDecoder();
  for (let place = 0; place < bytes.byteLength; ) {
    const comment = view.getUint16(place + 4) - 2;
    const note = JSON.parse(decoder.decode(new Uint8Array(bytes, place + 6, comment)));
    const body = place + 6 + comment;
    const start = new Uint8Array([0xff, 0xd8]);
    frames.push({ note, jpeg: new Blob([start, new Uint8Array(bytes, body, note.n_bytes - 2)], { type: "image/jpeg" }) });
    place = body + note.n_bytes - 2;
  }
}

const seconds = (index) => (frames[index].note.time_ns - frames[0].note.time_ns) / 1e9;

async function show(index) {
  at = Math.max(0, Math.min(frames.length - 1, index));
  slider.value = at + 1;
  const image = await createImageBitmap(frames[at].jpeg);
  film.width = image.width;
  film.height = image.height;
  film.getContext("2d").drawImage(image, 0, 0);
  const force = frames[at].note.force_n;
  said.textContent = `Frame ${at + 1} of ${frames.length}, ${seconds(at).toFixed(1)} s${force === null ? "" : `, ${force.toFixed(2)} N`}`;
  draw();
}

function draw() {
  const pen = plot.getContext("2d");
  const measured = frames.map(({ note }, index) => [seconds(index), note.force_n]).filter(([, force]) => force !== null);
  const [end, largest] = [seconds(frames.length - 1) || 1, Math.max(1, ...measured.map(([, force]) => force))];
  const [x, y] = [(time) => 60 + (plot.width - 70) * (time / end), (force) => plot.height - 30 - (plot.height - 50) * (force / largest)];
  pen.clearRect(0, 0, plot.width, plot.height);
  pen.fillStyle = pen.strokeStyle = getComputedStyle(plot).color;
  pen.font = "16px system-ui";
  pen.fillText(`${largest.toFixed(1)} N`, 0, y(largest) + 6);
  pen.fillText("0 N", 0, y(0) + 6);
  pen.fillText(`${end.toFixed(0)} s`, x(end) - 40, plot.height - 6);
  pen.lineWidth = 2;
  pen.beginPath();
  measured.forEach(([time, force], index) => (index ? pen.lineTo(x(time), y(force)) : pen.moveTo(x(time), y(force))));
  pen.stroke();
  pen.fillRect(x(seconds(at)) - 1, 10, 2, plot.height - 40);
}

function play() {
  if (timer !== null) {
    clearTimeout(timer);
    timer = null;
    button.textContent = "Play";
    return;
  }
  if (at === frames.length - 1) at = 0;
  button.textContent = "Pause";
  step();
}

async function step() {
  await show(at);
  if (at === frames.length - 1) {
    timer = null;
    button.textContent = "Play";
    return;
  }
  timer = setTimeout(() => { at += 1; step(); }, 1000 * (seconds(at + 1) - seconds(at)));
}

async function begin() {
  const answer = await fetch(section.dataset.video);
  if (!answer.ok) throw new Error(`The service answered ${answer.status}.`);
  read(await answer.arrayBuffer());
  button.disabled = slider.disabled = false;
  button.addEventListener("click", play);
  slider.addEventListener("input", () => show(Number(slider.value) - 1));
  for (const moment of document.querySelectorAll("[data-moment]")) {
    moment.addEventListener("click", () => {
      show(Number(moment.dataset.moment) - 1);
      section.scrollIntoView({ block: "start" });
    });
  }
  await show(0);
}

begin().catch((error) => {
  said.textContent = `The video cannot be shown: ${error.message}`;
});
