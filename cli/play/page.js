// The page of `vitac play`: draws what the gels feel, and plays an env step at the control rate while a key is held.
const KEYS = [
  { more: "ArrowRight", less: "ArrowLeft", shown: ["→", "←"] },
  { more: "ArrowUp", less: "ArrowDown", shown: ["↑", "↓"] },
  { more: "e", less: "q", shown: ["E", "Q"] },
  { more: "r", less: "f", shown: ["R", "F"] },
];
const LENGTHENED = 4;
const DEAD_ZONE = 0.15;
const [left, right, sceneCanvas] = document.querySelectorAll("canvas");
const at = (id) => document.getElementById(id);
const FINE = 0.25;
const held = new Set();
const pressed = new Map(); // scale of each key since the last env step began: a short press while one is played counts
let state = null;
let isBusy = false;

async function ask(what, content = {}) {
  const answer = await fetch(what, { method: "POST", body: JSON.stringify(content) });
  const found = await answer.json();
  if (!answer.ok) throw new Error(found.error);
  return found;
}

const scale = () => (held.has("Shift") ? FINE : 1);

function wanted() {
  const pad = (navigator.getGamepads?.() ?? []).find((each) => each?.connected);
  const valueOf = (key) => (held.has(key) ? scale() : (pressed.get(key) ?? 0));
  let isActive = valueOf(" ") > 0 || Boolean(pad?.buttons[0]?.pressed);
  const action = state.actions.map((_, index) => {
    const keys = KEYS[index];
    let value = valueOf(keys.more) - valueOf(keys.less);
    const stick = Math.max(-1, Math.min(1, pad?.axes[index] ?? 0));
    if (value === 0 && Math.abs(stick) > DEAD_ZONE) value = scale() * (index % 2 ? -stick : stick);
    isActive ||= value !== 0;
    return value;
  });
  return isActive ? action : null;
}

async function play(what, content) {
  if (isBusy) return;
  isBusy = true;
  try {
    state = await ask(what, content);
    show();
    if (at("look").checked) drawScene(await ask("scene"));
  } catch (error) {
    at("end").textContent = error.message;
  } finally {
    isBusy = false;
  }
}

function show() {
  at("title").textContent = state.title;
  const moved = state.motion ? `, moved ${state.motion.join(", ")}` : "";
  at("where").textContent =
    `Episode ${state.episode}, env step ${state.env_step} of ${state.max_steps}${moved}. ` +
    `By touch alone ${state.solved} of ${state.played} solved.`;
  at("end").textContent = state.end ?? "";
  at("end").className = state.is_success ? "good" : "";
  at("next").disabled = state.env_step > 0 && state.end === null;
  drawGel(left, state.markers_px[0]);
  drawGel(right, state.markers_px[1]);
}

function showKeys() {
  at("keys").replaceChildren(
    ...state.actions.flatMap((action, index) => {
      const [term, text] = [document.createElement("dt"), document.createElement("dd")];
      for (const key of KEYS[index].shown) term.append(Object.assign(document.createElement("kbd"), { textContent: key }), " ");
      term.append(action.name);
      text.textContent = action.meaning;
      return [term, text];
    }),
  );
}

function drawGel(canvas, markers) {
  const pen = canvas.getContext("2d");
  pen.clearRect(0, 0, canvas.width, canvas.height);
  pen.strokeStyle = pen.fillStyle = getComputedStyle(document.body).color;
  pen.lineWidth = 2;
  for (const [u, v, nowU, nowV] of markers) {
    const [x, y] = [2 * u, 2 * v];
    const [dx, dy] = [2 * LENGTHENED * (nowU - u), 2 * LENGTHENED * (nowV - v)];
    pen.beginPath();
    pen.arc(x, y, 2.5, 0, 2 * Math.PI);
    pen.fill();
    const angle = Math.atan2(dy, dx);
    pen.beginPath();
    pen.moveTo(x, y);
    pen.lineTo(x + dx, y + dy);
    for (const turn of [2.6, -2.6]) {
      pen.moveTo(x + dx, y + dy);
      pen.lineTo(x + dx + 7 * Math.cos(angle + turn), y + dy + 7 * Math.sin(angle + turn));
    }
    pen.stroke();
  }
}

function drawScene(scene) {
  const pen = sceneCanvas.getContext("2d");
  const [[lowX, highX], [lowY, highY]] = scene.limits_mm;
  const scale = Math.min(sceneCanvas.width / (highX - lowX), sceneCanvas.height / (highY - lowY));
  pen.clearRect(0, 0, sceneCanvas.width, sceneCanvas.height);
  const shift = 0.5 * (sceneCanvas.width - scale * (highX - lowX));
  for (const [loops, colour] of [[scene.fixed, "#b4846c"], [scene.held, "#3b6ea5cc"]]) {
    pen.beginPath();
    for (const loop of loops) {
      loop.forEach(([x, y], index) => {
        const place = [shift + scale * (x - lowX), sceneCanvas.height - scale * (y - lowY)];
        if (index) pen.lineTo(...place);
        else pen.moveTo(...place);
      });
      pen.closePath();
    }
    pen.fillStyle = colour;
    pen.fill("evenodd");
  }
}

function keyOf(event) {
  return event.key.length === 1 ? event.key.toLowerCase() : event.key;
}

addEventListener("keydown", (event) => {
  const key = keyOf(event);
  if (event.target.closest?.("button, input") && key === " ") return;
  if (key === " " || KEYS.some(({ more, less }) => key === more || key === less)) event.preventDefault();
  if (!held.has(key)) {
    held.add(key);
    pressed.set(key, scale());
    tick();
  }
});
addEventListener("keyup", (event) => held.delete(keyOf(event)));
addEventListener("blur", () => [held, pressed].forEach((keys) => keys.clear()));
at("next").addEventListener("click", () => {
  at("next").blur(); // Space is an env step from here on
  play("next");
});
at("look").addEventListener("change", () => {
  at("scene").hidden = !at("look").checked;
  if (at("look").checked) play("state");
});

function tick() {
  if (!state || isBusy) return;
  const action = wanted();
  pressed.clear();
  if (action && state.end === null) play("step", { action });
}

begin();

async function begin() {
  await play("state");
  showKeys();
  setInterval(tick, 1000 / state.control_rate_hz);
}
